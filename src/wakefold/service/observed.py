"""What a file observes: a feed, line by line, or the points of any file of tracks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wakefold.evidence.fix import Fix
from wakefold.io import ReadError, read_tracks
from wakefold.io.columns import assigned, recognised
from wakefold.io.formats import delimited
from wakefold.io.formats.tables import has_header
from wakefold.io.records import SAMPLED, as_text
from wakefold.io.sniff import sniff
from wakefold.io.source import Source, open_sources
from wakefold.service.feed import BLOCK, Form, Observation, Refused, form_of, is_feed, read
from wakefold.tracks.projection import dated

if TYPE_CHECKING:
    from wakefold.io.columns import Columns
    from wakefold.tracks.tracks import Tracks

POINTS = 4096  # of tracks, in a block


def of_tracks(tracks: Tracks) -> Iterator[list[Observation | Refused]]:
    """The points of tracks as fixes of their agents, all in the order of time, in blocks."""
    owner = np.repeat(np.arange(len(tracks)), tracks.lengths)
    names = tracks.attributes.get("agent", tracks.ids)
    geodetic, dates = tracks.projection is not None, dated(tracks.projection, float(tracks.times.min()))
    places = tracks.projection.to_geodetic(tracks.points) if tracks.projection is not None else tracks.points
    block: list[Observation | Refused] = []
    for count, row in enumerate(np.argsort(tracks.times, kind="stable"), 1):
        fix = Fix(lon=places[row, 0], lat=places[row, 1]) if geodetic else Fix(places[row])
        time = float(tracks.times[row])
        stamp = str(np.datetime64(round(1000 * time), "ms")) + "Z" if dates else time
        block.append(Observation(count, str(names[owner[row]]), time, stamp, fix))
        if len(block) == POINTS or count == len(owner):
            yield block
            block = []


def feed_of(
    path: Path, reading: Mapping[str, Any], progress: Callable[[int, int], None]
) -> tuple[Form, Iterator[list[Observation | Refused]], list[str]]:
    """What a file observes: CSV or JSON lines as they stand, any other format by way of ``read_tracks``.

    Who and when is decided by the same function for both, so that all commands follow the same agents.

    Args:
        reading: ``columns``, ``time_format`` and what else ``read_tracks`` takes.

    Returns:
        the form of the file ("csv" for anything else), its observations in blocks, and what is to be said of it.

    Raises:
        ReadError: neither observations nor tracks; an option that does not apply.
    """
    columns, form = reading.get("columns"), reading.get("time_format")
    limit = reading.get("max_unpacked")
    source = next(iter(open_sources(path, limit)))
    found = _feed(source, columns, form)
    if found is None:
        tracks, report = read_tracks(path, **reading, progress=progress)
        return "csv", of_tracks(tracks), [str(report)]
    if "max_speed" in reading:
        raise ReadError(f"{path}: --max-speed does not apply to observations, which are taken line by line")
    first, columns, form, notes = found

    def lines() -> Iterator[list[Observation | Refused]]:
        for source in open_sources(path, limit, progress):
            blocks = (enumerate(block.split(b"\n"), number) for number, block, _ in source.blocks(BLOCK))
            yield from read(([line for line in block if line[0] >= first] for block in blocks), columns, form)

    return form_of(source.head.lstrip()), lines(), [f"{source.name}: {note}" for note in notes]


def _feed(
    source: Source, columns: Columns | None, form: str | None
) -> tuple[int, Columns | None, str | None, Sequence[str]] | None:
    """The line on which a feed begins, its columns and ``time_format``, and notes; None of what is no feed."""
    try:
        kind = sniff(source, columns)
    except ReadError:
        kind = None
    if kind not in ("table", "jsonl", None):
        return None  # those have rules of their own
    if form_of(source.head.lstrip()) == "jsonl":
        rows = [row for line in source.head.split(b"\n")[:SAMPLED] if isinstance(row := _object(line), dict)]
        names = list(dict.fromkeys(key for row in rows for key in row))
        sample = [[as_text(row.get(name)) for row in rows] for name in names]
        begin = next((line for line in source.head.split(b"\n") if line.strip()), b"")
        first = 1
    else:
        header = not any(isinstance(where, int) for where in (columns or {}).values())
        layout = delimited.layout(source.head, header, partial(has_header, columns=columns))
        if not header or layout.delimiter == " " or layout.comma:
            return None
        names, sample, first = list(layout.names), delimited.sample(source.head, layout), layout.header
        begin = source.head.split(b"\n")[layout.header - 1]
    if not is_feed(begin, columns):
        return None
    there = recognised(names).keys() | set(columns or ())
    placed = {"lon", "lat"} <= there or {"x", "y"} <= there
    ours = {name: where for name, where in (columns or {}).items() if _taken_by_tables(name)}
    found = assigned(source.name, names, sample, ours, form, geometry=not placed)
    if found.time is None or found.time.hhmm:
        return None
    decided: dict[str, str | int] = dict(columns or {})
    decided |= {name: names[where] for name, where in found.places.items() if name in ("agent", "track")}
    decided["time"] = "+".join(names[where] for where in found.time.columns)
    return first, decided, found.time.form, found.notes


def _taken_by_tables(name: str) -> bool:
    return name in ("agent", "track", "time", "lon", "lat", "x", "y", "z")


def _object(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None
