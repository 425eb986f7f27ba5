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
from itertools import accumulate
from typing import Any

import numpy as np
import pyarrow as pa

from wakefold.base.types import Floats
from wakefold.io import times
from wakefold.io.clock import DATES
from wakefold.io.columns import POSITION, Columns, recognised
from wakefold.io.formats.objects import BATCH, MOST_KEYS, WEIGHT, Objects, Thing, moment_of
from wakefold.io.records import Rows, as_text, identity
from wakefold.io.report import ReadError, Tally, some
from wakefold.io.source import Source

MOST_BYTES = 2 << 30
"""The text is held in memory."""
TIMES = ("coordTimes", "times", "datetimes")
ATTRIBUTES = ("agent", "name", "callsign", "type", "destination")
DEGREES = re.compile(r"(CRS84h?|4326)$")
SEAM = 180.0
_DECODER = json.JSONDecoder()
_SKIP = re.compile(r"[\s,\x1e]*")
_SKIP_ENDS = re.compile(r"[\s,\x1e\]}]*")


def read(source: Source, tally: Tally, columns: Columns | None, time_format: str | None) -> Iterator[Rows]:
    """One batch for each line or moving point, and batches of the points; a row is a position."""
    text = as_text(source.whole(MOST_BYTES, WEIGHT))
    system = re.search(r'"crs"\s*:\s*\{[^{}]*\{[^{}]*"name"\s*:\s*"([^"]*)"', text[: 1 << 16])
    if system and not DEGREES.search(system[1]):
        raise ReadError(f"{source.name}: positions in {system[1]}; only longitude and latitude (WGS 84) are read")
    if wrong := [name for name in columns or {} if name in POSITION]:
        raise ReadError(f"{source.name}: positions of GeoJSON are its coordinates, no property: {wrong[0]} (--columns)")
    lines = Lines(source.name, tally, columns, time_format)
    points = Objects(source.name, tally, columns, time_format, geometry=True)
    things: list[Thing] = []
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
                things.append(_thing(line, properties, coordinates[0], time_format))
            else:
                yield lines.rows(line, properties, coordinates, moments)
        if len(things) >= BATCH:
            yield points.rows(things)
            things = []
    if things:
        try:
            batch = points.rows(things)
        except ReadError:
            if columns or not lines.count:
                raise
            tally.rows += len(things)
            tally.reject("no agent", len(things), ((thing.line, json.dumps(thing.row)) for thing in things))
        else:
            yield batch
    lines.check()


def _values(text: str, tally: Tally) -> Iterator[tuple[int, Any]]:
    """Features, and whatever else stands at the top, each with its line; damage is counted and skipped.

    After damage, lines that begin an object are taken one by one, so that what is damaged is looked at once.
    """
    at, line, counted = 0, 1, 0
    while (at := _skip(text, at, _SKIP_ENDS)) < len(text):
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
            break
    damaged = _skip(text, at)
    while at < len(text):
        line += text.count("\n", counted, damaged)
        counted = damaged
        tally.rows += 1
        tally.reject("bad line", 1, [(line, text[damaged : damaged + 1000])])
        at = damaged
        while (at := text.find("\n{", at)) >= 0:  # where the next feature may begin
            at += 1
            end = text.find("\n", at)
            try:
                value = json.loads(text[at : end if end >= 0 else len(text)].rstrip(", \r\x1e"))
            except (ValueError, RecursionError):
                damaged = at
                break
            line += text.count("\n", counted, at)
            counted = at
            yield line, value
        else:
            return


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
    elif kind.startswith("Moving") and kind.endswith("Point"):  # MEOS writes MovingGeomPoint, MovingGeogPoint
        yield from _moving(properties, moving)
    elif kind == "Point":
        yield properties, (moving["coordinates"],), None
    elif kind in ("LineString", "MultiLineString"):
        nested = properties.get("coordinateProperties") or {}
        moments = next((properties[key] for key in TIMES if key in properties), nested.get("times"))
        if kind == "LineString":
            yield properties, list(moving["coordinates"]), moments
        else:
            for part, own in _joined(*_parts([list(part) for part in moving["coordinates"]], moments)):
                yield properties, part, own


def _parts(parts: list[list[Any]], moments: Any) -> tuple[list[list[Any]], list[Any]]:
    """The times of each part: of lists of times one for each, of one list over all parts its pieces in turn."""
    if not isinstance(moments, list):
        return parts, [None] * len(parts)
    if all(isinstance(own, list) for own in moments):
        return parts, [*moments, *[[]] * len(parts)][: len(parts)]
    ends = list(accumulate(map(len, parts)))
    if len(moments) != ends[-1]:  # which times are whose is not known
        return parts, [[]] * len(parts)
    return parts, [moments[end - len(part) : end] for part, end in zip(parts, ends, strict=True)]


def _joined(parts: list[list[Any]], moments: list[Any]) -> Iterator[tuple[list[Any], Any]]:
    """Parts that a cut at the antimeridian (RFC 7946, 3.1.9) made of one line, as that line again.

    The points of the cut, which have no time of their own (null), are left out.
    """
    k = 0
    while k < len(parts):
        part, own = list(parts[k]), moments[k]
        while k + 1 < len(parts) and _cut(part, parts[k + 1], own, moments[k + 1]):
            part = [*part[:-1], *parts[k + 1][1:]]
            own = None if own is None else [*own[:-1], *moments[k + 1][1:]]
            k += 1
        yield part, own
        k += 1


