"""Which column is what: by its name, by what the caller says, and by what stands in it. Every command asks here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from wakefold.base.wording import near_miss
from wakefold.io import clock, times
from wakefold.io.clock import Clock, Sample
from wakefold.io.records import plain
from wakefold.io.report import ReadError, listed, some

OBVIOUS: dict[str, tuple[str, ...]] = {
    "track": ("track", "trackid", "trajectoryid", "trajid"),
    "agent": (
        "agent", "agentid", "mmsi", "pedid", "pedestrianid", "vesselid", "shipid", "userid", "personid", "deviceid",
        "vehicleid", "taxiid", "animalid", "playerid", "uid", "driverid", "busid", "individuallocalidentifier",
        "icao24", "imei", "user", "person", "objectid", "id",
    ),
    "time": clock.NAMES,
    "lon": ("lon", "longitude", "lng", "long", "locationlong"),
    "lat": ("lat", "latitude", "locationlat"),
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
}  # fmt: skip
"""What a column is, by its name as ``delimited.plain`` makes it; the first name that is there counts. ``id`` comes last
of its kind: beside a name of a person or a ship it numbers the rows."""
MOTION = ("sog", "cog", "heading")
POSITION = ("lon", "lat", "x", "y", "z")
FLOATS = (*POSITION, *MOTION, "length", "width")
GEOMETRIES = ("wkt", "geom", "geometry", "thegeom", "wkbgeometry", "shape", "point", "location", "geog")
"""Names of columns that may hold points as text, WKT or the hexadecimal WKB of databases."""

Columns = Mapping[str, str | int]


@dataclass(frozen=True)
class Assigned:
    """Where our columns are among those of a table.

    Attributes:
        places: by our names, without the time.
        time: the column or columns of the time; None if there are no times.
        notes: what was decided by the values.
        others: names of columns that nothing was taken from.
    """

    places: dict[str, int]
    time: Clock | None
    notes: tuple[str, ...]
    others: tuple[str, ...]


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
    where = {"lon", "lat"} <= there or {"x", "y"} <= there or any(plain(name) in GEOMETRIES for name in names)
    return bool({"track", "agent"} & there) and where


def assigned(
    source: str,
    names: Sequence[str],
    sample: Sample,
    columns: Columns | None,
    time_format: str | None,
    geometry: bool = False,
) -> Assigned:
    """What the columns of a table are: as the caller says, and for the rest by name and by a sample of the values.

    Args:
        source: for messages.
        sample: texts of some first rows, by column.
        geometry: there is a geometry column, so that no other position is needed.

    Raises:
        ReadError: a column that is not there; no agent or no position; a time that cannot be one.
    """
    given = dict(columns or {})
    found: dict[str, str | int] = dict(recognised(names))
    notes: list[str] = []
    found.pop("time", None)
    for alternatives in (("track", "agent"), POSITION):
        if any(name in given for name in alternatives):
            found = {name: where for name, where in found.items() if name not in alternatives}
    if "track" in found and "track" not in given and is_course(*_beside(names, sample, found)):
        course = found.pop("track")
        found.setdefault("cog", course)
        notes.append(f"{course} holds courses, not names: tracks are not told apart by it")
    stated = given.pop("time", None)
    found |= given
    if {"lon", "lat"} <= found.keys():
        found = {name: where for name, where in found.items() if name not in ("x", "y", "z")}
    places = {ours: place(source, names, ours, where) for ours, where in found.items()}
    missing = []
    if not {"track", "agent"} & places.keys():
        missing.append("agent")
    if not geometry and not ({"lon", "lat"} <= places.keys() or {"x", "y"} <= places.keys()):
        missing.append("lon and lat (or x and y)")
    if missing:
        raise ReadError(
            f"{source}: which column is {listed(missing)}? There are {some(names)}; give columns={{...}} (--columns)"
        )
    geodetic = geometry or "lon" in places
    who = places.get("agent", places.get("track"))
    if stated is None:
        time, more = clock.chosen(source, names, sample, who, set(places.values()), time_format, geodetic)
    else:
        time, more = _stated(source, names, sample, stated, time_format)
    notes += more
    used = {*places.values(), *(time.columns if time else ())}
    others = tuple(name for i, name in enumerate(names) if i not in used)
    return Assigned(places, time, tuple(notes), others)


def place(source: str, names: Sequence[str], ours: str, where: str | int) -> int:
    """Where a column that the caller names is.

    Raises:
        ReadError: nowhere.
    """
    if isinstance(where, str) and where in names:
        return list(names).index(where)
    if isinstance(where, int) and 0 <= where < len(names):
        return where
    hint = near_miss(where, names[:1000]) if isinstance(where, str) else ""
    raise ReadError(f"{source}: no column {where!r} (for {ours}); there are {some(names)}{hint}")


def _stated(
    source: str, names: Sequence[str], sample: Sample, stated: str | int, form: str | None
) -> tuple[Clock, list[str]]:
    """The time as the caller names it: a column, or a date and a time of day as ``Date+Time``."""
    if isinstance(stated, str) and stated not in names and "+" in stated:
        day, _, of_day = stated.partition("+")
        pair = place(source, names, "time", day.strip()), place(source, names, "time", of_day.strip())
        return clock.joined(source, pair, sample, form), []
    return clock.stated(source, names, sample, place(source, names, "time", stated), form)


def _beside(
    names: Sequence[str], sample: Sample, found: Mapping[str, str | int]
) -> tuple[Sequence[str], Sequence[str]]:
    """The values of the columns recognised as track and as agent; all of one agent without such a column."""
    tracks = sample[list(names).index(str(found["track"]))]
    if "agent" not in found or found["agent"] not in names:
        return tracks, [""] * len(tracks)
    return tracks, sample[list(names).index(str(found["agent"]))]


def is_course(values: Sequence[str], agents: Sequence[str]) -> bool:
    """Whether values of a column named track are courses over ground: numbers of degrees, some of them with a
    fraction, or such that most change from row to row of an agent and some come back, which numbers of tracks do not.
    """
    known = [(agent, times.number(value)) for value, agent in zip(values, agents, strict=True) if value.strip()]
    if not known or not all(-180 <= number <= 360 for _, number in known):
        return False
    if any(number % 1 for _, number in known):
        return True
    last: dict[str, float] = {}
    seen: set[tuple[str, float]] = set()
    pairs = changes = returns = 0
    for agent, number in known:
        pairs += agent in last
        if agent in last and last[agent] != number:
            changes += 1
            returns += (agent, number) in seen
        last[agent] = number
        seen.add((agent, number))
    return returns > 0 and 2 * changes > pairs
