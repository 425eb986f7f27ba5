"""Files that a user named: errors that say which, and standard output by the name "-"."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

STANDARD = Path("-")  # standard input or output


@contextmanager
def naming(path: object) -> Iterator[None]:
    """Errors of the system that happen within name this path, the one the user gave, and no temporary one."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


@contextmanager
def opened(path: str | Path) -> Iterator[TextIO]:
    """A text file to write, errors naming it; "-" is standard output, which stays open."""
    if Path(path) == STANDARD:
        with naming("standard output"):
            yield sys.stdout
        return
    with naming(path), Path(path).open("w", encoding="utf-8", errors="backslashreplace") as out:
        yield out
