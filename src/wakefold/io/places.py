"""A file of places (berths, quays, moorings): a CSV with columns lon and lat, or points in GeoJSON."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 64 << 20
AXES = (("lon", "lat"), ("longitude", "latitude"), ("x", "y"))  # the last of a plane too


def read_places(path: str | os.PathLike[str], planar: bool = False) -> NDArray[np.float64]:
    """``(B, 2)`` longitude and latitude, or x and y, as they stand in the file.

    Args:
        path: a CSV whose header names ``lon`` and ``lat`` (or ``longitude`` and ``latitude``, or ``x`` and ``y``, in
            any case; other columns are not read), or GeoJSON of Point and MultiPoint geometries.
        planar: for tracks in a plane, where longitudes and latitudes say nothing: ``x`` and ``y`` only.

    Raises:
        ValueError: a file of neither kind, degrees for a plane, or a place that is no place; the message names the
            file and the line.
        OSError: a file that cannot be read.
    """
    file = Path(path)
    if file.stat().st_size > MOST_BYTES:
        raise ValueError(f"{file}: more than {MOST_BYTES >> 20} MiB are no list of places")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: not text in UTF-8 ({error.reason} at byte {error.start})") from None
    if text.lstrip()[:1] not in ("{", "["):
        found = _rows(file, text, planar)
    elif planar:
        raise ValueError(
            f"{file}: GeoJSON holds longitude and latitude, and the tracks are planar: give x and y in a CSV"
        )
    else:
        found = _points(file, text)
    out = []
    for where, pair in found:
        try:
            x, y = (float(value) for value in pair[:2])
        except (TypeError, ValueError, KeyError):
            x = y = math.nan
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"{file}, {where}: not two numbers: {str(pair)[:80]}")
        out.append((x, y))
    return np.array(out, dtype=np.float64).reshape(-1, 2)


def _rows(file: Path, text: str, planar: bool) -> Iterator[tuple[str, Any]]:
    rows = csv.reader(text.splitlines())
    header = [name.strip().lower() for name in next(rows, [])]
    for first, second in AXES[-1:] if planar else AXES:
        if first in header and second in header:
            x, y = header.index(first), header.index(second)
            break
    else:
        wanted = "x and y, as the tracks are planar" if planar else "lon and lat (or x and y), or GeoJSON"
        raise ValueError(f"{file}: places need a header with {wanted}; got {header[:8]}")
    for row in rows:
        if row:
            yield f"line {rows.line_num}", [row[x], row[y]] if len(row) > max(x, y) else row[:1]


def _points(file: Path, text: str) -> Iterator[tuple[str, Any]]:
    try:
        whole = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"{file}: damaged GeoJSON ({error})") from None
    features = whole.get("features", [whole]) if isinstance(whole, dict) else whole
    for k, feature in enumerate(features if isinstance(features, list) else [features]):
        geometry = feature.get("geometry", feature) if isinstance(feature, dict) else None
        kind = geometry.get("type") if isinstance(geometry, dict) else None
        if not isinstance(geometry, dict) or kind not in ("Point", "MultiPoint"):
            raise ValueError(f"{file}, feature {k + 1}: places are points, not {kind or type(feature).__name__}")
        places = geometry.get("coordinates")
        for place in [places] if kind == "Point" else places if isinstance(places, list) else [None]:
            yield f"feature {k + 1}", place
