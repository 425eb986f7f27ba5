"""Observations of many agents as a feed, one line each: CSV or JSON lines.

A feed may be endless, so everything here works on the lines that are there, and a line that cannot be used costs itself
only: it comes out as a ``Refused`` that says which field is wrong. docs/cli.md describes the lines.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from io import BufferedIOBase
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from wakefold.base.checks import shown
from wakefold.base.wording import escaped
from wakefold.evidence.coarse import CONFIDENCE, CoarseClass
from wakefold.evidence.evidence import Evidence
from wakefold.evidence.fix import Fix
from wakefold.io.columns import recognised
from wakefold.io.coordinates import degrees
from wakefold.io.records import identity, plain
from wakefold.io.report import ReadError, listed, some
from wakefold.io.times import Moment, formatted, number, of_day, parse, within

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration

Form = Literal["csv", "jsonl"]
Lines = Sequence[tuple[int, bytes]]  # with their numbers
BLOCK = 1 << 18  # bytes that are read at once: some thousands of lines
BOM = b"\xef\xbb\xbf"
LONGEST_LINE = 1 << 16  # bytes; an observation is some tens of them
LONGEST_NAME = 200  # characters of an agent's name
FIELDS = ("agent", "track", "time", "lon", "lat", "x", "y", "z")  # under the names that `tables` recognises
MORE_FIELDS = ("sd", "class", "level", "confidence")
LARGEST = 1e100  # of numbers; their squares still are numbers


class Observation(NamedTuple):
    """What was seen of one agent at one time; neither a fix nor a class is a time at which nothing was seen.

    Attributes:
        line: number of the line it stands on, from 1.
        agent: name.
        time: seconds UTC since 1970 (or on the data's own clock).
        stamp: the time as it was written.
        fix: a position.
        class_: a class id, or ``track:NAME`` for the class that holds this track at the level.
        level: of the class, metres; the birth of the class without it.
        confidence: probability that the report of the class is right.
        note: what was passed over, for whoever runs the feed.
    """

    line: int
    agent: str
    time: float
    stamp: str | float
    fix: Fix | None = None
    class_: int | str | None = None
    level: float | None = None
    confidence: float = CONFIDENCE
    note: str | None = None

    def coarse(self, tree: Filtration) -> list[Evidence]:
        """The report of a class as evidence, an empty list if there is none.

        Raises:
            ValueError: no such class or track, or it is not alive at the level; the message begins with the field.
        """
        if self.class_ is None:
            return []
        try:
            if isinstance(self.class_, int):
                item = CoarseClass(self.class_, self.level, self.confidence)
                item.at_level(tree)
                return [item]
            if self.level is None:
                raise ValueError("a class given by a track needs a level")
            named = tree.class_at(self.class_.removeprefix("track:"), self.level)
            return [CoarseClass(named, self.level, self.confidence)]
        except ValueError as error:
            raise ValueError(f"class: {error}") from None


class Refused(NamedTuple):
    """A line that is no observation, and why: the field first."""

    line: int
    why: str


def form_of(first: bytes) -> Form:
    """Whether a feed is JSON lines or CSV, by its first line that is not blank."""
    return "jsonl" if first.removeprefix(BOM).lstrip().startswith(b"{") else "csv"


def header_problem(first: bytes, columns: Mapping[str, str | int] | None = None) -> str | None:
    """What the first line of a CSV feed lacks to be a header of observations; None if nothing."""
    names = _layout(first.removeprefix(BOM))[1]
    for ours, name in (columns or {}).items():
        if not _there(name, names):
            return f"no column {name!r} (for {ours}) among {some(names)}"[:500]
    found = _Names(columns or {}).ours(tuple(names))
    missing = [] if {"agent", "track"} & found.keys() else ["agent"]
    missing += [] if "time" in found else ["time"]
    if not ({"lon", "lat"} <= found.keys() or {"x", "class"} & found.keys()):
        missing.append("lon and lat (or x and y, or class)")
    return f"no column for {listed(missing)} among {some(names)}"[:500] if missing else None


def _there(name: str | int, names: Iterable[str]) -> bool:
    """Whether a field that the caller names is there; ``Date+Time`` is two."""
    there = {*names}
    return name in there or (isinstance(name, str) and "+" in name and set(map(str.strip, name.split("+"))) <= there)


def read(
    blocks: Iterable[Lines],
    columns: Mapping[str, str | int] | None = None,
    time_format: str | None = None,
) -> Iterator[list[Observation | Refused]]:
    """Observations of a feed, block by block, as its lines come.

    Args:
        blocks: lines with their numbers from 1, with or without their ends; blank ones are skipped.
        columns: the feed's names of fields, by ours, where they do not speak for themselves.
        time_format: see ``wakefold.io.times``.

    Raises:
        ReadError: the header of a CSV feed does not say who and when.
    """
    fields: Callable[[bytes], Mapping[str, Any]] | None = None
    stated = frozenset(columns or ())
    for block in blocks:
        lines = [(n, line.removeprefix(BOM)) for n, line in block if line.strip()]
        if lines and fields is None:
            first = lines[0][1]
            if b"\0" in first:
                raise ReadError("observations: text in UTF-16, or binary data; a feed is UTF-8")
            if form_of(first) == "jsonl":
                fields = _JsonFields(columns or {})
            elif problem := header_problem(first, columns):
                raise ReadError(f"observations: {problem}")
            else:
                fields = _CsvFields(first, columns or {})
                del lines[0]
        seen: list[Observation | Refused] = []
        for n, line in lines:
            assert fields is not None
            try:
                if len(line) > LONGEST_LINE:
                    raise ValueError(f"line: longer than {LONGEST_LINE:,} bytes")
                seen.append(_observation(n, fields(line), time_format, stated))
            except ValueError as error:
                seen.append(Refused(n, str(error)))
        if seen:
            yield seen


def is_feed(first: bytes, columns: Mapping[str, str | int] | None = None) -> bool:
    """Whether the first line that is not blank is one of a feed: a header, or an object, that says who and when."""
    if form_of(first) == "csv":
        return header_problem(first, columns) is None
    try:
        row = _json_object(first)
    except ValueError:
        return False
    return {"agent", "time"} <= _Names(columns or {}).ours(tuple(row)).keys()


def blocks_of(stream: BufferedIOBase) -> Iterator[Lines]:
    """Lines of a stream with their numbers, as many together as are there, without waiting for more.

    Of a line longer than ``LONGEST_LINE`` that much and a byte comes, so that ``read`` refuses it.
    """
    first, rest = 1, b""
    while data := _read(stream):
        *lines, rest = (rest + data).split(b"\n")
        rest = rest[: LONGEST_LINE + 1]
        if lines:
            yield [(n, line[: LONGEST_LINE + 1]) for n, line in enumerate(lines, first)]
            first += len(lines)
    if rest:
        yield [(first, rest)]


def _read(stream: BufferedIOBase) -> bytes:
    try:
        return stream.read1(BLOCK)
    except (OSError, ValueError) as error:
        raise ReadError(f"standard input cannot be read: {getattr(error, 'strerror', None) or error}") from None


# Lines to fields


def _json_object(text: bytes) -> dict[str, Any]:
    try:
        row = json.loads(text)
    except (ValueError, RecursionError):
        found = shown(text[:LONGEST_NAME].decode("utf-8", "replace").strip())
        raise ValueError(f"line: not JSON: {found}") from None
    if not isinstance(row, dict):
        raise ValueError("line: not a JSON object")
    return row


def _layout(header: bytes) -> tuple[str, list[str]]:
    """Delimiter and names of the columns."""
    text = header.decode("utf-8", "replace").strip("\r\n").replace("\r", " ")
    delimiter = max(",;\t|", key=text.count)
    return delimiter, [name.strip() for name in next(csv.reader([text], delimiter=delimiter))]


class _CsvFields:
    """The fields of a line of CSV, under our names; those left blank are not there."""

    def __init__(self, header: bytes, columns: Mapping[str, str | int]) -> None:
        self.delimiter, names = _layout(header)
        self.width = len(names)
        at = {name: k for k, name in enumerate(names)}
        ours = _Names(columns)
        found = ours.ours(tuple(at))
        self.places = [(name, at[their]) for name, their in found.items() if their in at]
        self.moment = [at[part.strip()] for part in found["time"].split("+")] if ours.is_joined(found, at) else []
        self.second = ours.may_be_second(found)

    def __call__(self, line: bytes) -> dict[str, Any]:
        text = line.decode("utf-8", "replace").strip("\r\n").replace("\r", " ")
        if '"' in text:
            try:
                cells = next(csv.reader([text], delimiter=self.delimiter, strict=True))
            except csv.Error:
                raise ValueError("line: a quotation mark is out of place") from None
        else:
            cells = text.split(self.delimiter)
        if len(cells) != self.width:
            raise ValueError(f"line: {len(cells)} fields, the header has {self.width}")
        row: dict[str, Any] = {ours: cell for ours, k in self.places if (cell := cells[k].strip())}
        if self.moment:
            row["time"] = Moment(*(cells[k].strip() for k in self.moment))
        if self.second:
            _check_second(row.get("time"))
        return row


class _JsonFields:
    """The fields of a line of JSON, under our names; those left blank or null are not there."""

    def __init__(self, columns: Mapping[str, str | int]) -> None:
        self.names = _Names(columns)

    def __call__(self, line: bytes) -> dict[str, Any]:
        row = _json_object(line)
        theirs = self.names.ours(tuple(row))
        for ours in ("agent", "track", "time"):
            if ours in self.names.columns and ours not in theirs:
                raise ValueError(f"{ours}: no field {self.names.columns[ours]!r} among {some(list(row))}"[:300])
        out = {ours: row[name] for ours, name in theirs.items() if name in row and row[name] not in (None, "")}
        if self.names.is_joined(theirs, row):
            out["time"] = Moment(*(str(row[part.strip()]) for part in theirs["time"].split("+")))
        if self.names.may_be_second(theirs):
            _check_second(out.get("time"))
        return out


class _Names:
    """Fields under our names. The keys of a JSON feed may differ from line to line; few sets of them come."""

    def __init__(self, columns: Mapping[str, str | int]) -> None:
        self.columns = columns
        self._known: dict[tuple[str, ...], dict[str, str]] = {}

    def ours(self, keys: tuple[str, ...]) -> dict[str, str]:
        """Their name of each of our fields that is there."""
        theirs = self._known.get(keys)
        if theirs is None:
            plain = {name.strip().lower(): name for name in keys}
            theirs = {ours: name for ours, name in recognised(keys).items() if ours in FIELDS}
            theirs |= {ours: plain[ours] for ours in MORE_FIELDS if ours in plain}
            theirs |= {ours: str(name) for ours, name in self.columns.items() if _there(name, keys)}
            absent = {ours for ours, name in self.columns.items() if not _there(name, keys)}
            absent |= {"track"} if "agent" in absent else set()  # nothing else stands for what the caller names
            theirs = {ours: name for ours, name in theirs.items() if ours not in absent}
            if len(self._known) < 1000:
                self._known[keys] = theirs
        return theirs

    @staticmethod
    def is_joined(theirs: Mapping[str, str], keys: Iterable[str]) -> bool:
        """Whether the time is two fields, a date and a time of day."""
        return "time" in theirs and theirs["time"] not in keys

    def may_be_second(self, theirs: Mapping[str, str]) -> bool:
        """Whether the time is the field ``timestamp`` of AIS, and nobody said so."""
        ais = plain(theirs.get("time", "")) == "timestamp" and plain(theirs.get("agent", "")) == "mmsi"
        return ais and "time" not in self.columns


def _check_second(value: Any) -> None:
    """Refuse the second of a minute."""
    if value is not None and 0 <= number(value) <= 63:
        raise ValueError(f"time: {shown(value)} is the second of a minute, as in AIS; see --columns time=...")


# Fields to an observation


def _observation(line: int, row: Mapping[str, Any], time_format: str | None, stated: frozenset[str]) -> Observation:
    agent = row.get("agent", row.get("track"))
    if "agent" not in row and "track" not in stated and number(agent) % 1 > 0:
        raise ValueError(f"agent: missing (track {shown(agent)} is a course, and no name)")
    if agent is None or isinstance(agent, (bool, dict, list)):
        raise ValueError("agent: missing")
    name = str(agent)
    if len(name) > LONGEST_NAME:
        raise ValueError(f"agent: longer than {LONGEST_NAME} characters")
    if not name.isascii() and any("\ud800" <= c <= "\udfff" for c in name):  # JSON can write half a character
        raise ValueError(f"agent: {shown(agent)} is not text")
    if "time" not in row:
        raise ValueError("time: missing")
    time = _time(row["time"], time_format)
    if not math.isfinite(time):
        wanted = "neither ISO 8601 nor a number of seconds" if time_format is None else f"not like {time_format}"
        if time_format is None and of_day(str(row["time"])) >= 0:
            wanted = "a time of day; --columns time=DATE+TIME joins it with the field of its date"
        raise ValueError(f"time: {shown(row['time'])} is {wanted}")
    if not within(time):
        hint = " (is it in seconds? see --time-format)" if time_format is None else ""
        raise ValueError(f"time: {shown(row['time'])} lies outside the years 1 to 9999{hint}")
    fix, note = _fix(row), None
    try:
        class_ = _class(row["class"]) if "class" in row else None
    except ValueError:
        if fix is None or "class" in stated or not isinstance(row["class"], str):
            raise
        class_, note = None, f"class such as {shown(row['class'])} beside a fix is no report of a class and not used"
    level, confidence = _number(row, "level"), _number(row, "confidence")
    if level is not None and level < 0:
        raise ValueError(f"level: must not be below 0, got {level:g}")
    if confidence is not None and not 0 < confidence <= 1:
        raise ValueError(f"confidence: must be above 0 and at most 1, got {confidence:g}")
    stamp = row["time"] if isinstance(row["time"], (int, float)) else escaped(str(row["time"]))
    sure = CONFIDENCE if confidence is None else confidence
    return Observation(line, escaped(identity(name)), time, stamp, fix, class_, level, sure, note)


def _time(value: Any, time_format: str | None) -> float:
    if time_format is not None:
        return formatted(str(value), time_format)
    return value.seconds if isinstance(value, Moment) else parse(value)


def _fix(row: Mapping[str, Any]) -> Fix | None:
    sd = _number(row, "sd")
    geodetic = "lon" in row or "lat" in row
    given = {name: _number(row, name) for name in (("lon", "lat") if geodetic else ("x", "y", "z"))}
    position = [value for value in given.values() if value is not None]
    if not position:
        return None
    if missing := [name for name in list(given)[: 2 if geodetic else len(position)] if given[name] is None]:
        raise ValueError(f"{missing[0]}: missing")
    try:
        return Fix(lon=position[0], lat=position[1], sd=sd) if geodetic else Fix(position, sd=sd)
    except ValueError as error:  # "Fix lon must be ..."
        field, _, why = str(error).removeprefix("Fix ").partition(" ")
        raise ValueError(f"{field}: {why}") from None


def _number(row: Mapping[str, Any], name: str) -> float | None:
    if name not in row:
        return None
    value = degrees(row[name], name) if name in ("lon", "lat") and isinstance(row[name], str) else number(row[name])
    if not abs(value) < LARGEST:  # NaN too
        raise ValueError(f"{name}: {shown(row[name])} is {'out of range' if _large(row[name]) else 'not a number'}")
    return value


def _large(value: Any) -> bool:
    try:
        return abs(float(value)) >= LARGEST
    except OverflowError:  # a whole number of more than 308 digits
        return True
    except (TypeError, ValueError):
        return False


def _class(value: Any) -> int | str:
    if isinstance(value, str) and value.startswith("track:"):
        if len(value) > LONGEST_NAME:
            raise ValueError(f"class: longer than {LONGEST_NAME} characters")
        return value
    try:
        if isinstance(value, bool) or int(value) != float(value):
            raise ValueError
        return int(value)
    except (ValueError, TypeError, OverflowError):
        raise ValueError(f"class: {shown(value)} is neither the number of a class nor track:NAME") from None
