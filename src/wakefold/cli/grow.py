"""``wakefold learn MODEL --extend FILE``: new tracks for a model, and old ones out of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wakefold.base.files import naming
from wakefold.base.wording import counted
from wakefold.cli import options
from wakefold.cli.console import fail, progress, say

OPTIONS = {
    "tracks",
    "extend",
    "forget",
    "output",
    "columns",
    "time_format",
    "max_unpacked",
    "threads",
    "json_",
}  # all it reads


def grow(
    model: Path,
    files: Sequence[Path],
    output: Path | None,
    forget: str | None,
    reading: Mapping[str, Any],
    threads: int | None,
    as_json: bool,
) -> None:
    """Add the tracks of files to a model, take old tracks out, keep it where it was or in another directory.

    Args:
        model: the directory.
        forget: age of the tracks that go, or None.
        reading: how tables are read; arguments of ``read_tracks``.
    """
    import wakefold as wf
    from wakefold.cli.facts import level_table, model_facts

    options.input_files(files)
    age = None if forget is None else options.duration("--forget", forget)
    known = wf.load(model)
    output = options.model_directory(model if output is None else output)
    show, facts, grown = say if as_json else print, dict[str, Any](), known
    if files:
        with progress("reading") as update:
            read, report = wf.read_tracks(files, **reading, progress=update)
        show(str(report))
        if report.untimed:
            fail(f"{counted(report.untimed, 'point')} without times")
        pieces = known.shaped(read)
        for note in pieces.notes:
            show(f"  {note}")
        if not len(pieces):
            fail("no track is left to add: " + "; ".join(pieces.notes))
        with progress("comparing tracks") as update:
            grown = known.extend(pieces, threads=threads, progress=update)
        facts = {"report": report.to_dict(), "added": len(pieces)}
        show(f"{counted(len(pieces), 'track')} added to {counted(len(known.tracks), 'track')}")
    if age is not None:
        every = len(grown.tracks)
        with progress("comparing tracks") as update:
            grown = grown.forget(age, threads=threads, progress=update)
        facts["forgotten"] = every - len(grown.tracks)
        show(f"{counted(facts['forgotten'], 'track')} forgotten")
    with naming(output):
        grown.save(output)
    if as_json:
        print(json.dumps({"model": str(output), **facts, **model_facts(grown)}))
        return
    print(repr(grown))
    print(level_table(grown.filtration))
    print(f"kept in {output}")
