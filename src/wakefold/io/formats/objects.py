"""Objects with keys and values, as JSON lines and the properties of points are: a table whose columns are the keys."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from wakefold.base.types import Floats
from wakefold.io import coordinates, times
from wakefold.io.columns import FLOATS, Assigned, Columns, assigned
from wakefold.io.formats.tables import rows_of
from wakefold.io.records import SAMPLED, Rows, as_text
from wakefold.io.report import Tally

BATCH = 50_000
WEIGHT = 5
"""What JSON becomes in memory takes some twenty times its text."""
MOST_KEYS = 1000  # that are looked at


class Thing(NamedTuple):
    """An object: the line it stands on, its keys and values, and its place if that is not among them."""

    line: int
    row: dict[str, Any]
    place: tuple[float, float] | None = None
    moment: float = np.nan


class Objects:
    """Makes batches of rows of objects. The first ones decide what the keys are.

    Attributes:
        geometry: places come apart from the keys.
        geodetic: they are longitude and latitude.
    """

    def __init__(
        self, source: str, tally: Tally, columns: Columns | None, time_format: str | None, geometry: bool
    ) -> None:
        self.source, self.tally, self.columns, self.time_format = source, tally, columns, time_format
        self.geometry, self.geodetic = geometry, True
        self._found: Assigned | None = None
        self._names: list[str] = []

    def rows(self, things: Sequence[Thing]) -> Rows:
        """A batch of rows.

        Raises:
            ReadError: the keys do not say who, when and where.
        """
        found = self._assigned(things)

        def column(index: int) -> list[Any]:
            name = self._names[index]
            return [thing.row.get(name) for thing in things]

        floats: dict[str, Floats] = {}
        texts: dict[str, pa.Array] = {}
        for ours, index in found.places.items():
            if ours in ("lon", "lat"):
                floats[ours] = np.array([_degrees(value, ours) for value in column(index)])
            elif ours in FLOATS:
                floats[ours] = np.array([times.number(value) for value in column(index)])
            else:
                texts[ours] = pa.array([name_of(value) for value in column(index)], pa.string())
        if self.geometry:
            for name in ("lon", "lat", "x", "y", "z"):
                floats.pop(name, None)
            x, y = np.array([thing.place or (np.nan, np.nan) for thing in things], dtype=np.float64).T
            floats |= {"lon": x, "lat": y} if self.geodetic else {"x": x, "y": y}
        if found.time is not None:
            floats["time"] = self._times(found, [column(index) for index in found.time.columns])
        elif not all(np.isnan(thing.moment) for thing in things):
            floats["time"] = np.array([thing.moment for thing in things])

        def text(row: int) -> str:
            place = {} if things[row].place is None else {"coordinates": things[row].place}
            return json.dumps(place | things[row].row, default=str, ensure_ascii=False)[:1000]

        return rows_of(floats, texts, np.array([thing.line for thing in things]), text)

    def _assigned(self, things: Sequence[Thing]) -> Assigned:
        if self._found is None:
            first = things[:SAMPLED]
            names: dict[str, None] = {}
            for thing in first:
                names |= dict.fromkeys(list(thing.row)[: MOST_KEYS - len(names)])
            self._names = list(names)
            sample = [[_sampled(thing.row.get(name)) for thing in first] for name in names]
            self._found = assigned(
                self.source, self._names, sample, self.columns, self.time_format, geometry=self.geometry
            )
            self.tally.decided(self._found.notes, self._found.others)
        return self._found

    @staticmethod
    def _times(found: Assigned, columns: list[list[Any]]) -> Floats:
        assert found.time is not None
        if len(columns) == 2:
            days, clocks = (pa.array([as_text(value) for value in column], pa.string()) for column in columns)
            return times.from_days(days, clocks, found.time.form, found.time.hhmm)
        return np.array([moment_of(value, found.time.form) for value in columns[0]])


def moment_of(value: Any, form: str | None) -> float:
    """Seconds of a number or text as JSON has them; NaN of anything else."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        return np.nan
    if form is None:
        return times.parse(value.strip() if isinstance(value, str) else value)
    return times.formatted(as_text(value), form)


def name_of(value: Any) -> str:
    """The text of a value that may name something; empty of what is no text and no number."""
    return "" if value is None or isinstance(value, (bool, dict, list)) else as_text(value)


def _sampled(value: Any) -> str:
    return "" if isinstance(value, (dict, list)) else as_text(value)[:200]


def _degrees(value: Any, axis: str) -> float:
    return coordinates.degrees(value, axis) if isinstance(value, str) else times.number(value)
