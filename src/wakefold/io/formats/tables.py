# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
"""Any table, delimited text, Parquet or GeoParquet, whose columns are named by the caller or by themselves."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from wakefold.base.types import Floats
from wakefold.io import coordinates, times
from wakefold.io.clock import MOST, Clock, Sample
from wakefold.io.columns import FLOATS, GEOMETRIES, MOTION, POSITION, Columns, assigned, is_table, recognised
from wakefold.io.formats import delimited, geoparquet
from wakefold.io.records import PAIRED, SAMPLED, Rows, as_text, is_text, is_text_type, plain, to_numbers
from wakefold.io.report import ReadError, Tally
from wakefold.io.source import Source

MOST_SAMPLED, LONGEST_SAMPLE = 1000, 200
"""Columns of a sample, and characters of a text in it."""
MOST_BYTES = 8 << 30
"""A packed Parquet file has to be unpacked whole."""


def read_text(source: Source, tally: Tally, columns: Columns | None, time_format: str | None) -> Iterator[Rows]:
    """Batches of rows of a delimited text; without a header if columns are given by position."""
    header = not any(isinstance(where, int) for where in (columns or {}).values())
    layout = delimited.layout(source.head, header, partial(has_header, columns=columns))
    sample = delimited.sample(source.head, layout)
    shape = shape_of(source.name, layout.names, sample, columns)
    found = assigned(source.name, layout.names, sample, columns, time_format, geometry=shape is not None)
    tally.decided(found.notes, found.others)
    wanted: dict[str, tuple[int, delimited.Kind]] = {name: (where, _kind(name)) for name, where in found.places.items()}
    clock, form = found.time, None
    if clock is not None:
        parts = ("time",) if len(clock.columns) == 1 else ("day", "of day")
        wanted |= {
            name: (where, "time" if name == "time" else "text")
            for name, where in zip(parts, clock.columns, strict=True)
        }
        form = clock.form
    if shape is not None:
        wanted["shape"] = shape, "text"
    for block in delimited.read(source, layout, wanted, form):
        tally.rows += len(block.bad)
        tally.reject("bad line", len(block.bad), block.bad)
        if len(block.lines):
            texts = {name: pa.array(block.columns[name]) for name, (_, kind) in wanted.items() if kind == "text"}
            floats = {name: block.doubles(name) for name in wanted.keys() - texts.keys()}
            if clock is not None and "day" in texts:
                floats["time"] = times.from_days(texts.pop("day"), texts.pop("of day"), form, clock.hhmm)
            if shape is not None:
                floats |= _placed(source.name, texts.pop("shape").to_pylist())
            yield rows_of(floats, texts, block.lines, block.text)


def has_header(names: Sequence[str], columns: Columns | None) -> bool:
    """Whether the cells of a line are the header of a table: names that we know, or all those that the caller says."""
    stated = [part for name in (columns or {}).values() if isinstance(name, str) for part in (name, *name.split("+"))]
    there = {name.strip() for name in names}
    if stated:
        return bool(there.intersection(stated)) and len(there) > 1
    return is_table(list(names))


def _kind(name: str) -> delimited.Kind:
    if name in ("lon", "lat"):
        return name
    return "float" if name in FLOATS else "text"


def shape_of(source: str, names: Sequence[str], sample: Sample, columns: Columns | None) -> int | None:
    """The column that holds points as text, if there is no other position.

    Raises:
        ReadError: it holds shapes that are no points.
    """
    there = recognised(names).keys() | set(columns or ())
    if {"lon", "lat"} <= there or {"x", "y"} <= there or _position(columns):
        return None
    for i, name in enumerate(names):
        known = [text for text in sample[i] if text]
        if plain(name) in GEOMETRIES and known:
            if sum(map(coordinates.is_point, known)) >= MOST * len(known):
                return i
            raise ReadError(f"{source}: {name} holds {known[0][:40]!r}, which is no point")
    return None


def _placed(source: str, texts: Sequence[object]) -> dict[str, Floats]:
    """Longitude and latitude of points as text."""
    x, y, srids = coordinates.to_points([as_text(text) for text in texts])
    if other := srids - {*coordinates.DEGREES}:
        raise ReadError(f"{source}: positions in EPSG:{min(other)}; only longitude and latitude (EPSG:4326) are read")
    return {"lon": x, "lat": y}


def read_parquet(source: Source, tally: Tally, columns: Columns | None, time_format: str | None) -> Iterator[Rows]:
    """Batches of rows of a Parquet or GeoParquet file; lines are row numbers from 1."""
    try:
        packed = source.path or io.BytesIO(source.whole(MOST_BYTES))
        schema = pq.read_schema(packed)
        texts = [one.name for one in schema if is_text_type(one.type)]
        file = pq.ParquetFile(packed, read_dictionary=texts)  # so that one long text is not repeated in every row
        names = file.schema_arrow.names
        source.decoded(0)
        shape = geoparquet.geometry(file.schema_arrow) if not _position(columns) else None
        found = assigned(source.name, names, _sample(file), columns, time_format, geometry=shape is not None)
        tally.decided(found.notes, found.others)
        places = {name: names[where] for name, where in found.places.items() if not (shape and name in POSITION)}
        clock = [names[where] for where in found.time.columns] if found.time else []
        first = 1
        wanted = [*places.values(), *clock, *([shape.column] if shape else [])]
        for batch in file.iter_batches(columns=list(dict.fromkeys(wanted))):
            source.decoded(_size(batch))
            time = None if found.time is None else _times(batch, clock, found.time, source.name)
            yield _parquet_rows(batch, places, time, shape, first)
            first += len(batch)
    except ReadError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        raise ReadError(f"{source.name}: the Parquet file cannot be read ({_line(error)})") from error


def _size(batch: pa.RecordBatch) -> int:
    """Bytes that a batch takes when each text stands in its row."""
    size = 0
    for column in batch.columns:
        if pa.types.is_dictionary(column.type):
            longest = pc.max(pc.binary_length(column.dictionary.cast(pa.large_binary()))).as_py() or 0
            size += len(column) * (8 + longest)
        else:
            size += column.nbytes
    return size


def _sample(file: pq.ParquetFile) -> Sample:
    """Texts of the first rows by column."""
    names = file.schema_arrow.names
    simple = [one.name for one in file.schema_arrow if not pa.types.is_nested(one.type) and names.count(one.name) == 1]
    batch = next(file.iter_batches(batch_size=SAMPLED, columns=simple[:MOST_SAMPLED]), None)
    if batch is None:
        return [[] for _ in names]
    known = {
        name: [as_text(value)[:LONGEST_SAMPLE] for value in column.to_pylist()]
        for name, column in zip(batch.schema.names, batch.columns, strict=True)
    }
    return [known.get(name, [""] * len(batch)) for name in names]


def _decoded(values: pa.Array) -> pa.Array:
    return values.dictionary_decode() if pa.types.is_dictionary(values.type) else values


def _times(batch: pa.RecordBatch, names: Sequence[str], clock: Clock, source: str) -> Floats:
    """``(n,)`` seconds of the column or the two columns of the time."""
    columns = [_decoded(batch.column(name)) for name in names]
    if len(columns) == 2:
        days, clocks = (column.cast(pa.string()) for column in columns)
        return times.from_days(days, clocks, clock.form, clock.hhmm)
    (values,) = columns
    if is_text(values):
        return times.from_text(values, clock.form)
    if clock.form is not None and pa.types.is_temporal(values.type):
        raise ReadError(f"{source}: {names[0]} holds times of type {values.type}, which take no time_format")
    if clock.form is not None and clock.form not in times.UNITS:
        return times.from_text(values.cast(pa.int64(), safe=False).cast(pa.string()), clock.form)
    return times.from_arrow(values, clock.form)


def _parquet_rows(
    batch: pa.RecordBatch,
    places: Mapping[str, str],
    time: Floats | None,
    shape: geoparquet.Geometry | None,
    first: int,
) -> Rows:
    floats: dict[str, Floats] = {} if time is None else {"time": time}
    others: dict[str, pa.Array] = {}
    for ours, name in places.items():
        values = _decoded(batch.column(name))
        if ours in ("lon", "lat") and is_text(values):
            floats[ours] = coordinates.to_degrees(values, ours, comma=True)
        elif ours in FLOATS:
            values = to_numbers(values, pa.float64()) if is_text(values) else values.cast(pa.float64(), safe=False)
            floats[ours] = values.to_numpy(zero_copy_only=False)
        else:
            others[ours] = values
    if shape is not None:
        x, y = shape.convert(*geoparquet.points(batch.column(shape.column)))
        floats |= {"lon": x, "lat": y} if shape.geodetic else {"x": x, "y": y}

    def text(row: int) -> str:
        return ", ".join(f"{name}={as_text(batch.column(name)[row].as_py())}" for name in batch.schema.names)

    return rows_of(floats, others, np.arange(first, first + len(batch)), text)


def rows_of(
    floats: Mapping[str, Floats], others: Mapping[str, pa.Array], lines: np.ndarray, text: Callable[[int], str]
) -> Rows:
    """A batch of the columns of a table, by our names."""
    geodetic = "lon" in floats
    attributes: dict[str, pa.Array | Floats] = {name: values for name, values in others.items() if name != "track"}
    attributes |= {name: floats[name] for name in ("length", "width") if name in floats}
    if "track" not in others:
        key = attributes.pop("agent")
    elif "agent" not in others:
        key = others["track"]
    else:  # a number of a track may be that of one of each agent
        agent = _as_bytes(others["agent"]).fill_null(b"")
        key = pc.binary_join_element_wise(agent, _as_bytes(others["track"]), PAIRED.encode())
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


def _as_bytes(values: pa.Array) -> pa.Array:
    return (values if is_text(values) else values.cast(pa.string())).cast(pa.binary())


def _position(columns: Columns | None) -> bool:
    return columns is not None and any(name in columns for name in POSITION)


def _line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