def _cut(before: list[Any], after: list[Any], times_before: Any, times_after: Any) -> bool:
    """Whether a line goes on at the other side of the antimeridian, at points that only the cut made."""
    if not before or not after:
        return False
    end, begin = before[-1], after[0]
    there = abs(end[0]) == SEAM and begin[0] == -end[0] and end[1] == begin[1]
    if times_before is None or times_after is None or not there:
        return there and times_before is None and times_after is None
    if len(times_before) != len(before) or len(times_after) != len(after):
        return False
    return times_before[-1] is None and times_after[0] is None


def _moving(properties: dict[str, Any], moving: dict[str, Any]) -> Iterator[tuple[dict[str, Any], Any, Any]]:
    """The sequences of a moving point, whose times are a tuple: of numbers they are milliseconds."""
    for sequence in moving.get("sequences") or [moving]:
        coordinates, moments = list(sequence["coordinates"]), sequence["datetimes"]
        if not isinstance(coordinates[0], list):  # a single instant
            coordinates, moments = [coordinates], [moments] if isinstance(moments, (str, int, float)) else moments
        yield properties, coordinates, tuple(moments)


class Lines:
    """Makes a batch of each line. ``count`` of them came."""

    def __init__(self, source: str, tally: Tally, columns: Columns | None, time_format: str | None) -> None:
        self.source, self.tally, self.time_format = source, tally, time_format
        self.columns = {name: str(where) for name, where in (columns or {}).items()}
        self.count = 0
        self._keys: dict[str, None] = {}

    def rows(self, line: int, properties: dict[str, Any], coordinates: list[Any], moments: Any) -> Rows:
        """The rows of a line; a list of times is those of its properties, a tuple that of MF-JSON."""
        self.count += 1
        if len(self._keys) < MOST_KEYS:
            self._keys |= dict.fromkeys(properties)
        found = recognised(list(properties)) | {k: v for k, v in self.columns.items() if v in properties}
        if "agent" in self.columns:
            found.pop("track", None)
        if "time" in self.columns and not isinstance(moments, tuple):
            moments = properties.get(self.columns["time"])
        n = len(coordinates)
        time = self._times(coordinates, moments)
        named = next((properties[found[key]] for key in ("track", "agent", "name") if key in found), None)
        texts = {key: as_text(properties[found[key]]) for key in ATTRIBUTES if key in found}
        sizes = {key: times.number(properties[found[key]]) for key in ("length", "width") if key in found}
        shown = moments if isinstance(moments, (list, tuple)) else []
        return Rows(
            agent=identity(named) or "track",
            time=time,
            position=_positions(coordinates),
            geodetic=True,
            lines=np.full(n, line),
            text=lambda row: f"{coordinates[row]} {shown[row] if row < len(shown) else ''}",
            attributes={key: pa.array([value] * n) for key, value in texts.items()}
            | {key: np.full(n, value) for key, value in sizes.items()},
        )

    def _times(self, coordinates: list[Any], moments: Any) -> Floats | None:
        """Times of a line; without any, those of its fourth coordinates if these can be."""
        n = len(coordinates)
        if isinstance(moments, (list, tuple)):
            form = "ms" if isinstance(moments, tuple) and self.time_format is None else self.time_format
            time = np.full(n, np.nan)
            if len(moments) <= n:  # of more, nobody knows which are whose
                for k, value in enumerate(moments):
                    time[k] = moment_of(value, None if isinstance(value, str) and form == "ms" else form)
            return time
        fourth = np.array([_fourth(place) for place in coordinates])
        seconds = fourth_as_times(fourth, self.time_format)
        if seconds is not None:
            self.tally.note("{n} times are the fourth coordinate of a position", n)
        return seconds

    def check(self) -> None:
        """Refuse a property that the caller names and no line has.

        Raises:
            ReadError: there is one.
        """
        for ours, theirs in self.columns.items() if self.count else ():
            if theirs not in self._keys:
                raise ReadError(
                    f"{self.source}: no property {theirs!r} (for {ours}); there are {some(list(self._keys))}"
                )


def _fourth(place: Any) -> float:
    return times.number(place[3]) if isinstance(place, list) and len(place) > 3 else np.nan


def fourth_as_times(fourth: Floats, form: str | None) -> Floats | None:
    """Seconds of fourth coordinates ``(n,)`` if they are dates in order; else None, as they are a measure."""
    if not len(fourth) or np.isnan(fourth).any() or (np.diff(fourth) < 0).any():
        return None
    for unit, per_second in times.PER_SECOND.items():
        low, high = (limit * per_second for limit in DATES)
        if (form is None or form == unit) and (fourth >= low).all() and (fourth < high).all():
            return fourth / per_second
    return None


def _thing(line: int, properties: dict[str, Any], place: Any, form: str | None) -> Thing:
    """A point as a row of the table of all points."""
    pair = place if isinstance(place, list) and len(place) >= 2 else (None, None)
    moment = fourth_as_times(np.array([_fourth(place)]), form)
    where = times.number(pair[0]), times.number(pair[1])
    return Thing(line, properties, where, np.nan if moment is None else float(moment[0]))


def _positions(coordinates: list[Any]) -> tuple[Floats, Floats]:
    """Longitudes and latitudes; NaN where a position is none."""
    pairs = [c if isinstance(c, list) and len(c) >= 2 else (None, None) for c in coordinates]
    return np.array([times.number(p[0]) for p in pairs]), np.array([times.number(p[1]) for p in pairs])
