"""GeoJSON (RFC 7946), also one feature a line, and MF-JSON (OGC 19-045r3): lines and points in time.

A LineString has its times in the property ``coordTimes``, ``times``, ``datetimes`` or ``coordinateProperties.times``:
ISO 8601 or seconds. Point features are rows of a table whose columns are their properties. MF-JSON has a
``temporalGeometry`` of type MovingPoint (or a MovingPoint by itself) with ``coordinates`` and ``datetimes``, ISO 8601
or milliseconds. Features are taken from the text one by one, so that a damaged one costs little more than itself.
"""

from __future__ import annotations

import json
import re
from collections.abc import Generator, Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from wakefold.io import times
from wakefold.io.formats.tables import recognised
from wakefold.io.records import Rows, as_text
from wakefold.io.report import ReadError, Tally
from wakefold.io.source import Source

MOST_BYTES = 2 << 30
"""The text is held in memory."""
BATCH = 50_000
TIMES = ("coordTimes", "times", "datetimes")
ATTRIBUTES = ("agent", "name", "callsign", "type", "destination")
DEGREES = re.compile(r"(CRS84h?|4326)$")
_DECODER = json.JSONDecoder()
_SKIP = re.compile(r"[\s,\x1e]*")
_SKIP_ENDS = re.compile(r"[\s,\x1e\]}]*")


def read(source: Source, tally: Tally) -> Iterator[Rows]:
    """One batch for each line or moving point, and batches of the points; a row is a position."""
    text = as_text(source.whole(MOST_BYTES))
    system = re.search(r'"crs"\s*:\s*\{[^{}]*\{[^{}]*"name"\s*:\s*"([^"]*)"', text[: 1 << 16])
    if system and not DEGREES.search(system[1]):
        raise ReadError(f"{source.name}: positions in {system[1]}; only longitude and latitude (WGS 84) are read")
    points: list[tuple[int, dict[str, Any], Any]] = []
    for line, value in _values(text, tally):
        try:
            tracks = list(_tracks(value))
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError):
            tracks = []
        if not tracks:
            tally.rows += 1
            tally.reject("not a track", 1, [(line, json.dumps(value)[:1000])])
        for properties, coordinates, moments in tracks:
            if isinstance(coordinates, tuple):
                points.append((line, properties, coordinates[0]))
            else:
                yield _line(line, properties, coordinates, moments)
        if len(points) >= BATCH:
            yield _points(points)
            points = []
    if points:
        yield _points(points)


def _values(text: str, tally: Tally) -> Iterator[tuple[int, Any]]:
    """Features, and whatever else stands at the top, each with its line; damage is counted and skipped."""
    at, line, counted, resumed = 0, 1, 0, -1
    while (at := _skip(text, at, _SKIP_ENDS)) < len(text):  # after damage, the ends of what it was in
        reader = _object(text, at)
        try:
            while True:
                place, end, value = next(reader)
                line += text.count("\n", counted, place)
                counted = place
                at = end
                yield line, value
        except StopIteration as end:
            at = end.value
        except (ValueError, IndexError, RecursionError):
            if at != resumed:  # else it is the same damage, counted when it was met
                damaged = _skip(text, at)
                tally.rows += 1
                tally.reject("bad line", 1, [(text.count("\n", 0, damaged) + 1, text[damaged : damaged + 1000])])
            at = text.find("\n{", at) + 1  # where the next feature may begin
            if at == 0:
                return
            resumed = at


def _object(text: str, at: int) -> Generator[tuple[int, int, Any], None, int]:
    """The features of the collection, or else the object, that begins at a place, each with where it begins and ends.

    Returns:
        Where all ends.

    Raises:
        ValueError, IndexError, RecursionError: it is damaged.
    """
    if text[at] != "{":
        raise ValueError("not an object")
    start, members, collection = at, {}, False
    at = _skip(text, at + 1)
    while text[at] != "}":
        key, at = _DECODER.raw_decode(text, at)
        at = _skip(text, at)
        if text[at] != ":":
            raise ValueError("no value")
        at = _skip(text, at + 1)
        if key == "features" and text[at] == "[":
            collection = True
            at = _skip(text, at + 1)
            while text[at] != "]":
                value, end = _DECODER.raw_decode(text, at)
                yield at, end, value
                at = _skip(text, end)
            at += 1
        else:
            members[key], at = _DECODER.raw_decode(text, at)
        at = _skip(text, at)
    if not collection:
        yield start, at + 1, members
    return at + 1


