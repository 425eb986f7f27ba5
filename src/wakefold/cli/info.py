"""``wakefold info``: what files hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from wakefold.cli import options
from wakefold.cli.console import guarded, progress
from wakefold.cli.options import Columns, Json, MaxSpeed, MaxUnpacked, TimeFormat, arg


@guarded
def info(
    files: Annotated[list[Path], arg("Files of tracks, or models.")],
    columns: Columns = "",
    time_format: TimeFormat = None,
    max_speed: MaxSpeed = None,
    max_unpacked: MaxUnpacked = None,
    json_: Json = False,
) -> None:
    """Say what files of tracks, or models, hold: who, when, where, how densely sampled.

    \b
    Examples:
      $ wakefold info harbour.csv
      $ wakefold info harbour.model --json
    """
    from wakefold.cli.facts import about

    options.input_files(files)
    settings, known = options.reading(columns, time_format, max_speed, max_unpacked), []
    for path in files:
        with progress("reading") as update:
            text, facts = about(path, settings, update)
        known.append(facts)
        if not json_:
            print(text)
    if json_:
        print(json.dumps(known if len(known) > 1 else known[0], allow_nan=False))
