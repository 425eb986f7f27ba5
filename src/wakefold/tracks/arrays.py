"""Many timed sequences of positions in one set of flat arrays: what is checked, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.tracks import ragged
from wakefold.tracks.projection import Projection

MOST_AXES = 16  # kernels unroll the loops over coordinates: more take long to compile


def _all_different(ids: NDArray[np.str_]) -> bool:
    """Whether no two texts are equal: hashes, which are quick to sort, tell it but for chance."""
    letters = np.ascontiguousarray(ids).view(np.uint32).reshape(len(ids), -1) if ids.size and ids.itemsize else ids
    hashes = np.zeros(len(ids), dtype=np.uint64)
    for letter in letters.T:
        hashes = (hashes ^ letter) * np.uint64(0x9E3779B97F4A7C15)
        hashes ^= hashes >> np.uint64(32)
    hashes.sort()
    return bool((hashes[1:] != hashes[:-1]).all()) or len(set(ids.tolist())) == len(ids)


@dataclass(frozen=True, eq=False, repr=False)
class TrackArrays:
    """The fields of ``Tracks`` and what follows from them. Nothing here makes new tracks."""

    points: Floats
    times: Floats
    offsets: NDArray[np.int64]
    ids: NDArray[np.str_]
    projection: Projection | None = None
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points, dtype=np.float64)
        if points.ndim != 2 or not 1 <= points.shape[1] <= MOST_AXES:
            raise ValueError(f"points must be (P, d) with d = 1 to {MOST_AXES}, got shape {points.shape}")
        times = np.ascontiguousarray(self.times, dtype=np.float64)
        offsets = np.ascontiguousarray(self.offsets, dtype=np.int64)
        ids = np.asarray(self.ids, dtype=np.str_)
        if times.shape != (len(points),):
            raise ValueError(f"times must be ({len(points)},), got shape {times.shape}")
        if offsets.ndim != 1 or len(offsets) < 1 or offsets[0] != 0 or offsets[-1] != len(points):
            raise ValueError(f"offsets must run from 0 to {len(points)}")
        lengths = np.diff(offsets)
        if len(ids) != len(lengths):
            raise ValueError(f"{len(lengths)} tracks but {len(ids)} ids")
        if not _all_different(ids):
            names, counts = np.unique(ids, return_counts=True)
            raise ValueError(f"track id {str(names[counts > 1][0])!r} is used more than once")
        if (lengths <= 0).any():
            raise ValueError(f"track {str(ids[np.argmax(lengths <= 0)])!r} has no points")
        if not np.isfinite(points).all():
            self._refuse(~np.asarray(np.isfinite(points).all(axis=1)), offsets, ids, "a position that is not finite")
        self._refuse(~np.isfinite(times), offsets, ids, "a time that is not finite")
        backwards = np.zeros(len(times), dtype=bool)
        backwards[1:] = np.diff(times) <= 0
        backwards[offsets[:-1][lengths > 0]] = False
        self._refuse(backwards, offsets, ids, "a time that does not follow the one before")
        for kind, table, rows in (("attribute", self.attributes, len(ids)), ("column", self.columns, len(points))):
            for name, values in table.items():
                if np.shape(values) != (rows,):
                    raise ValueError(f"{kind} {name!r} must be ({rows},), got shape {np.shape(values)}")
        put = object.__setattr__
        for name, array in (("points", points), ("times", times), ("offsets", offsets), ("ids", ids)):
            view = array.view()
            view.flags.writeable = False
            put(self, name, view)
        put(self, "attributes", _frozen(self.attributes))
        put(self, "columns", _frozen(self.columns))

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and copy, which know no read-only tables."""
        tables = dict(self.attributes), dict(self.columns)
        return type(self), (self.points, self.times, self.offsets, self.ids, self.projection, *tables, self.notes)

    @staticmethod
    def _refuse(bad: NDArray[np.bool_], offsets: NDArray[np.int64], ids: NDArray[np.str_], what: str) -> None:
        if bad.any():
            row = int(np.argmax(bad))
            track = int(np.searchsorted(offsets, row, side="right")) - 1
            raise ValueError(f"track {str(ids[track])!r} has {what} (point {row - offsets[track]})")

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.points.shape[1]

    @property
    def lengths(self) -> NDArray[np.int64]:
        """``(M,)`` number of points of each track."""
        return np.diff(self.offsets)

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the bounding box of all points, metres."""
        if not len(self.points):
            return 0.0
        return math.sqrt(float(np.square(self.points.max(axis=0) - self.points.min(axis=0)).sum()))

    def __getitem__(self, index: int) -> Floats:
        """Positions ``(n, d)`` of one track, a view."""
        index = range(len(self))[index]
        return self.points[self.offsets[index] : self.offsets[index + 1]]

    def times_of(self, index: int) -> Floats:
        """Times ``(n,)`` of one track, seconds, a view."""
        index = range(len(self))[index]
        return self.times[self.offsets[index] : self.offsets[index + 1]]

    def __iter__(self) -> Iterator[Floats]:
        return (self[i] for i in range(len(self)))

    # How long, how far, how fast

    @property
    def length(self) -> Floats:
        """``(M,)`` distance travelled, metres (``lengths`` counts points)."""
        return ragged.sum_by_track(ragged.step_lengths(self.points, self.offsets), self.offsets)

    @property
    def duration(self) -> Floats:
        """``(M,)`` seconds from first to last point."""
        return self.times[self.offsets[1:] - 1] - self.times[self.offsets[:-1]]

    @property
    def speed(self) -> Floats:
        """``(M,)`` mean speed, metres per second: distance travelled over duration, 0 for a single point."""
        duration = self.duration
        return np.divide(self.length, duration, out=np.zeros(len(self)), where=duration > 0)

    @property
    def median_spacing(self) -> float:
        """Median distance between successive points of a track, metres; NaN without any."""
        return self._median(ragged.step_lengths(self.points, self.offsets))

    @property
    def median_interval(self) -> float:
        """Median time between successive points of a track, seconds; NaN without any."""
        return self._median(np.diff(self.times, prepend=0.0))

    def _median(self, steps: Floats) -> float:
        inner = np.ones(len(steps), dtype=bool)
        inner[self.offsets[:-1]] = False
        return float(np.median(steps[inner])) if inner.any() else float("nan")


def _frozen(table: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    out = {}
    for name, values in table.items():
        array = np.asarray(values)
        if array.dtype == object:
            raise ValueError(f"{name!r} holds Python objects: give numbers or strings (`dtype=str`)")
        view = array.view()
        view.flags.writeable = False
        out[name] = view
    return MappingProxyType(out)
