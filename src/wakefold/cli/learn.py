"""``wakefold learn``: past tracks to a model."""

from __future__ import annotations

import json
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wakefold.base.files import naming
from wakefold.base.wording import counted, duration_text, number_text
from wakefold.cli import options
from wakefold.cli.console import fail, guarded, progress, say
from wakefold.cli.grow import OPTIONS, grow
from wakefold.cli.options import Columns, Json, MaxUnpacked, TimeFormat, arg, opt

if TYPE_CHECKING:
    import numpy as np

    from wakefold.tracks.tracks import Tracks


MOST_POINTS = 20_000_000  # of a model: far more than can be compared


class LinkageName(StrEnum):
    single = "single"
    complete = "complete"


class ExecutorName(StrEnum):
    threads = "threads"
    ray = "ray"


@guarded
def learn(
    context: typer.Context,
    tracks: Annotated[list[Path], arg("Files of tracks; their format is recognised. Or a model to --extend.")],
    output: Annotated[
        Path | None,
        opt(
            "Directory to keep the model in; with --extend or --forget by default that of the model.", "-o", "--output"
        ),
    ] = None,
    extend: Annotated[
        list[Path] | None,
        opt("Add the tracks of this file, and of others after it, to the model, which is not learned anew."),
    ] = None,
    forget: Annotated[
        str | None,
        opt("Drop the tracks of the model that end this long before the last to end, such as 90d."),
    ] = None,
    spacing: Annotated[
        str,
        typer.Option(
            help="Distance between the points of a track, such as 200m. auto: a fiftieth of the median length; "
            "with longitudes and latitudes of the tracks that get farther than 1 km, and between 20 m and 200 m."
        ),
    ] = "auto",
    max_gap: Annotated[str, typer.Option(help="Cut a track where its agent is silent for longer.")] = options.MAX_GAP,
    max_speed: Annotated[
        float | None,
        opt(
            "Cut a track where getting to its next point takes more than this, metres per second. Above 60, points as "
            "fast as that are no jumps either."
        ),
    ] = None,
    stop: Annotated[
        str | None,
        opt("Cut a track where its agent stays within RADIUS for TIME, given as RADIUS,TIME: 150m,10min."),
    ] = None,
    min_length: Annotated[
        str, typer.Option(help="Leave out tracks that are shorter, such as 1km.")
    ] = options.MIN_LENGTH,
    linkage: Annotated[LinkageName, typer.Option(help="How tracks are joined into classes.")] = LinkageName.single,
    epsilon: Annotated[
        str | None,
        opt("Radius within which past points tell the velocity, such as 500m; learned if not given."),
    ] = None,
    columns: Columns = "",
    time_format: TimeFormat = None,
    untimed: Annotated[
        bool, typer.Option("--untimed", help="Take points of files without times one second apart.")
    ] = False,
    max_unpacked: MaxUnpacked = None,
    threads: Annotated[
        int | None, typer.Option(help="Threads that compare tracks; one for each core if not given.", min=1)
    ] = None,
    executor: Annotated[
        ExecutorName,
        typer.Option(help="Where tracks are compared; ray: on the cluster of RAY_ADDRESS, or a new one here."),
    ] = ExecutorName.threads,
    checkpoint: Annotated[
        Path | None,
        opt("Directory that keeps what is compared, so that the same command goes on after an interruption."),
    ] = None,
    json_: Json = False,
) -> None:
    """Learn a model from past tracks: the tree of their classes, and how each class moves.

    \b
    Examples:
      $ wakefold learn harbour.csv -o harbour.model
      $ wakefold learn monday.csv tuesday.csv --stop 150m,10min --min-length 1km -o week.model
      $ wakefold learn people.csv --columns agent=who,time=t,x=px,y=py -o forum.model
      $ wakefold learn harbour.model --extend wednesday.csv --forget 90d -o fresh.model
    """

    import wakefold as wf
    from wakefold.cli.facts import level_table, model_facts
    from wakefold.io.collect import MAX_GEODETIC_SPEED
    from wakefold.model.model import SHAPING

    settings = options.reading(columns, time_format, None, max_unpacked)
    if extend or forget is not None:
        for name, written in options.given(context).items():
            if name not in OPTIONS:
                options.wrong(written, "a model that grows keeps what it was learned with")
        grow(tracks[0], [*(extend or ()), *tracks[1:]], output, forget, settings, threads, json_)
        return
    options.input_files(tracks)
    if output is None:
        options.wrong("--output", "missing: a directory to keep the model in")
    options.model_directory(output)
    if linkage is LinkageName.complete and executor is not ExecutorName.threads:
        options.wrong("--executor", "complete linkage runs on the threads of this machine")
    step = None if spacing == "auto" else options.length("--spacing", spacing)
    cuts = options.cuts(max_gap, max_speed, stop, min_length)
    radius = None if epsilon is None else options.length("--epsilon", epsilon)
    if max_speed is not None and max_speed > MAX_GEODETIC_SPEED:  # slower ones cut, and reject nothing
        settings["max_speed"] = max_speed
    with progress("reading") as update:
        read, report = wf.read_tracks(tracks, **settings, progress=update)
    show = say if json_ else print
    show(str(report))
    if report.untimed and not untimed:
        fail(f"{counted(report.untimed, 'point')} without times: --untimed takes them one second apart")
    pieces = options.cut(read, cuts)
    if not len(pieces):
        rare = sparse(read, cuts["max_gap"])
        fail("no track is left to learn from: " + "; ".join([*pieces.notes, *([rare] if rare else [])]))
    remarks = sparse(read, cuts["max_gap"]), at_rest(pieces), impossible(pieces)
    for remark in filter(None, remarks):
        show(f"  note: {remark}")
    step = step or auto_spacing(pieces) or fail("no track moves: give --spacing")
    if (points := points_after(pieces, step)) > MOST_POINTS:
        every = f"a point every {number_text(step, 4)} m"
        fail(f"{every} makes {points:,} points, over {MOST_POINTS:,}: give a larger --spacing")
    pieces = pieces.resample(spacing=step)
    for note in pieces.notes:
        show(f"  {note}")
    if linkage is LinkageName.complete and len(pieces) > 5000:
        say(f"{len(pieces):,} tracks: their distances take {len(pieces) ** 2 * 8 / 2**30:.1f} GiB of memory and more")
    with progress("comparing tracks") as update:
        model = wf.learn(
            pieces,
            linkage=linkage.value,
            epsilon=radius,
            threads=threads,
            progress=update,
            executor=None if executor is ExecutorName.threads else options.ray_workers(threads),
            checkpoint=checkpoint,
        )
    with progress("remembering") as update:
        model.remember(threads, update)
    shaping = {**dict.fromkeys(SHAPING), **cuts, "spacing": step}
    with naming(output):
        replace(model, shaping=shaping).save(output)
    tree = model.filtration
    if json_:
        print(json.dumps({"model": str(output), "report": report.to_dict(), **model_facts(model), "spacing": step}))
        return
    print(f"{pieces!r}, a point every {number_text(step, 4)} m")
    print(repr(model))
    print(level_table(tree))
    print(f"kept in {output}")


