# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
"""Points of a GeoParquet geometry column (version 1.0 and 1.1: WKB or the native ``point`` encoding)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from wakefold.base.types import Floats

POINT_BYTES = 21
"""Byte order, type and two coordinates in well-known binary; z and m follow after."""


@dataclass(frozen=True)
class Geometry:
    """A geometry column: its name, whether it is in degrees, and how its coordinates become ours."""

    column: str
    geodetic: bool
    convert: Callable[[Floats, Floats], tuple[Floats, Floats]]


def geometry(schema: pa.Schema) -> Geometry | None:
    """The primary geometry column that the file's ``geo`` metadata describe; None without any.

    Coordinates in a projected reference system are turned into degrees; without a stated system they are degrees
    (as the standard has it), with the system null they are taken as a plane.

    Raises:
        ValueError, KeyError, TypeError: the metadata are damaged.
    """
    meta = (schema.metadata or {}).get(b"geo")
    if meta is None:
        return None
    geo = json.loads(meta)
    name = geo["primary_column"]
    column = geo["columns"][name]
    if "crs" not in column or column["crs"] is None:
        return Geometry(name, "crs" not in column, lambda x, y: (x, y))
    from pyproj import CRS, Transformer

    crs = CRS.from_user_input(column["crs"])
    if crs.is_geographic:
        return Geometry(name, True, lambda x, y: (x, y))
    return Geometry(name, True, Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform)


def points(values: pa.Array) -> tuple[Floats, Floats]:
    """x and y ``(n,)`` of WKB or native points; NaN for nulls and for other geometries."""
    if pa.types.is_struct(values.type):
        x, y = (pc.struct_field(values, name).cast(pa.float64()) for name in "xy")
        return x.to_numpy(zero_copy_only=False), y.to_numpy(zero_copy_only=False)
    start = pc.binary_slice(values.cast(pa.binary()), 0, POINT_BYTES)
    whole = pc.equal(pc.binary_length(start), POINT_BYTES).fill_null(False)
    start = pc.if_else(whole, start, bytes(POINT_BYTES)).cast(pa.binary(POINT_BYTES))
    raw = np.frombuffer(start.buffers()[1], dtype=np.uint8)[start.offset * POINT_BYTES :].reshape(-1, POINT_BYTES)

    def read(at: int, kind: str) -> Any:
        cells = np.ascontiguousarray(raw[: len(values), at : at + int(kind[1])])
        little = raw[: len(values), 0] == 1
        return np.where(little, cells.view(f"<{kind}")[:, 0], cells.view(f">{kind}")[:, 0])

    point = (read(1, "u4") & 0x0FFFFFFF) % 1000 == 1  # with the flags of extended WKB and the thousands of ISO's z, m
    return np.where(point, read(5, "f8"), np.nan), np.where(point, read(13, "f8"), np.nan)
