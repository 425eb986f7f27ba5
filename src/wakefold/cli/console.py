"""What the commands share: exit codes, one-line errors, progress bars. No heavy imports."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import NoReturn, ParamSpec

import typer

P = ParamSpec("P")
FAILED, INTERRUPTED, CLOSED = 1, 130, 141  # the last two as shells report SIGINT and SIGPIPE
PATIENCE = 2.0  # seconds before a bar is shown
debug = False


def say(message: str) -> None:
    """One line on standard error."""
    print(f"wakefold: {message}", file=sys.stderr, flush=True)


def guarded(command: Callable[P, None]) -> Callable[P, None]:
    """A command whose failures are one line on standard error and an exit code (with --debug, a traceback)."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
            sys.stdout.flush()
        except BrokenPipeError:  # whoever read our output has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(CLOSED) from None
        except KeyboardInterrupt:
            say("interrupted")
            raise typer.Exit(INTERRUPTED) from None
        except (ValueError, TypeError, OSError, MemoryError, OverflowError, ImportError) as error:
            if debug:
                traceback.print_exc()
            fail(error)

    return run


def fail(error: object) -> NoReturn:
    """Exit code 1 and one line: the message; an exception without one by its name."""
    text = str(error) or type(error).__name__
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    first, *rest = text.splitlines()
    say(f"error: {first}")
    for line in rest:  # the offending lines of a file in which nothing was good
        print(f"  {line}", file=sys.stderr)
    raise typer.Exit(FAILED)


@contextmanager
def progress(what: str, shown: bool = True) -> Iterator[Callable[..., None]]:
    """A bar on standard error, if that is a terminal and the work takes over two seconds.

    Yields a function that takes the share done (0 to 1), or the amount done and the whole.
    """
    begin, bar, task = time.monotonic(), None, None

    def update(done: float, whole: float = 1.0) -> None:
        nonlocal bar, task
        if bar is None and time.monotonic() - begin > PATIENCE:
            from rich.console import Console
            from rich.progress import Progress

            bar = Progress(console=Console(stderr=True), transient=True)
            task = bar.add_task(what, total=1.0)
            bar.start()
        if bar is not None and task is not None:
            bar.update(task, completed=done / whole if whole else 1.0)

    def silent(done: float, whole: float = 1.0) -> None:
        pass

    try:
        yield update if shown and sys.stderr.isatty() else silent
    finally:
        if bar is not None:
            bar.stop()
