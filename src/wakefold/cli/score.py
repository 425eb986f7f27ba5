"""``wakefold score``: how good the forecasts are on held-out tracks."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from wakefold.cli import options
from wakefold.cli.console import fail, guarded, progress
from wakefold.cli.options import Columns, MaxUnpacked, TimeFormat, arg, opt


class QuestionsName(StrEnum):
    all = "all"
    first = "first"


@guarded
def score(
    model: Annotated[Path, arg("Directory that `wakefold learn` made.")],
    tracks: Annotated[list[Path], arg("Files of tracks that were not learned from.")],
    horizons: Annotated[
        str, opt("How far ahead is asked, such as 5min,15min,30min,1h. For planar tracks from their duration.")
    ] = "",
    every: Annotated[
        str | None,
        opt("Time between the fixes that are given, at least. 2min; for planar tracks a 25th of their duration."),
    ] = None,
    after: Annotated[
        str | None,
        opt(
            "Age of a track from which on is asked. 2min; for planar tracks four times --every.",
            "--from",
        ),
    ] = None,
    questions: Annotated[
        QuestionsName, typer.Option(help="Ask after all fixes, or after the first of each track alone.")
    ] = QuestionsName.all,
    levels: Annotated[
        str | None,
        opt(
            "Levels of the classes asked for: heights such as 500,2000 or 500m, or a number of levels. 3 if not given."
        ),
    ] = None,
    methods: Annotated[
        str,
        typer.Option(help="Methods, such as nearest-windows,mhpf; constant-velocity is always one."),
    ] = "all",
    whole: Annotated[
        bool,
        typer.Option("--whole", help="Ask slow methods everything too, not only after 200 fixes of 50 tracks."),
    ] = False,
    json_: Annotated[Path | None, opt("File for all numbers, as JSON.", "--json")] = None,
    out: Annotated[Path | None, opt("Directory for report.html and its pictures.")] = None,
    max_gap: Annotated[
        str | None, opt("Cut a track where its agent is silent for longer. As the model's tracks were, if not given.")
    ] = None,
    max_speed: Annotated[
        float | None, opt("Cut a track where getting to its next point takes more than this, metres per second.")
    ] = None,
    stop: Annotated[
        str | None, opt("Cut a track where its agent stays within RADIUS for TIME, given as RADIUS,TIME: 150m,10min.")
    ] = None,
    min_length: Annotated[str | None, opt("Leave out tracks that are shorter, such as 1km.")] = None,
    columns: Columns = "",
    time_format: TimeFormat = None,
    max_unpacked: MaxUnpacked = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.", min=0)] = 0,
) -> None:
    """Score forecasts on held-out tracks, beside plain methods.

    After fixes of tracks that the model does not know every method tells where the agent will be, and which class the
    track is of. What is asked and how it is scored: docs/forecasts.md.

    \b
    Examples:
      $ wakefold score harbour.model held-out.csv
      $ wakefold score harbour.model held-out.csv --horizons 5min,15min --methods nearest-windows,mhpf --out report
      $ wakefold score forum.model people.csv --columns agent=who,time=t,x=px,y=py --questions first --horizons 3,6
    """
    import wakefold as wf

    options.input_files(tracks)
    ahead = options.horizons(horizons, "--horizons")
    asked: dict[str, Any] = {
        "horizons": ahead or None,
        "every": None if every is None else options.duration("--every", every),
        "after": None if after is None else options.duration("--from", after),
    }
    heights = options.levels(levels or "3")
    names = method_names(methods)
    said = options.cuts(max_gap, max_speed, stop, min_length)
    settings = options.reading(columns, time_format, None, max_unpacked)
    if json_ is not None:
        options.output_file("--json", json_)
    if out is not None:
        options.output_directory("--out", out)
    known = wf.load(model)
    usual = options.cuts(options.MAX_GAP, None, None, options.MIN_LENGTH)
    with progress("reading") as update:
        read, report = wf.read_tracks(tracks, **settings, progress=update)
    print(report)
    kept = {name: value for name, value in known.shaping.items() if name != "spacing" and value is not None}
    pieces = options.cut(read, {**(kept or usual), **said})
    if not len(pieces):
        fail("no track is left to ask about: " + "; ".join(pieces.notes))
    print(repr(pieces))
    with progress("scoring") as update:
        scores = wf.score(
            known, pieces, **asked, questions=questions.value, levels=options.heights(heights, known.filtration),
            methods=names, whole=whole, seed=seed, progress=update,
        )  # fmt: skip
    written = []
    if json_ is not None:
        json_.write_text(json.dumps(scores.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        written.append(json_)
    if out is not None:
        from wakefold.forecast.page import write

        written.append(write(scores, known, out))
    print(scores.table())  # last: whoever reads it may close the stream
    for path in written:
        print(f"wrote {path}")


def method_names(text: str) -> list[str] | None:
    """``nearest-windows,mhpf`` as the names of methods; None for all."""
    from wakefold.forecast.methods import NAMES

    if text.strip().lower() == "all":
        return None
    by = {name.lower().replace(" ", "-"): name for name in NAMES}
    out = []
    for part in text.split(","):
        key = part.strip().lower().replace(" ", "-")
        out.append(by[key] if key in by else options.wrong("--methods", f"{part!r} is none of all, {', '.join(by)}"))
    return out
