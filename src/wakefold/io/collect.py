"""The one place where records are checked, grouped by agent and sorted into ``Tracks``."""

# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.base.units import FARTHEST
from wakefold.base.wording import counted, escaped
from wakefold.io import times
from wakefold.io.records import PAIRED, Latest, Rows, Static, as_text, identity, is_text, last_rows, rounded
from wakefold.io.report import ReadError, Report, Tally, some
from wakefold.io.rules import Mask, bodies, far_apart, grouping, project, repeated, sort_times, starts, taken
from wakefold.tracks.projection import dated
from wakefold.tracks.tracks import Tracks

AIS_NO_LONGITUDE = 181.0
LONGEST_NAME = 200
MANY = 1000  # names
MAX_GEODETIC_SPEED = 60.0
"""Metres per second (117 knots): faster than any ship, slower than most wrong positions imply."""
LATE = (
    "{n} times lie beyond the year 2100: if they are not in seconds, say so by time_format (--time-format), such as ms"
)
FAST = (
    "more than a tenth of the rows are jumps at {limit} m/s; if such speeds are real, say so by max_speed (--max-speed)"
)
TWO = "the rows are kept apart, with #2 and so on behind the name"
SINGLE = "every row has an agent of its own"
SAY = "such as days of a spreadsheet, say so by time_format (--time-format days)"
DEGREES = (
    "x and y may be longitude and latitude, as all lie within 180 and 90 and the times are dates: if so, "
    "columns lon=...,lat=... (--columns)"
)
EARLY = 1e8
"""Seconds: times before 1973 are no dates of tracks."""


