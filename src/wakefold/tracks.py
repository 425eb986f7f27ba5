"""Tracks: timed sequences of positions of many agents, as ragged immutable arrays.

Inside, positions are metres in a local plane (or the data's own plane units) and times are seconds, UTC since
1970-01-01. Degrees live at the edges only: readers project on the way in, writers on the way out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold import ragged, shaping, store
from wakefold.projection import Projection
from wakefold.sketch import sketch

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
        notes: what earlier steps left out, one sentence per step: nothing is dropped silently.

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
    notes: tuple[str, ...] = ()

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
        return Tracks, (self.points, self.times, self.offsets, self.ids, self.projection, *tables, self.notes)

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

    @classmethod
    def from_columns(
        cls,
        *,
        agent: ArrayLike,
        time: ArrayLike,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
        z: ArrayLike | None = None,
        lon: ArrayLike | None = None,
        lat: ArrayLike | None = None,
        projection: Projection | None = None,
        attributes: Mapping[str, ArrayLike] | None = None,
        columns: Mapping[str, ArrayLike] | None = None,
    ) -> Tracks:
        """One track per agent from the columns of a table, ``(n,)`` each, rows in any order; `segment` cuts them.

        Of several rows of one agent at one time the first is kept; ``notes`` counts the others.

        Args:
            agent: who; its text is the track's id and its attribute ``agent``. Tracks are sorted by it.
            time: seconds UTC since 1970, or datetime64.
            x, y, z: metres or plane units; y and z may be missing.
            lon, lat: degrees, instead of x and y.
            projection: the plane for lon and lat; chosen from the data where it is not given.
            attributes: what belongs to the agent; the value of its earliest row is kept.
            columns: what belongs to the row.

        Raises:
            ValueError: neither or both of x and lon given, or columns of different lengths.
        """
        if (x is None) == (lon is None) or (lon is None) != (lat is None):
            raise ValueError("give either x (and y, z) or lon and lat")
        if lon is not None and lat is not None:
            projection = projection or Projection.of(lon, lat)
            plane = [*projection.to_plane(lon, lat).T, *([] if z is None else [z])]
        else:
            plane = [np.asarray(axis, dtype=np.float64) for axis in (x, y, z) if axis is not None]
        clock = np.asarray(time)
        if clock.dtype.kind == "M":
            clock = (clock - np.datetime64(0, "s")) / np.timedelta64(1, "s")
        names, who = np.unique(np.asarray(agent), return_inverse=True)
        everything = [clock, *plane, *(attributes or {}).values(), *(columns or {}).values()]
        if any(np.shape(values) != who.shape for values in everything):
            raise ValueError(f"every column must have {len(who)} rows, like agent")
        rows = np.lexsort((clock, who))
        fresh = np.ones(len(rows), dtype=bool)
        fresh[1:] = (np.diff(who[rows]) != 0) | (np.diff(clock[rows]) != 0)
        rows = rows[fresh]
        first = np.searchsorted(who[rows], np.arange(len(names)))
        again = len(who) - len(rows)
        return cls(
            points=np.stack(plane, axis=1)[rows],
            times=clock[rows],
            offsets=np.append(first, len(rows)),
            ids=names.astype(np.str_),
            projection=projection,
            attributes={
                "agent": names.astype(np.str_),
                **{name: np.asarray(values)[rows[first]] for name, values in (attributes or {}).items()},
            },
            columns={name: np.asarray(values)[rows] for name, values in (columns or {}).items()},
            notes=(f"from_columns: {again:,} rows repeat the time of another row of their agent",) if again else (),
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

    def lonlat(self, index: int) -> Floats:
        """Longitude and latitude ``(n, 2)`` of one track, degrees.

        Raises:
            ValueError: the tracks are planar.
        """
        return shaping.geodetic(self).to_geodetic(self[index])

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

    # Choosing, cutting and thinning: each returns new Tracks

    filter = shaping.filter
    segment = shaping.segment
    resample = shaping.resample
    simplify = shaping.simplify
    project = shaping.project

    def select(self, tracks: ArrayLike) -> Tracks:
        """The named tracks, in the order given: indices or a boolean mask ``(M,)``."""
        chosen = np.asarray(tracks)
        chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen.astype(np.int64)
        lengths = self.lengths[chosen]
        rows = ragged.ragged_rows(self.offsets[chosen], lengths)
        return shaping.take(self, rows, np.append(0, np.cumsum(lengths)), chosen, self.ids[chosen])

    @classmethod
    def concat(cls, parts: Sequence[Tracks]) -> Tracks:
        """All tracks of all parts, in order. An attribute or column that a part lacks is "" or NaN there.

        Raises:
            ValueError: no parts, different planes or numbers of coordinates, or an id used twice.
        """
        if not parts:
            raise ValueError("nothing to put together")
        if len({(part.projection, part.dim) for part in parts}) > 1:
            raise ValueError("the parts lie in different planes: `project` them onto one first")
        starts = np.cumsum([0] + [len(part.points) for part in parts])
        return cls(
            points=np.concatenate([part.points for part in parts]),
            times=np.concatenate([part.times for part in parts]),
            offsets=np.concatenate([[0], *(part.offsets[1:] + at for part, at in zip(parts, starts, strict=False))]),
            ids=np.concatenate([part.ids for part in parts]),
            projection=parts[0].projection,
            attributes=_joined([(part.attributes, len(part)) for part in parts]),
            columns=_joined([(part.columns, len(part.points)) for part in parts]),
            notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
        )

    # On disk and on screen

    def packed(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and JSON metadata that `unpacked` takes back."""
        arrays: dict[str, NDArray[Any]] = {name: getattr(self, name) for name in ("points", "times", "offsets", "ids")}
        for kind in ("attributes", "columns"):
            arrays |= {f"{kind}_{k}": values for k, values in enumerate(getattr(self, kind).values())}
        place = self.projection
        meta = {
            "projection": None if place is None else {"lon": place.lon, "lat": place.lat},
            "attributes": list(self.attributes),
            "columns": list(self.columns),
            "notes": list(self.notes),
        }
        return arrays, meta

    @classmethod
    def unpacked(cls, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> Tracks:
        """Tracks from what `packed` gave.

        Raises:
            StoreError: something is missing or unsound.
        """
        try:
            return cls(
                points=arrays["points"],
                times=arrays["times"],
                offsets=arrays["offsets"],
                ids=arrays["ids"],
                projection=None if meta["projection"] is None else Projection(**meta["projection"]),
                attributes={name: arrays[f"attributes_{k}"] for k, name in enumerate(meta["attributes"])},
                columns={name: arrays[f"columns_{k}"] for k, name in enumerate(meta["columns"])},
                notes=tuple(meta["notes"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise store.StoreError(f"this does not describe tracks: {error}") from None

    def save(self, directory: str | Path) -> None:
        """Write a directory that `Tracks.load` reads back bit for bit (`wakefold.store`)."""
        store.save(directory, *self.packed(), kind="tracks")

    @classmethod
    def load(cls, directory: str | Path) -> Tracks:
        """Tracks written by `save`, memory-mapped.

        Raises:
            StoreError: not a directory of tracks, another version, or files edited, missing or cut short.
        """
        return cls.unpacked(*store.load(directory, kind="tracks"))

    def __repr__(self) -> str:
        where = f", {self.projection}" if self.projection else ""
        return f"Tracks({len(self):,} tracks, {len(self.points):,} points, {self.dim}-D{where})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(str(self.ids[i]))}</td><td>{self.lengths[i]:,}</td><td>{self.length[i]:,.0f}</td>"
            f"<td>{self.duration[i] / 60:,.1f}</td></tr>"
            for i in range(min(5, len(self)))
        )
        more = f"<tr><td colspan=4>and {len(self) - 5:,} more</td></tr>" if len(self) > 5 else ""
        notes = "".join(f"<br><small>{escape(note)}</small>" for note in self.notes)
        return (
            f"<div><b>{escape(repr(self))}</b>{notes}<div style='display:flex;gap:1em'>"
            f"{sketch(self.points, self.offsets)}<table><tr><th>track</th><th>points</th><th>metres</th>"
            f"<th>minutes</th></tr>{rows}{more}</table></div></div>"
        )


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


def _joined(parts: Sequence[tuple[Mapping[str, NDArray[Any]], int]]) -> dict[str, NDArray[Any]]:
    """Tables put under one another; a name that a part lacks is filled with "" or NaN for its rows."""
    out = {}
    for name in dict.fromkeys(name for table, _ in parts for name in table):
        known = [table[name] for table, _ in parts if name in table]
        blank = "" if any(values.dtype.kind in "US" for values in known) else np.nan
        out[name] = np.concatenate([table[name] if name in table else np.full(rows, blank) for table, rows in parts])
    return out
