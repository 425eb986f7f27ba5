"""What the commands share: exit codes, one-line errors, progress bars, tables of levels. No heavy imports."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import TYPE_CHECKING, Any, NoReturn, ParamSpec

import typer

from wakefold.wording import number_text

if TYPE_CHECKING:
    from wakefold.filtration import Filtration
    from wakefold.model import Model

P = ParamSpec("P")
FAILED, USAGE, INTERRUPTED, CLOSED = 1, 2, 130, 141  # the last two as shells report SIGINT and SIGPIPE
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


@contextmanager
def naming(path: object) -> Iterator[None]:
    """Errors of the system that happen within name this path, the one the user gave, and no temporary one."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


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


def level_rows(tree: Filtration) -> list[dict[str, Any]]:
    """A useful handful of levels and what the tree looks like there."""
    import numpy as np

    rows = []
    for level in dict.fromkeys([0.0, *map(float, tree.levels()), float(tree.birth[tree.root])]):
        sizes = np.diff(tree.cuts(level))
        row = {"classes": len(sizes), "largest": int(sizes.max()), "single": int((sizes == 1).sum())}
        rows.append({"level": level, **row})
    return rows


def model_facts(model: Model) -> dict[str, Any]:
    """A model in plain types, ready for JSON."""
    tracks, tree, dynamics = model.tracks, model.filtration, model.dynamics
    place = tracks.projection
    return {
        "tracks": len(tracks),
        "points": len(tracks.points),
        "classes": len(tree.birth),
        "linkage": tree.linkage,
        "plane": None if place is None else {"lon": place.lon, "lat": place.lat},
        "epsilon": dynamics.epsilon,
        "noise": {"kind": dynamics.noise, "scale": dynamics.scale},
        "sd": model.sd,
        "levels": level_rows(tree),
    }


def level_table(tree: Filtration) -> str:
    """``level_rows`` for people."""
    lines = [f"{'level (m)':>12}{'classes':>9}{'largest':>9}{'single tracks':>15}"]
    for row in level_rows(tree):
        lines.append(f"{number_text(row['level'], 6):>12}{row['classes']:>9,}{row['largest']:>9,}{row['single']:>15,}")
    return "\n".join(lines)