MOVING = 1000.0  # metres; a geodetic track that gets no farther is a ship at anchor or at its berth
FINEST, COARSEST = 20.0, 200.0  # metres; the noise of positions, and turns in a channel that must not be cut
RESTING = 100.0  # metres; a moored ship swings that far, and its positions scatter


# Spacing


def auto_spacing(tracks: Tracks) -> float | None:
    """A fiftieth of the median track that moves, metres; for geodetic data within ``FINEST`` and ``COARSEST``.

    Positions of ships at rest scatter by some metres. They say nothing of how long a voyage is, so that geodetic tracks
    count that get farther than ``MOVING``, if there are any. None if no track moves at all.
    """
    import numpy as np

    moving = tracks.length > 0
    if tracks.projection is not None:
        far = _extent(tracks) > MOVING
        moving = far if far.any() else moving
    if not moving.any():
        return None
    spacing = float(np.median(tracks.length[moving])) / 50
    return spacing if tracks.projection is None else min(max(spacing, FINEST), COARSEST)


def points_after(tracks: Tracks, spacing: float) -> int:
    """How many points ``Tracks.resample`` makes at most."""
    import numpy as np

    return int(np.ceil(tracks.length / spacing).sum()) + 2 * len(tracks)


def at_rest(tracks: Tracks) -> str | None:
    """A remark if most tracks are those of ships that lie still, which say nothing of voyages; None if not."""
    resting = int((_extent(tracks) <= RESTING).sum())
    if tracks.projection is None or 2 * resting <= len(tracks):
        return None
    return f"{resting:,} of {counted(len(tracks), 'track')} stay within {RESTING:.0f} m; see --stop, --min-length"


def impossible(tracks: Tracks) -> str | None:
    """A remark if some legs, few of all, are faster than ships: two agents share a name. None if not."""
    from wakefold.io.collect import MAX_GEODETIC_SPEED
    from wakefold.tracks.shaping import fast_legs

    fast = int(fast_legs(tracks, MAX_GEODETIC_SPEED).sum())
    if tracks.projection is None or fast == 0 or 10 * fast > len(tracks.points):
        return None
    limit = f"more than {MAX_GEODETIC_SPEED:.0f} m/s"
    return f"{counted(fast, 'leg')} from point to point would take {limit}; see --max-speed"


def _extent(tracks: Tracks) -> np.ndarray:
    """``(n,)`` metres across the box around each track, from corner to corner."""
    import numpy as np

    begins = tracks.offsets[:-1]
    size = np.maximum.reduceat(tracks.points, begins) - np.minimum.reduceat(tracks.points, begins)
    return np.linalg.norm(size, axis=1)


def sparse(tracks: Tracks, gap: float) -> str | None:
    """A remark if tracks are sampled so rarely that ``gap`` seconds of silence are nothing special; None if not.

    Ships in a harbour are heard 20 times within the default gap, those of a set that it cut to pieces once.
    """
    if not 3 * tracks.median_interval > gap:  # NaN of tracks of one point
        return None
    every = duration_text(tracks.median_interval)
    return f"points are {every} apart (median), near the {duration_text(gap)} that cut a track; see --max-gap"
