"""Tracks written for other programs, and for ``read_tracks``: CSV, Parquet, GeoJSON."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from wakefold.base.checks import instance
from wakefold.io.records import identity
from wakefold.tracks.projection import cut_at_seam
from wakefold.tracks.tracks import Tracks

FORMATS = {".csv": "csv", ".parquet": "parquet", ".geojson": "geojson", ".json": "geojson"}


def write(tracks: Tracks, path: Path, format: str | None) -> None:
    """See ``wakefold.io.write_tracks``."""
    format = FORMATS.get(path.suffix.lower()) if format is None else format
    if format in FORMATS.values():
        _check_names(tracks, lines=format == "csv")
    if format == "csv":
        pyarrow.csv.write_csv(_table(tracks), path)
    elif format == "parquet":
        pq.write_table(_table(tracks), path)
    elif format == "geojson":
        _write_geojson(tracks, path)
    else:
        raise ValueError(
            f"tracks are written as {', '.join(sorted(set(FORMATS.values())))}, not {format or path.name!r}"
        )


def _check_names(tracks: Tracks, lines: bool) -> None:
    """Refuse ids that would be read back as others, and with ``lines`` texts that would break their line.

    Raises:
        ValueError: such an id or text.
    """
    texts = {"id": tracks.ids, **{name: v for name, v in tracks.attributes.items() if v.dtype.kind == "U"}}
    for name, values in texts.items():
        for value in dict.fromkeys(values.tolist()):
            if name == "id" and (not value or identity(value) != value):
                raise ValueError(f"the track id {value!r} would be read back as {identity(value)!r}: give it another")
            if lines and ("\n" in value or "\r" in value):
                raise ValueError(f"the {name} {value!r} has a line end, which a CSV file cannot hold")


def _table(tracks: Tracks) -> pa.Table:
    if tracks.dim == 1:
        raise ValueError("tracks of one dimension have no place in a table of positions")
    track = np.repeat(np.arange(len(tracks)), tracks.lengths)
    columns: dict[str, Any] = {"track": pa.array(tracks.ids.tolist(), pa.string()).take(pa.array(track))}
    columns["time"] = tracks.times
    names = ("x", "y", "z")
    points = tracks.points
    if tracks.projection is not None:
        names, points = ("lon", "lat"), tracks.projection.to_geodetic(points)
    columns |= {name: np.ascontiguousarray(points[:, i]) for i, name in zip(range(tracks.dim), names, strict=False)}
    columns |= tracks.columns
    for name, values in tracks.attributes.items():
        if name not in columns:
            columns[name] = pa.array(values.tolist(), from_pandas=True).take(pa.array(track))
    return pa.table(columns)


def _write_geojson(tracks: Tracks, path: Path) -> None:
    if tracks.projection is None:
        raise ValueError("GeoJSON holds longitude and latitude; write planar tracks as CSV or Parquet")
    with path.open("w", encoding="utf-8") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for i, points in enumerate(tracks):
            lonlat = tracks.projection.to_geodetic(points)
            places = lonlat.tolist()
            moments = tracks.times_of(i).tolist()
            properties = {name: values[i].item() for name, values in tracks.attributes.items()}
            properties = {name: value for name, value in properties.items() if value == value}  # JSON has no NaN
            properties["track"] = str(tracks.ids[i])
            if len(places) == 1:
                geometry = {"type": "Point", "coordinates": places[0]}
                properties["time"] = moments[0]
            elif len(parts := cut_at_seam(lonlat)) == 1:
                geometry = {"type": "LineString", "coordinates": places}
                properties["times"] = moments
            else:  # positions that the cut made have no time
                geometry = {"type": "MultiLineString", "coordinates": [part.tolist() for part, _ in parts]}
                properties["times"] = [[None if k < 0 else moments[k] for k in rows] for _, rows in parts]
            feature = {"type": "Feature", "properties": properties, "geometry": geometry}
            file.write((",\n" if i else "\n") + json.dumps(feature, allow_nan=False, ensure_ascii=False))
        file.write("\n]}\n")


def write_tracks(tracks: Tracks, path: str | PathLike[str], format: str | None = None) -> None:
    """Write tracks to a file that ``read_tracks`` reads back.

    CSV and Parquet have a row for each point: ``track``, ``time`` (seconds), ``lon`` and ``lat`` (or ``x``, ``y`` and
    ``z``), the per-point columns and the attributes of the track. GeoJSON has a LineString for each track (a Point
    for a track of one point; a MultiLineString for one that crosses the antimeridian, at which it is cut) with its
    times (seconds) and attributes as properties; per-point columns are left out.

    Args:
        path: where to.
        format: "csv", "parquet" or "geojson"; by the ending of the name if not given.

    Raises:
        ValueError: no such format; planar tracks as GeoJSON, which knows longitude and latitude only; 1-D tracks; an
            id that would be read back as another (blanks around it, "7.0"), or in CSV a text with a line end.
    """

    instance(tracks, Tracks, "write_tracks takes Tracks")
    write(tracks, Path(instance(path, (str, PathLike), "write_tracks takes a path")), format)
