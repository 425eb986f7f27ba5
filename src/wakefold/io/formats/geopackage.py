"""GeoPackage (OGC 12-128): points as rows of a table, lines with their fourth coordinate (M) as time; by sqlite3.

The file is a database that somebody else wrote: it is opened to read only, no view, trigger or virtual table of it
runs, and only the tables that it lists as features are read.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from wakefold.io.columns import Columns
from wakefold.io.coordinates import DEGREES
from wakefold.io.formats.geojson import Lines
from wakefold.io.formats.objects import BATCH, Objects, Thing
from wakefold.io.records import Rows
from wakefold.io.report import ReadError, Tally
from wakefold.io.source import Source

MOST_BYTES = 2 << 30
LONGEST_VALUE = 32 << 20
ENVELOPES = (0, 32, 48, 48, 64)
"""Bytes of the envelope in the header of a geometry, by its code."""
PLANE = -1
"""The reference system of a plane that nobody knows."""


class _Layer(NamedTuple):
    table: str
    column: str
    geodetic: bool
    convert: Callable[[Any, Any], tuple[Any, Any]] | None


def read(source: Source, tally: Tally, columns: Columns | None, time_format: str | None) -> Iterator[Rows]:
    """Batches of points, and one for each line; a row is a position, its line the row of its table."""
    try:
        base = _opened(source)
        layers = list(_layers(source.name, base))
        if not layers:
            raise ReadError(f"{source.name}: a GeoPackage without a table of features")
        for layer in layers:
            yield from _rows(source.name, base, layer, tally, columns, time_format)
    except (sqlite3.Error, UnicodeError, OverflowError) as error:  # also of messages that name damaged names
        raise ReadError(f"{source.name}: the GeoPackage cannot be read ({error})") from None


def _opened(source: Source) -> sqlite3.Connection:
    if source.path is not None:
        base = sqlite3.connect(f"{source.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    else:
        base = sqlite3.connect(":memory:")
        base.deserialize(source.whole(MOST_BYTES))
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_VALUE)
    base.text_factory = lambda raw: raw.decode("utf-8", "replace")
    base.execute("PRAGMA trusted_schema = OFF")
    base.execute("PRAGMA cell_size_check = ON")
    return base


def _layers(name: str, base: sqlite3.Connection) -> Iterator[_Layer]:
    real = {
        table
        for table, sql in base.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'")
        if isinstance(table, str) and isinstance(sql, str) and sql.lstrip().upper().startswith("CREATE TABLE")
    }
    if not {"gpkg_contents", "gpkg_geometry_columns", "gpkg_spatial_ref_sys"} <= real:
        raise ReadError(f"{name}: an SQLite database that is no GeoPackage")
    systems = {
        srs: (organization, code)
        for srs, organization, code in base.execute(
            "SELECT srs_id, organization, organization_coordsys_id FROM gpkg_spatial_ref_sys"
        )
    }
    for table, column, srs in base.execute("SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns"):
        if table in real and isinstance(column, str):
            yield _Layer(table, column, *_system(name, srs, systems.get(srs)))


def _system(
    name: str, srs: Any, known: tuple[Any, Any] | None
) -> tuple[bool, Callable[[Any, Any], tuple[Any, Any]] | None]:
    """Whether positions are degrees, or become degrees by a conversion."""
    if srs == PLANE:
        return False, None
    if srs in DEGREES or known is None:
        return True, None
    from pyproj import CRS, Transformer
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_authority(str(known[0]), str(known[1]))
    except CRSError:
        raise ReadError(f"{name}: positions in {known[0]}:{known[1]}, which is not known") from None
    return True, None if system.is_geographic else Transformer.from_crs(system, "EPSG:4326", always_xy=True).transform


def _rows(
    name: str, base: sqlite3.Connection, layer: _Layer, tally: Tally, columns: Columns | None, time_format: str | None
) -> Iterator[Rows]:
    points = Objects(name, tally, columns, time_format, geometry=True)
    points.geodetic = layer.geodetic
    lines = Lines(name, tally, columns, time_format)
    things: list[Thing] = []
    table = layer.table.replace('"', '""')
    rows = base.execute(f'SELECT * FROM "{table}"')
    names = [described[0] for described in rows.description]
    where = names.index(layer.column) if layer.column in names else -1
    for number, values in enumerate(rows, 1):
        row = {key: value for key, value in zip(names, values, strict=True) if not isinstance(value, bytes)}
        try:
            parts = geometry(values[where]) if where >= 0 else []
        except (ValueError, struct.error, TypeError, IndexError):
            parts = []
        if parts and layer.convert is not None:
            parts = [[[*layer.convert(place[0], place[1]), *place[2:]] for place in part] for part in parts]
        if len(parts) == 1 and len(parts[0]) == 1:
            things.append(Thing(number, row, (parts[0][0][0], parts[0][0][1])))
        elif parts and layer.geodetic:
            for part in parts:
                yield lines.rows(number, row, part, None)
        else:
            tally.rows += 1
            tally.reject("not a track", 1, [(number, str(row)[:200])])
        if len(things) >= BATCH:
            yield points.rows(things)
            things = []
    if things:
        yield points.rows(things)
    lines.check()


def geometry(blob: bytes) -> list[list[list[float]]]:
    """The parts of a point, line or collection of lines: positions x, y, z (0 without) and m, if there is one.

    Raises:
        ValueError, struct.error, TypeError: it is none of these.
    """
    if blob[:2] != b"GP":
        raise ValueError("no geometry")
    flags = blob[3]
    parts, _ = _well_known(blob, 8 + ENVELOPES[flags >> 1 & 7], 0)
    return parts


def _well_known(raw: bytes, at: int, depth: int) -> tuple[list[list[list[float]]], int]:
    order = "<" if raw[at] == 1 else ">"
    (kind,) = struct.unpack_from(f"{order}I", raw, at + 1)
    at += 5
    above, kind = divmod(kind & 0x0FFFFFFF, 1000)
    size = (2, 3, 3, 4)[above]

    def places(count: int, at: int) -> list[list[float]]:
        if count * size * 8 > len(raw) - at:
            raise ValueError("cut off")
        flat = struct.unpack_from(f"{order}{count * size}d", raw, at)
        rows = [list(flat[k : k + size]) for k in range(0, len(flat), size)]
        return [[*row[:2], 0.0, row[2]] for row in rows] if above == 2 else rows  # x, y, m

    if kind == 1:
        return [places(1, at)], at + 8 * size
    (count,) = struct.unpack_from(f"{order}I", raw, at)
    at += 4
    if kind == 2:
        return [places(count, at)], at + 8 * size * count
    if kind not in (4, 5) or depth or count > len(raw):
        raise ValueError("neither points nor lines")
    parts: list[list[list[float]]] = []
    for _ in range(count):
        more, at = _well_known(raw, at, 1)
        parts += more
    return parts, at
