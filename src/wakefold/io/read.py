"""Reads tracks: recognises a format by its content and says what it left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from wakefold.io.report import ReadError, Report

if TYPE_CHECKING:
    from wakefold.io.records import Rows, Static
    from wakefold.io.report import Tally
    from wakefold.io.source import Progress, Source
    from wakefold.tracks.tracks import Tracks


Columns = Mapping[str, str | int]


def read_tracks(
    paths: str | PathLike[str] | Sequence[str | PathLike[str]],
    *,
    format: str | None = None,
    columns: Columns | None = None,
    time_format: str | None = None,
    max_speed: float | Literal["auto"] | None = "auto",
    max_unpacked: int | None = None,
    progress: Progress | None = None,
) -> tuple[Tracks, Report]:
    """Read the tracks of one file or several, and a report on every row that was read.

    The formats are those of ``wakefold.io.sniff.FORMATS``, plain or .gz, .zst or .zip; docs/reading.md states the
    rules by which rows are rejected. Geodetic data are projected onto a local plane centred on them.

    Args:
        paths: one path or several; an agent that is in several files is one track.
        format: a key of ``FORMATS``, to read what would be taken for something else.
        columns: for tables, which column is what: keys ``agent`` (the grouping), ``time``, ``lon`` and ``lat`` or
            ``x``, ``y`` (and ``z``); any other key becomes a per-point column (``sog``, ``cog``, ``heading``) or a
            per-track attribute of that name. ``track`` groups by something finer than ``agent``. Values are column
            names, or positions from 0 for text without a header.
        time_format: how a table writes times: a strptime format, or "s", "ms", "us", "ns". If not given: ISO 8601 or
            seconds.
        max_speed: a point that would need more, metres per second (or plane units), both to be reached and left is a
            jump. "auto": 60 for geodetic data, none for planar data; None: no check.
        max_unpacked: bytes a compressed file may unpack to; by default 200 times its size, and at least 256 MiB.
        progress: called with the bytes of the current file read so far and in all.

    Raises:
        ReadError: a file that is missing, empty, damaged, of no known format, or without one good row.
    """
    from wakefold.io.collect import Collector
    from wakefold.io.records import Rows
    from wakefold.io.sniff import FORMATS, sniff
    from wakefold.io.source import open_sources

    if format is not None and format not in FORMATS:
        raise ReadError(f"no format {format!r}; there are {', '.join(FORMATS)}")
    collector, seen = Collector(), dict[str, None]()
    for path in [paths] if isinstance(paths, (str, PathLike)) else paths:
        for source in open_sources(Path(path), max_unpacked, progress):
            collector.open(source.name)
            kind = format or sniff(source, columns)
            seen[FORMATS[kind]] = None
            for rows in _rows(kind, source, collector.tally, columns, time_format):
                if isinstance(rows, Rows):
                    collector.add(rows)
                else:
                    collector.describe(rows)
    if not seen:
        raise ReadError("no files to read")
    return collector.finish(", ".join(seen), max_speed)


def _rows(
    kind: str, source: Source, tally: Tally, columns: Columns | None, time_format: str | None
) -> Iterator[Rows | Static]:
    """The reader of a format, imported when it is needed."""
    match kind:
        case "marinecadastre" | "dma":
            from wakefold.io.formats import ais_csv

            return ais_csv.read(source, tally, danish=kind == "dma")
        case "traj":
            from wakefold.io.formats import traj

            return traj.read(source, tally)
        case "geojson" | "mfjson":
            from wakefold.io.formats import geojson

            return geojson.read(source, tally)
        case "gpx":
            from wakefold.io.formats import gpx

            return gpx.read(source, tally)
        case "edinburgh":
            from wakefold.io.formats import edinburgh

            return edinburgh.read(source, tally)
        case "table" | "parquet":
            from wakefold.io.formats import tables

            read = tables.read_text if kind == "table" else tables.read_parquet
            return read(source, tally, columns, time_format)
        case "nmea":
            from wakefold.io.formats import nmea

            return nmea.read(source, tally, time_format)
        case _:
            raise AssertionError(kind)