def _skip(text: str, at: int, what: re.Pattern[str] = _SKIP) -> int:
    """Past white space, commas and record separators."""
    match = what.match(text, at)
    assert match is not None
    return match.end()


def _tracks(value: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Any, Any]]:
    """Properties, coordinates and times of each line in a feature or geometry; a point's coordinates in a tuple.

    Raises:
        KeyError, TypeError, ...: it is not built as the standards say.
    """
    feature = value if value.get("type") == "Feature" else {"geometry": value}
    properties = dict(feature.get("properties") or {})
    if "id" in feature:
        properties.setdefault("id", feature["id"])
    moving = feature.get("temporalGeometry") or feature["geometry"]
    kind = moving["type"]
    if kind == "MovingGeometryCollection":
        for prism in moving["prisms"]:
            yield from _moving(properties, prism)
    elif kind == "MovingPoint":
        yield from _moving(properties, moving)
    elif kind == "Point":
        yield properties, (moving["coordinates"],), None
    elif kind in ("LineString", "MultiLineString"):
        nested = properties.get("coordinateProperties") or {}
        moments = next((properties[key] for key in TIMES if key in properties), nested.get("times"))
        if kind == "LineString":
            yield properties, list(moving["coordinates"]), moments
        else:
            parts = list(moving["coordinates"])
            yield from ((properties, list(part), moments and moments[i]) for i, part in enumerate(parts))


def _moving(properties: dict[str, Any], moving: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Any, Any]]:
    """The sequences of a MovingPoint, milliseconds made seconds."""
    for sequence in moving.get("sequences") or [moving]:
        coordinates, moments = list(sequence["coordinates"]), sequence["datetimes"]
        if not isinstance(coordinates[0], list):  # a single instant
            coordinates, moments = [coordinates], [moments] if isinstance(moments, (str, int, float)) else moments
        yield properties, coordinates, [m / 1000 if isinstance(m, (int, float)) else m for m in moments]


def _line(line: int, properties: dict[str, Any], coordinates: list[Any], moments: Any) -> Rows:
    found = recognised(list(properties))
    n = len(coordinates)
    time = None
    if isinstance(moments, list):
        time = np.full(n, np.nan)
        time[: len(moments)] = [times.parse(moment) for moment in moments[:n]]
    named = next((properties[found[key]] for key in ("track", "agent", "name") if key in found), None)
    texts = {key: as_text(properties[found[key]]) for key in ATTRIBUTES if key in found}
    sizes = {key: times.number(properties[found[key]]) for key in ("length", "width") if key in found}
    return Rows(
        agent=as_text(named) or "track",
        time=time,
        position=_positions(coordinates),
        geodetic=True,
        lines=np.full(n, line),
        text=lambda row: f"{coordinates[row]} {moments[row] if time is not None and row < len(moments) else ''}",
        attributes={key: pa.array([value] * n) for key, value in texts.items()}
        | {key: np.full(n, value) for key, value in sizes.items()},
    )


def _points(points: list[tuple[int, dict[str, Any], Any]]) -> Rows:
    found = [recognised(list(properties)) for _, properties, _ in points]

    def values(*keys: str) -> list[Any]:
        return [
            next((properties[where[key]] for key in keys if key in where), None)
            for (_, properties, _), where in zip(points, found, strict=True)
        ]

    timed = any("time" in where for where in found)
    return Rows(
        agent=pa.array([as_text(value) for value in values("track", "agent")]),
        time=np.array([times.parse(value) for value in values("time")]) if timed else None,
        position=_positions([place for _, _, place in points]),
        geodetic=True,
        lines=np.array([line for line, _, _ in points]),
        text=lambda row: json.dumps({"coordinates": points[row][2], **points[row][1]})[:1000],
        attributes={key: pa.array([as_text(value) for value in values(key)]) for key in ATTRIBUTES},
    )


def _positions(coordinates: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes; NaN where a position is none."""
    pairs = [c if isinstance(c, list) and len(c) >= 2 else (None, None) for c in coordinates]
    return np.array([times.number(p[0]) for p in pairs]), np.array([times.number(p[1]) for p in pairs])