class Collector:
    """Takes batches of ``Rows``, applies the rules of docs/reading.md, and makes ``Tracks`` of what is left.

    Batches are kept as they come, one list of arrays per field; they become whole arrays one field after the other,
    so that at most one field is in memory twice.
    """

    def __init__(self) -> None:
        self.tally = Tally()
        self._codes: dict[str, int] = {}
        self._names: list[str] = []  # by code, at the end
        self._pairs = False  # whether there are names of an agent and a track
        self._seen: dict[Any, int] = {}  # values of agents as they stand in files, whose names are known
        self._spelled: dict[str, str] = {}  # whole numbers without leading zeros, as they were first written
        self._trajectories: dict[str, int] = {}
        self._plane: str | None = None
        self._geodetic = False
        self._dim = 0
        self._file_starts: list[int] = []
        self._kept = 0
        self._chunks: dict[str, list[NDArray[Any]]] = {}
        self._attributes: dict[str, Latest] = {}

    @property
    def agents(self) -> int:
        """How many have come."""
        return len(self._codes)

    def open(self, name: str) -> None:
        """A new file begins."""
        self.tally.files.append(name)
        self._file_starts.append(self._kept)

    def add(self, rows: Rows) -> None:
        """Check a batch and keep what is usable: rows with an agent, a time and a position."""
        n = len(rows.lines)
        self.tally.rows += n
        self._same_plane(rows)
        codes = self._encode(rows.agent, n)
        good = self._refuse("no agent", codes >= 0, np.ones(n, dtype=bool), rows)
        if rows.time is None:
            time = np.full(n, np.nan)
        else:
            time = rows.time
            good = self._refuse("no time", times.within(time), good, rows)
            self.tally.note(LATE, int((time > times.YEAR_2100).sum()))
        if rows.geodetic:
            lon, lat = rows.position = self._turned(rows)
            here = (np.abs(lon) <= 180) & (np.abs(lat) <= 90)  # NaN is not
        else:
            here = np.logical_and.reduce([np.abs(p) <= FARTHEST for p in rows.position])  # NaN is not
        good = self._refuse("no position", here, good, rows)

        self._describe(codes, good, rows.attributes)
        fields: dict[str, NDArray[Any]] = {"code": codes, "time": time, "line": rows.lines.astype(np.uint32)}
        fields |= {f"position {i}": p for i, p in enumerate(rows.position)}
        fields |= {f"column {name}": values for name, values in rows.columns.items()}
        if not good.all():
            fields = {name: values[good] for name, values in fields.items()}
        kept = int(good.sum())
        for name in self._chunks.keys() | fields.keys():  # a column may be in some of the files only
            if name not in self._chunks:
                self._chunks[name] = [np.full(self._kept, np.nan, dtype=fields[name].dtype)] if self._kept else []
            chunks = self._chunks[name]
            chunks.append(fields[name] if name in fields else np.full(kept, np.nan, dtype=chunks[0].dtype))
        self._kept += kept

    def _turned(self, rows: Rows) -> tuple[Floats, Floats]:
        """Longitude and latitude; longitudes that run on past 180 degrees, or from 0 to 360, turned into -180..180.

        181 means "not available" in AIS: it is no longitude.
        """
        lon, lat = rows.position
        if not rows.whole_turn:
            return lon, lat
        size = np.abs(lon)
        over = (size > 180) & (size <= 360) & (lon != AIS_NO_LONGITUDE)  # NaN is not
        if over.any():
            self.tally.note("{n} longitudes beyond 180 degrees were taken as those a turn away", int(over.sum()))
            lon = np.where(over, lon - np.copysign(360.0, lon), lon)
        return lon, lat

    def describe(self, static: Static) -> None:
        """Take up attributes that come without positions."""
        codes = self._encode(static.agent, len(static.agent))
        self._describe(codes, codes >= 0, static.attributes)

    def _describe(self, codes: NDArray[np.int32], good: Mask, attributes: Mapping[str, Any]) -> None:
        last = last_rows(codes, good)
        for name, values in attributes.items():
            self._attributes.setdefault(name, Latest()).add(codes, values, good, last)

    def _same_plane(self, rows: Rows) -> None:
        plane = "longitude and latitude" if rows.geodetic else f"{len(rows.position)} plane coordinates"
        if self._plane not in (None, plane):
            raise ReadError(f"{self.tally.files[-1]}: has {plane}, what was read before has {self._plane}")
        self._plane, self._geodetic, self._dim = plane, rows.geodetic, len(rows.position)

    def _refuse(self, reason: str, ok: Mask, good: Mask, rows: Rows) -> Mask:
        """``good`` less the rows that are not ``ok``, which are counted under ``reason``."""
        if ok.all():
            return good
        bad = np.flatnonzero(good & ~ok)
        self.tally.reject(reason, len(bad), rows.named(bad))
        return good & ok

    def _encode(self, agent: str | pa.Array, n: int) -> NDArray[np.int32]:
        """``(n,)`` the number of each row's agent, in order of appearance; -1 without one."""
        if isinstance(agent, str):  # a track of its own: told apart from others of that name
            agent = escaped(agent)
            count = self._trajectories[agent] = self._trajectories.get(agent, 0) + 1
            name = agent if count == 1 else f"{agent}#{count}"
            while name in self._codes:
                name += "+"
            return np.full(n, self._codes.setdefault(name, len(self._codes)), dtype=np.int32)
        encoded = agent.dictionary_encode()
        codes = self._codes_of_numbers(encoded.dictionary)
        if codes is None:
            values = encoded.dictionary.to_pylist()
            try:
                codes = [self._seen[value] for value in values]
            except KeyError:
                codes = [self._code(value) for value in values]
        table = np.append(np.array(codes, dtype=np.int32), np.int32(-1))
        return table[encoded.indices.fill_null(len(codes)).to_numpy(zero_copy_only=False)]

    def _codes_of_numbers(self, values: pa.Array) -> NDArray[np.int64] | None:
        """The codes of many texts at once that are whole numbers without zeros in front; None if they are not."""
        if len(values) < MANY or self._spelled or not is_text(values):
            return None
        if not pc.all(pc.match_substring_regex(values, rf"^(0|[1-9][0-9]{{0,{LONGEST_NAME - 1}}})$")).as_py():
            return None
        names = values.cast(pa.string()).to_numpy(zero_copy_only=False).tolist()
        first = len(self._codes)
        codes = np.fromiter(map(self._codes.setdefault, names, range(first, first + len(names))), np.int64, len(names))
        new = codes >= first
        if not new.all():  # without gaps
            codes[new] = range(first, len(self._codes))
            self._codes.update((names[i], int(codes[i])) for i in np.flatnonzero(new).tolist())
        return codes

    def _code(self, value: Any) -> int:
        """Number of an agent given by its value; whole numbers are the same agent however they are written."""
        code = self._seen.get(value)
        if code is None:
            name = as_text(value)
            if PAIRED in name:
                agent, _, track = map(identity, name.rpartition(PAIRED))
                self._pairs = True
                name = f"{agent}{PAIRED}{track}" if track and max(len(agent), len(track)) <= LONGEST_NAME else ""
            elif name.isdecimal():
                name = self._as_first_written(name)
            elif name:
                if rounded(name):
                    self.tally.note("{n} agents are written with an exponent that may hide digits, such as 2.19E+08")
                name = identity(name)
                name = self._as_first_written(name) if name.isdecimal() else name
            if len(name) > LONGEST_NAME and PAIRED not in name:
                self.tally.note(f"{{n}} agents have names of over {LONGEST_NAME} characters: no agent")
                name = ""
            code = self._seen[value] = self._codes.setdefault(name, len(self._codes)) if name else -1
        return code

    def _as_first_written(self, number: str) -> str:
        """The first spelling of a whole number, which may have had zeros in front."""
        bare = number.lstrip("0") or "0"
        first = self._spelled.get(bare) or (bare if bare in self._codes else number)
        if first != number:
            self.tally.note(f"{{n}} agents are written in two ways, such as {first} and {number}")
        elif number != bare:
            self._spelled[bare] = number
        return first

    def _named(self) -> list[str]:
        """Names by code: of an agent's track that of the track, after that of the agent if others have it too."""
        names = list(self._codes)
        if not self._pairs:
            return names
        count = Counter(name.rpartition(PAIRED)[2] for name in names)
        used: dict[str, None] = {}
        for name in names:
            agent, _, track = name.rpartition(PAIRED)
            name = track if count[track] == 1 or not agent else f"{agent}/{track}"
            while name in used:
                name += "+"
            used[name] = None
        return list(used)

    def finish(self, format: str, max_speed: float | Literal["auto"] | None = "auto") -> tuple[Tracks, Report]:
        """Group by agent, sort by time, drop what contradicts itself, project.

        Args:
            format: name for the report.
            max_speed: metres (or plane units) per second, see ``rules.jumps``. "auto": 60 for geodetic data with times,
                none for planar data, whose unit may not be the metre.

        Raises:
            ReadError: not one row was good.
        """
        if not self._kept:
            raise self.tally.refusal(format)
        self._names = self._named()
        codes = self._take("code")
        order = grouping(codes)
        codes = codes[order]
        time = taken(self._take("time"), order)
        untimed = self._number_untimed(codes, time)
        late = sort_times(codes, time, order)
        self.tally.note("{n} rows followed a later one of the same agent and were sorted", late)
        rows = _Sorted(order, codes, time, [taken(self._take(f"position {i}"), order) for i in range(self._dim)])

        duplicate, elsewhere = repeated(rows.codes, rows.time, rows.position)
        if max_speed == "auto":
            max_speed = MAX_GEODETIC_SPEED if self._geodetic and not untimed else None
        if self._geodetic and max_speed is not None and elsewhere.any():
            elsewhere &= ~far_apart(duplicate | elsewhere, rows.position)
        self._reject("duplicate", duplicate, rows)
        self._reject("same time", elsewhere, rows)
        rows.keep(~(duplicate | elsewhere))
        parents = self._apart(rows, max_speed) if max_speed is not None else {}

        columns = {
            name[7:]: taken(self._take(name), rows.order) for name in sorted(self._chunks) if name[:7] == "column "
        }
        offsets = np.append(np.flatnonzero(starts(rows.codes)), len(rows.codes))
        agents = rows.codes[offsets[:-1]]
        ids = np.array(self._names, dtype=np.str_)[agents]
        owners = agents
        if parents:
            owners = np.array([parents.get(code, code) for code in agents.tolist()], dtype=agents.dtype)
        attributes = {name: latest.of(owners) for name, latest in self._attributes.items()}
        attributes.setdefault("agent", ids)
        self._look(rows, len(agents), untimed)
        if self._geodetic:
            points, projection = project(*rows.position)
        else:
            points, projection = np.stack(rows.position, axis=1), None
        tracks = Tracks(points, rows.time, offsets, ids, projection, attributes, columns)
        return tracks, self.tally.report(format, len(points))

    def _take(self, name: str) -> NDArray[Any]:
        whole = np.concatenate(self._chunks[name])
        self._chunks[name].clear()
        return whole

    def _number_untimed(self, codes: NDArray[np.int32], time: Floats) -> bool:
        """Take the rows of files without times one second apart, from 0 for each agent; whether there are any."""
        untimed = np.isnan(time)
        if untimed.any():
            begin = np.flatnonzero(starts(codes))
            index = np.arange(len(time)) - np.repeat(begin, np.diff(np.append(begin, len(time))))
            time[untimed] = index[untimed]
            self.tally.untimed = int(untimed.sum())
            self.tally.note("no times: {n} points taken 1 s apart", self.tally.untimed)
        return bool(untimed.any())

    def _apart(self, rows: _Sorted, max_speed: float) -> dict[int, int]:
        """Drop jumps, and give other bodies under the name of an agent names of their own: codes of whose they were."""
        body = bodies(rows.codes, rows.time, rows.position, self._geodetic, max_speed)
        jump = body < 0
        self._reject("jump", jump, rows)
        if 10 * jump.sum() > len(jump):
            self.tally.note(FAST.format(limit=f"{max_speed:g}"))
        more = np.flatnonzero(body > 0)
        parents: dict[int, int] = {}
        if len(more):
            names, used = self._names, set(self._names)
            pairs, which = np.unique(np.stack([rows.codes[more], body[more]]), axis=1, return_inverse=True)
            new = []
            for code, number in pairs.T.tolist():
                name = f"{names[code]}#{number + 1}"
                while name in used:
                    name += "+"
                used.add(name)
                new.append(len(names))
                names.append(name)
                parents[new[-1]] = code
            count = counted(len(set(parents.values())), "agent")
            verb = "is" if count.startswith("1 ") else "are"
            self.tally.decided([f"{count} {verb} in two places at once, such as {names[int(pairs[0, 0])]}: {TWO}"])
            rows.codes = rows.codes.copy()
            rows.codes[more] = np.array(new, dtype=np.int32)[which.reshape(-1)]
        rows.keep(~jump)
        if len(more):
            rows.sort(grouping(rows.codes))
        return parents

    def _look(self, rows: _Sorted, tracks: int, untimed: bool) -> None:
        """Notes on what the whole looks like: that positions or times may be other than they seem."""
        latest = float(np.abs(rows.time).max())
        if tracks == len(rows.time) > 2:
            others = f": another column may name them, of {some(list(self.tally.others))} (--columns agent=...)"
            self.tally.decided([SINGLE + (others if self.tally.others else "")])
        if self._geodetic and not untimed and latest < EARLY:
            self.tally.note(f"times reach {latest:.6g} s, which is no date: if they are no seconds, {SAY}")
        degrees = self._dim == 2 and not self._geodetic
        degrees = degrees and bool((np.abs(rows.position[0]) <= 180).all() and (np.abs(rows.position[1]) <= 90).all())
        if degrees and dated(None, float(rows.time.min())):
            self.tally.note(DEGREES)

    def _reject(self, reason: str, bad: Mask, rows: _Sorted) -> None:
        """Count rows rejected after sorting. The first ones of the file are shown by their values."""
        which = np.flatnonzero(bad)
        which = which[np.argsort(rows.order[which])]
        names = self._names
        for row in which[: self.tally.wants(reason)]:
            where = ", ".join(f"{p[row]:.10g}" for p in rows.position)
            file, line = self._origin(int(rows.order[row]))
            text = f"{names[rows.codes[row]]} at {_clock(float(rows.time[row]))}: {where}"
            self.tally.reject(reason, 1, [(line, text)], file)
            which = which[1:]
        self.tally.reject(reason, len(which), [])

    def _origin(self, row: int) -> tuple[str, int]:
        """File and line of a row given by its place in the order of reading."""
        ends = np.cumsum([len(chunk) for chunk in self._chunks["line"]])
        chunk = int(np.searchsorted(ends, row, side="right"))
        line = self._chunks["line"][chunk][row - int(ends[chunk])]  # counted from the chunk's end
        file = int(np.searchsorted(self._file_starts, row, side="right")) - 1
        return self.tally.files[file], int(line)


class _Sorted:
    """Rows sorted by agent and time: ``order`` is their place in the order of reading."""

    def __init__(
        self, order: NDArray[np.integer], codes: NDArray[np.int32], time: Floats, position: list[Floats]
    ) -> None:
        self.order, self.codes, self.time, self.position = order, codes, time, position

    def keep(self, mask: Mask) -> None:
        if not mask.all():
            self.order, self.codes, self.time = self.order[mask], self.codes[mask], self.time[mask]
            self.position = [p[mask] for p in self.position]

    def sort(self, order: NDArray[np.integer]) -> None:
        self.order, self.codes, self.time = self.order[order], self.codes[order], self.time[order]
        self.position = [p[order] for p in self.position]


def _clock(time: float) -> str:
    """ISO 8601 where the time can be a date of ours, else seconds."""
    if 1e8 < time < 4e9:
        return datetime.fromtimestamp(time, UTC).isoformat().replace("+00:00", "Z")
    return f"{time:.10g} s"
