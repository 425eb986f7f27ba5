"""What the commands share: exit codes, one-line errors, progress bars. No heavy imports."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from typing import NoReturn, ParamSpec, TextIO

import typer

from wakefold.base.files import naming
from wakefold.base.wording import escaped

P = ParamSpec("P")
FAILED, INTERRUPTED, CLOSED, TERMINATED = 1, 130, 141, 143  # the last three as shells report SIGINT, SIGPIPE, SIGTERM
PATIENCE = 2.0  # seconds before a bar is shown
debug = False


class Terminated(KeyboardInterrupt):
    """SIGTERM."""


def say(message: str) -> None:
    """Lines on standard error, control characters escaped. If they cannot be written, the work goes on without."""
    _tell(f"wakefold: {message}")


def _tell(text: str) -> None:
    try:
        print("\n".join(escaped(line) for line in text.split("\n")), file=sys.stderr, flush=True)
    except (OSError, ValueError, AttributeError):  # a full disk, a reader that is gone, a closed stream
        _forget(sys.stderr)


def guarded(command: Callable[P, None]) -> Callable[P, None]:
    """A command whose failures are one line on standard error and an exit code (with --debug, a traceback)."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            with _ended_by_sigterm():
                command(*args, **kwargs)
            with naming("standard output"):
                sys.stdout.flush()
        except BrokenPipeError:  # whoever read our output has seen enough
            _let_go()
            raise typer.Exit(CLOSED) from None
        except KeyboardInterrupt as end:
            say("interrupted")
            _let_go()
            raise typer.Exit(TERMINATED if isinstance(end, Terminated) else INTERRUPTED) from None
        except (ValueError, TypeError, OSError, MemoryError, OverflowError, ImportError, RecursionError) as error:
            if debug:
                traceback.print_exc()
            _let_go()
            fail(error)

    return run


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """SIGTERM ends the work as Ctrl-C does: what was answered is written whole."""

    def end(number: int, frame: object) -> None:
        raise Terminated

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _let_go() -> None:
    """Write what is left for standard output; if that fails, forget it."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        _forget(sys.stdout)


def _forget(stream: TextIO) -> None:
    """What cannot be written goes nowhere; Python would try again at its end, and fail."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def fail(error: object) -> NoReturn:
    """Exit code 1 and one line: the message; an exception without one by its name."""
    text = str(error) or type(error).__name__
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    first, *rest = text.splitlines()
    say(f"error: {first}")
    for line in rest:  # the offending lines of a file in which nothing was good
        _tell(f"  {line}")
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
