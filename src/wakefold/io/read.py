"""Reads tracks: recognises a format by its content and says what it left out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from wakefold.base import checks
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
        columns: for tables (and properties of GeoJSON), which column is what: keys ``agent`` (the grouping),
            ``time`` (``"Date+Time"`` joins two), ``lon`` and ``lat`` or ``x``, ``y`` (and ``z``); any other key becomes
            a per-point column (``sog``, ``cog``, ``heading``) or a per-track attribute of that name. ``track`` groups
            by something finer than ``agent``. Values are column names, or positions from 0 for text without a header.
        time_format: how times are written: a strptime format, or "s", "ms", "us", "ns" since 1970, or "days" of a
            spreadsheet. If not given: ISO 8601, seconds, or what the values can only be (docs/reading.md).
        max_speed: no two neighbours of a track are farther apart than this takes, metres per second (or plane units):
            rows that fit nowhere are jumps, and bodies that share a name become tracks of their own. "auto": 60 for
            geodetic data, none for planar data; None: no check.
        max_unpacked: bytes that a packed file, of whatever kind, may unpack to; by default 200 times its size, and at
            least 256 MiB. A row counts for 40 bytes at least.
        progress: called with the bytes of the current file read so far and in all.

    Raises:
        ReadError: a file that is missing, empty, damaged, of no known format, or without one good row.
        TypeError, ValueError: an argument of a wrong kind.
    """
    from wakefold.io.collect import Collector
    from wakefold.io.records import Rows
    from wakefold.io.sniff import FORMATS, sniff
    from wakefold.io.source import open_sources

    _check_arguments(paths, columns, time_format, max_speed, max_unpacked)
    if format is not None and format not in FORMATS:
        raise ReadError(f"no format {format!r}; there are {', '.join(FORMATS)}")
    collector, seen = Collector(), dict[str, None]()
    for path in [paths] if isinstance(paths, (str, PathLike)) else paths:
        for source in open_sources(Path(path), max_unpacked, progress):
            collector.open(source.name)
            kind = format or sniff(source, columns)
            _check_options(kind, source.name, columns, time_format)
            seen[FORMATS[kind]] = None
            for rows in _rows(kind, source, collector.tally, columns, time_format):
                known = collector.agents
                if isinstance(rows, Rows):
                    source.hold(len(rows.lines))
                    collector.add(rows)
                else:
                    collector.describe(rows)
                source.hold(0, collector.agents - known)
    if not seen:
        raise ReadError("no files to read")
    return collector.finish(", ".join(seen), max_speed)


def _check_arguments(paths: Any, columns: Any, time_format: Any, max_speed: Any, max_unpacked: Any) -> None:
    """Refuse arguments of ``read_tracks`` of a wrong kind in a sentence.

    Raises:
        TypeError, ValueError: there is one.
    """
    several = [paths] if isinstance(paths, (str, PathLike)) else paths
    if isinstance(several, bytes) or not isinstance(several, Iterable):
        raise TypeError(f"read_tracks takes a path or several, got {checks.shown(paths)}")
    if isinstance(several, Sequence):
        for path in several:
            if not isinstance(path, (str, PathLike)):
                raise TypeError(f"read_tracks takes paths, got {checks.shown(path)}")
    if columns is not None:
        checks.instance(columns, Mapping, "columns must be a mapping such as {'agent': 'mmsi'}")
        for ours, theirs in columns.items():
            checks.instance(ours, str, "a key of columns must be a text")
            if isinstance(theirs, bool) or not isinstance(theirs, (str, int)):
                raise TypeError(f"columns[{ours!r}] must be a name or a position, got {checks.shown(theirs)}")
    if time_format is not None:
        checks.instance(time_format, str, "time_format must be a text such as '%d/%m/%Y %H:%M'")
    if max_speed is not None and max_speed != "auto" and not checks.real(max_speed, "max_speed") > 0:
        raise ValueError(f"max_speed must be above 0, got {checks.shown(max_speed)}")
    if max_unpacked is not None:
        checks.whole(max_unpacked, "max_unpacked", least=0, most=1 << 62)


TABLES = ("table", "parquet", "jsonl", "geojson", "mfjson", "geopackage")
UNTIMED = ("edinburgh", "plt")
"""Formats with columns to name, and those whose times are written in one way only."""


def _check_options(kind: str, name: str, columns: Columns | None, time_format: str | None) -> None:
    """Refuse an option that a format has no use for.

    Raises:
        ReadError: there is one.
    """
    from wakefold.io.sniff import FORMATS

    if columns and kind not in TABLES:
        raise ReadError(f"{name}: columns (--columns) do not apply: {FORMATS[kind]} has none to name")
    if time_format is not None and kind in UNTIMED:
        raise ReadError(
            f"{name}: time_format (--time-format) does not apply: {FORMATS[kind]} has one way of writing times"
        )


def _rows(
    kind: str, source: Source, tally: Tally, columns: Columns | None, time_format: str | None
) -> Iterator[Rows | Static]:
    """The reader of a format, imported when it is needed."""
    match kind:
        case "marinecadastre" | "dma":
            from wakefold.io.formats import ais_csv

            return ais_csv.read(source, tally, kind == "dma", time_format)
        case "traj":
            from wakefold.io.formats import traj

            return traj.read(source, tally, time_format)
        case "geojson" | "mfjson":
            from wakefold.io.formats import geojson

            return geojson.read(source, tally, columns, time_format)
        case "gpx":
            from wakefold.io.formats import gpx

            return gpx.read(source, tally, time_format)
        case "kml":
            from wakefold.io.formats import kml

            return kml.read(source, tally, time_format)
        case "edinburgh":
            from wakefold.io.formats import edinburgh

            return edinburgh.read(source, tally)
        case "plt":
            from wakefold.io.formats import plt

            return plt.read(source, tally)
        case "table" | "parquet":
            from wakefold.io.formats import tables

            read = tables.read_text if kind == "table" else tables.read_parquet
            return read(source, tally, columns, time_format)
        case "jsonl":
            from wakefold.io.formats import jsonl

            return jsonl.read(source, tally, columns, time_format)
        case "geopackage":
            from wakefold.io.formats import geopackage

            return geopackage.read(source, tally, columns, time_format)
        case "nmea":
            from wakefold.io.formats import nmea

            return nmea.read(source, tally, time_format)
        case _:
            raise AssertionError(kind)
