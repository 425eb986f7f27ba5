# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
"""Any table, delimited text, Parquet or GeoParquet, whose columns are named by the caller or by themselves."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wakefold.base.types import Floats
from wakefold.io import times
from wakefold.io.formats import delimited, geoparquet
from wakefold.io.formats.delimited import plain
from wakefold.io.records import Rows, as_text, is_text, to_numbers
from wakefold.io.report import ReadError, Tally, listed
from wakefold.io.source import Source

OBVIOUS: dict[str, tuple[str, ...]] = {
    "track": ("track", "trackid", "trajectoryid", "trajid"),
    "agent": ("agent", "agentid", "mmsi", "id", "objectid", "pedid", "pedestrianid", "vesselid"),
    "time": ("time", "t", "timestamp", "datetime", "basedatetime"),
    "lon": ("lon", "longitude", "lng", "long"),
    "lat": ("lat", "latitude"),
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "sog": ("sog",),
    "cog": ("cog",),
    "heading": ("heading",),
    "name": ("name", "vesselname"),
    "callsign": ("callsign",),
    "type": ("type", "vesseltype", "shiptype"),
    "destination": ("destination",),
    "length": ("length",),
    "width": ("width",),
}
"""What a column is, by its name as ``sniff.plain`` makes it; the first name that is there counts."""
MOTION = ("sog", "cog", "heading")
POSITION = ("lon", "lat", "x", "y", "z")
FLOATS = (*POSITION, *MOTION, "length", "width")
MOST_BYTES = 8 << 30
"""A packed Parquet file has to be unpacked whole."""

Columns = Mapping[str, str | int]


def recognised(names: Sequence[str]) -> dict[str, str]:
    """Which column is what by its name alone."""
    by_plain: dict[str, str] = {}
    for name in names:
        by_plain.setdefault(plain(name), name)
    return {
        ours: next(by_plain[their] for their in theirs if their in by_plain)
        for ours, theirs in OBVIOUS.items()
        if any(their in by_plain for their in theirs)
    }


def is_table(names: Sequence[str]) -> bool:
    """Whether column names alone say who and where."""
    there = recognised(names).keys()
    return bool({"track", "agent"} & there) and ({"lon", "lat"} <= there or {"x", "y"} <= there)


def assigned(source: Source, names: Sequence[str], columns: Columns | None, geometry: bool = False) -> dict[str, int]:
    """Where each of our columns is among ``names``: as the caller says, and for the rest by name.

    Args:
        geometry: there is a geometry column, so that no other position is needed.

    Raises:
        ReadError: a column that is not there; no agent or no position.
    """
    found: dict[str, str | int] = dict(recognised(names))
    if columns is not None:
        for alternatives in (("track", "agent"), POSITION):
            if any(name in columns for name in alternatives):
                found = {name: where for name, where in found.items() if name not in alternatives}
        found |= columns
    if {"lon", "lat"} <= found.keys():
        found = {name: where for name, where in found.items() if name not in ("x", "y", "z")}
    places = {}
    for ours, where in found.items():
        if isinstance(where, str) and where in names:
            places[ours] = list(names).index(where)
        elif isinstance(where, int) and 0 <= where < len(names):
            places[ours] = where
        else:
            raise ReadError(f"{source.name}: no column {where!r} (for {ours}); there are {listed(names)}")
    missing = []
    if not {"track", "agent"} & places.keys():
        missing.append("agent")
    if not geometry and not ({"lon", "lat"} <= places.keys() or {"x", "y"} <= places.keys()):
        missing.append("lon and lat (or x and y)")
    if missing:
        raise ReadError(
            f"{source.name}: which column is {listed(missing)}? There are {listed(names)}; "
            "give columns={...} (--columns)"
        )
    return places


def read_text(source: Source, tally: Tally, columns: Columns | None, time_format: str | None) -> Iterator[Rows]:
    """Batches of rows of a delimited text; without a header if columns are given by position."""
    header = not any(isinstance(where, int) for where in (columns or {}).values())
    layout = delimited.layout(source.head, header)
    places = assigned(source, layout.names, columns)
    wanted: dict[str, tuple[int, delimited.Kind]] = {
        name: (where, "time" if name == "time" else "float" if name in FLOATS else "text")
        for name, where in places.items()
    }
    for block in delimited.read(source, layout, wanted, time_format):
        tally.rows += len(block.bad)
        tally.reject("bad line", len(block.bad), block.bad)
        if len(block.lines):
            floats = {name: block.doubles(name) for name in places if wanted[name][1] != "text"}
            texts = {name: pa.array(block.columns[name]) for name in places if wanted[name][1] == "text"}
            yield _rows(floats, texts, block.lines, block.text)


def read_parquet(source: Source, tally: Tally, columns: Columns | None, time_format: str | None) -> Iterator[Rows]:
    """Batches of rows of a Parquet or GeoParquet file; lines are row numbers from 1."""
    try:
        file = pq.ParquetFile(source.path or io.BytesIO(source.whole(MOST_BYTES)))
        names = file.schema_arrow.names
        shape = geoparquet.geometry(file.schema_arrow) if not _position(columns) else None
        places = assigned(source, names, columns, geometry=shape is not None)
        if shape is not None:
            places = {name: where for name, where in places.items() if name not in POSITION}
        first = 1
        wanted = [names[where] for where in places.values()] + ([shape.column] if shape else [])
        for batch in file.iter_batches(columns=list(dict.fromkeys(wanted))):
            yield _parquet_rows(
                batch, {ours: names[where] for ours, where in places.items()}, shape, first, time_format
            )
            first += len(batch)
    except ReadError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        raise ReadError(f"{source.name}: the Parquet file cannot be read ({_line(error)})") from error


def _parquet_rows(
    batch: pa.RecordBatch, places: Mapping[str, str], shape: geoparquet.Geometry | None, first: int, form: str | None
) -> Rows:
    floats: dict[str, Floats] = {}
    others: dict[str, pa.Array] = {}
    for ours, name in places.items():
        values = batch.column(name)
        if pa.types.is_dictionary(values.type):
            values = values.dictionary_decode()
        if ours == "time":
            floats[ours] = times.from_text(values, form) if is_text(values) else times.from_arrow(values, form)
        elif ours in FLOATS:
            values = to_numbers(values, pa.float64()) if is_text(values) else values.cast(pa.float64(), safe=False)
            floats[ours] = values.to_numpy(zero_copy_only=False)
        else:
            others[ours] = values
    if shape is not None:
        x, y = shape.convert(*geoparquet.points(batch.column(shape.column)))
        floats |= {"lon": x, "lat": y} if shape.geodetic else {"x": x, "y": y}

    def text(row: int) -> str:
        return ", ".join(f"{name}={as_text(batch.column(name)[row].as_py())}" for name in places.values())

    return _rows(floats, others, np.arange(first, first + len(batch)), text)


def _rows(floats: Mapping[str, Floats], others: Mapping[str, pa.Array], lines: np.ndarray, text) -> Rows:
    geodetic = "lon" in floats
    attributes: dict[str, pa.Array | Floats] = {name: values for name, values in others.items() if name != "track"}
    attributes |= {name: floats[name] for name in ("length", "width") if name in floats}
    key = others["track"] if "track" in others else attributes.pop("agent")
    return Rows(
        agent=key,
        time=floats.get("time"),
        position=[floats[name] for name in (("lon", "lat") if geodetic else ("x", "y", "z")) if name in floats],
        geodetic=geodetic,
        lines=lines,
        text=text,
        columns={name: floats[name] for name in MOTION if name in floats},
        attributes=attributes,
    )


def _position(columns: Columns | None) -> bool:
    return columns is not None and any(name in columns for name in POSITION)


def _line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
