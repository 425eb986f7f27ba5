"""The one place where records are checked, grouped by agent and sorted into ``Tracks``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.base.units import FARTHEST
from wakefold.io import times
from wakefold.io.records import Latest, Rows, Static, as_text, last_rows
from wakefold.io.report import ReadError, Report, Tally
from wakefold.io.rules import Mask, grouping, jumps, project, repeated, sort_times, starts, taken
from wakefold.tracks.tracks import Tracks

MAX_GEODETIC_SPEED = 60.0
"""Metres per second (117 knots): faster than any ship, slower than most wrong positions imply."""
LATE = (
    "{n} times lie beyond the year 2100: if they are not in seconds, say so by time_format (--time-format), such as ms"
)


class Collector:
    """Takes batches of ``Rows``, applies the rules of docs/reading.md, and makes ``Tracks`` of what is left.

    Batches are kept as they come, one list of arrays per field; they become whole arrays one field after the other,
    so that at most one field is in memory twice.
    """

    def __init__(self) -> None:
        self.tally = Tally()
        self._codes: dict[str, int] = {}
        self._seen: dict[Any, int] = {}  # values of agents as they stand in files, whose names are known
        self._trajectories: dict[str, int] = {}
        self._plane: str | None = None
        self._geodetic = False
        self._dim = 0
        self._file_starts: list[int] = []
        self._kept = 0
        self._chunks: dict[str, list[NDArray[Any]]] = {}
        self._attributes: dict[str, Latest] = {}

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
            lon, lat = rows.position
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
            count = self._trajectories[agent] = self._trajectories.get(agent, 0) + 1
            name = agent if count == 1 else f"{agent}#{count}"
            while name in self._codes:
                name += "+"
            return np.full(n, self._codes.setdefault(name, len(self._codes)), dtype=np.int32)
        encoded = agent.dictionary_encode()
        values = encoded.dictionary.to_pylist()
        try:
            codes = [self._seen[value] for value in values]
        except KeyError:
            codes = [self._code(value) for value in values]
        table = np.array([*codes, -1], dtype=np.int32)
        return table[encoded.indices.fill_null(len(values)).to_numpy(zero_copy_only=False)]

    def _code(self, value: Any) -> int:
        """Number of an agent given by its value in a file."""
        if value not in self._seen:
            name = identity(value)
            self._seen[value] = self._codes.setdefault(name, len(self._codes)) if name else -1
        return self._seen[value]

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
        codes = self._take("code")
        order = grouping(codes)
        codes = codes[order]
        time = taken(self._take("time"), order)
        untimed = self._number_untimed(codes, time)
        late = sort_times(codes, time, order)
        self.tally.note("{n} rows followed a later one of the same agent and were sorted", late)
        rows = _Sorted(order, codes, time, [taken(self._take(f"position {i}"), order) for i in range(self._dim)])

        duplicate, elsewhere = repeated(rows.codes, rows.time, rows.position)
        self._reject("duplicate", duplicate, rows)
        self._reject("same time", elsewhere, rows)
        rows.keep(~(duplicate | elsewhere))
        if max_speed == "auto":
            max_speed = MAX_GEODETIC_SPEED if self._geodetic and not untimed else None
        if max_speed is not None:
            jump = jumps(rows.codes, rows.time, rows.position, self._geodetic, max_speed)
            self._reject("jump", jump, rows)
            rows.keep(~jump)

        columns = {
            name[7:]: taken(self._take(name), rows.order) for name in sorted(self._chunks) if name[:7] == "column "
        }
        offsets = np.append(np.flatnonzero(starts(rows.codes)), len(rows.codes))
        agents = rows.codes[offsets[:-1]]
        ids = np.array(list(self._codes), dtype=np.str_)[agents]
        attributes = {name: latest.of(agents) for name, latest in self._attributes.items()}
        attributes.setdefault("agent", ids)
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
            self.tally.note("no times: {n} points taken 1 s apart", int(untimed.sum()))
        return bool(untimed.any())

    def _reject(self, reason: str, bad: Mask, rows: _Sorted) -> None:
        """Count rows rejected after sorting. The first ones of the file are shown by their values."""
        which = np.flatnonzero(bad)
        which = which[np.argsort(rows.order[which])]
        names = list(self._codes)
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


def identity(value: Any) -> str:
    """Name of an agent; whole numbers that were made floats on their way (``367000140.0``) without the fraction."""
    text = as_text(value)
    return str(int(float(text))) if re.fullmatch(r"\d{1,15}\.\d*(e\+?\d\d?)?", text) and float(text) % 1 == 0 else text


def _clock(time: float) -> str:
    """ISO 8601 where the time can be a date of ours, else seconds."""
    if 1e8 < time < 4e9:
        return datetime.fromtimestamp(time, UTC).isoformat().replace("+00:00", "Z")
    return f"{time:.10g} s"
