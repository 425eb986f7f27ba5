"""The command line: parse, call, print. Heavy imports happen inside the commands, so that --help is quick."""

from __future__ import annotations

import io
import os
import sys
from typing import Annotated, cast

import typer

from wakefold.base import __version__
from wakefold.cli import console
from wakefold.cli.demo import demo
from wakefold.cli.info import info
from wakefold.cli.learn import learn
from wakefold.cli.relations import relations
from wakefold.cli.reproduce import reproduce
from wakefold.cli.score import score
from wakefold.cli.show import show
from wakefold.cli.track import track

app = typer.Typer(
    name="wakefold",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Tells, at every scale at once, what a moving agent is doing.

    \b
    Learn classes of movement from past tracks, then follow live agents:
      $ wakefold learn harbour.csv -o harbour.model
      $ wakefold track harbour.model fixes.csv -o beliefs.csv

    \b
    Exit codes: 0 done; 1 an error in the data, or lines that were refused;
    2 wrong usage; 130 interrupted; 141 whoever read the output has closed it.
    """
    console.debug = debug
    if version:
        print(f"wakefold {__version__}")
        raise typer.Exit


for command in (learn, track, score, show, info, relations, demo, reproduce):  # the order of --help
    app.command()(command)


def main() -> None:
    """Entry point of the ``wakefold`` command. It writes UTF-8 in every locale, as files and names hold anything."""
    if sys.stderr is None:  # closed by whoever called
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for as long as we run
    if sys.stdout is None:
        console.say("error: standard output is closed")
        sys.exit(console.FAILED)
    if isinstance(sys.stdout, io.TextIOWrapper) and isinstance(sys.stdout.buffer, io.RawIOBase):
        # PYTHONUNBUFFERED or -u: without a buffer, what a write interrupted by a signal did not take is lost.
        raw = cast(io.RawIOBase, sys.stdout.detach())
        sys.stdout = io.TextIOWrapper(io.BufferedWriter(raw), line_buffering=True)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")
    app()
