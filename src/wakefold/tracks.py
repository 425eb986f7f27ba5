"""Tracks: timed sequences of positions of many agents, as ragged immutable arrays.

Inside, positions are metres in a local plane (or the data's own plane units) and times are seconds, UTC since
1970-01-01. Degrees live at the edges only: readers project on the way in, writers on the way out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from wakefold.projection import Projection

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Tracks:
    """Many tracks in one set of flat arrays; track ``i`` owns the rows ``offsets[i]:offsets[i + 1]``.

    Attributes:
        points: ``(P, d)`` float64 positions, d = 1, 2 or 3, metres (or plane units). Finite.
        times: ``(P,)`` float64 seconds, strictly increasing inside each track.
        offsets: ``(M + 1,)`` int64, no track is empty.
        ids: ``(M,)`` strings, unique.
        projection: how the plane relates to longitude and latitude; None for planar data.
        attributes: per-track arrays ``(M,)`` such as ``agent``, ``name``, ``type``, ``destination``.
        columns: per-point float arrays ``(P,)`` such as ``sog`` (m/s), ``cog`` (deg); NaN where unknown. Kept by
            whatever selects points, dropped by whatever makes new points (resampling).

    Raises:
        ValueError: a non-finite position or time, times not increasing, an empty track or ids that repeat; the
            message names the track.
    """

    points: Floats
    times: Floats
    offsets: NDArray[np.int64]
    ids: NDArray[np.str_]
    projection: Projection | None = None
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        points = np.ascontiguousarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] not in (1, 2, 3):
            raise ValueError(f"points must be (P, d) with d = 1, 2 or 3, got shape {points.shape}")
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
        if len(np.unique(ids)) != len(ids):
            names, counts = np.unique(ids, return_counts=True)
            raise ValueError(f"track id {names[counts > 1][0]!r} is used more than once")
        if (lengths <= 0).any():
            raise ValueError(f"track {ids[np.argmax(lengths <= 0)]!r} has no points")
        self._refuse(~np.isfinite(points).all(axis=1), offsets, ids, "a position that is not finite")
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

    @staticmethod
    def _refuse(bad: NDArray[np.bool_], offsets: NDArray[np.int64], ids: NDArray[np.str_], what: str) -> None:
        if bad.any():
            row = int(np.argmax(bad))
            track = int(np.searchsorted(offsets, row, side="right")) - 1
            raise ValueError(f"track {str(ids[track])!r} has {what} (point {row - offsets[track]})")

    @classmethod
    def from_arrays(
        cls,
        points: Sequence[ArrayLike],
        times: Sequence[ArrayLike] | None = None,
        ids: Sequence[str] | None = None,
        projection: Projection | None = None,
    ) -> Tracks:
        """Tracks from one array of positions per track, each ``(n, d)`` (or ``(n,)`` for d = 1).

        Args:
            points: positions, metres or plane units.
            times: seconds, one array per track; without them the points are one second apart, from 0.
            ids: one name per track; "0", "1", ... without them.
        """
        arrays = [np.asarray(p, dtype=np.float64) for p in points]
        arrays = [p[:, None] if p.ndim == 1 else p for p in arrays]
        if not arrays:
            raise ValueError("no tracks")
        if times is None:
            times = [np.arange(len(p), dtype=np.float64) for p in arrays]
        return cls(
            points=np.concatenate(arrays),
            times=np.concatenate([np.asarray(t, dtype=np.float64) for t in times]),
            offsets=np.concatenate([[0], np.cumsum([len(p) for p in arrays])]),
            ids=np.array([str(i) for i in (ids if ids is not None else range(len(arrays)))], dtype=np.str_),
            projection=projection,
        )

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
        return float(np.linalg.norm(self.points.max(axis=0) - self.points.min(axis=0))) if len(self.points) else 0.0

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

    def select(self, tracks: ArrayLike) -> Tracks:
        """The named tracks, in the order given: indices or a boolean mask ``(M,)``."""
        chosen = np.asarray(tracks)
        chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen.astype(np.int64)
        lengths = self.lengths[chosen]
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        rows = np.arange(offsets[-1]) + np.repeat(self.offsets[chosen] - offsets[:-1], lengths)
        return Tracks(
            points=self.points[rows],
            times=self.times[rows],
            offsets=offsets,
            ids=self.ids[chosen],
            projection=self.projection,
            attributes={name: values[chosen] for name, values in self.attributes.items()},
            columns={name: values[rows] for name, values in self.columns.items()},
        )

    def __repr__(self) -> str:
        where = f", {self.projection}" if self.projection else ""
        return f"Tracks({len(self):,} tracks, {len(self.points):,} points, {self.dim}-D{where})"


def _frozen(table: Mapping[str, NDArray[Any]]) -> Mapping[str, NDArray[Any]]:
    out = {}
    for name, values in table.items():
        view = np.asarray(values).view()
        view.flags.writeable = False
        out[name] = view
    return MappingProxyType(out)
