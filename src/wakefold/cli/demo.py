"""``wakefold demo``: the harbour."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from wakefold.cli import options
from wakefold.cli.console import guarded, progress
from wakefold.cli.options import Json


@guarded
def demo(
    out: Annotated[Path, typer.Option(help="Directory for report.html and pictures.")] = Path("demo-output"),
    json_: Json = False,
) -> None:
    """Learn a week of New York Harbor and follow the ships of the day after.

    \b
    Needs the sample data: pip install "wakefold[demo]".
    Example:
      $ wakefold demo --out demo-output
    """
    from wakefold.experiments.harbour import demo as harbour

    options.output_directory("--out", out)
    with progress("demo") as update:
        results = harbour.run(out, update, (lambda line: None) if json_ else print)
    if json_:
        print(json.dumps(results, allow_nan=False))
