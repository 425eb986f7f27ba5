"""Tracks: timed sequences of positions of many agents, as ragged immutable arrays.

Inside, positions are metres in a local plane (or the data's own plane units) and times are seconds, UTC since
1970-01-01. Degrees live at the edges only: readers project on the way in, writers on the way out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base import store
from wakefold.base.checks import shown
from wakefold.base.types import Floats
from wakefold.tracks import shaping
from wakefold.tracks.arrays import TrackArrays
from wakefold.tracks.projection import Projection
from wakefold.tracks.thumbnail import sketch


class Tracks(TrackArrays):
    """Many tracks in one set of flat arrays; track ``i`` owns the rows ``offsets[i]:offsets[i + 1]``.

    Attributes:
        points: ``(P, d)`` float64 positions, d = 1 to 16, metres (or plane units). Finite.
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
        if isinstance(points, str) or not isinstance(points, Iterable):
            raise TypeError(f"tracks are made of one array of positions each, got {shown(points)}")
        try:
            arrays = [np.asarray(p, dtype=np.float64) for p in points]
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"positions must be numbers, got {shown(points)}") from None
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

    def lonlat(self, index: int) -> Floats:
        """Longitude and latitude ``(n, 2)`` of one track, degrees.

        Raises:
            ValueError: the tracks are planar.
        """
        return shaping.geodetic(self).to_geodetic(self[index])

    # Choosing, cutting and thinning: each returns new Tracks

    select = shaping.select
    filter = shaping.filter
    segment = shaping.segment
    resample = shaping.resample
    simplify = shaping.simplify
    project = shaping.project

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
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            raise store.StoreError(f"this does not describe tracks: {error}") from None

    def save(self, directory: str | Path) -> None:
        """Write a directory that `Tracks.load` reads back bit for bit (`wakefold.base.store`)."""
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


def _joined(parts: Sequence[tuple[Mapping[str, NDArray[Any]], int]]) -> dict[str, NDArray[Any]]:
    """Tables put under one another; a name that a part lacks is filled with "" or NaN for its rows."""
    out = {}
    for name in dict.fromkeys(name for table, _ in parts for name in table):
        known = [table[name] for table, _ in parts if name in table]
        blank = "" if any(values.dtype.kind in "US" for values in known) else np.nan
        out[name] = np.concatenate([table[name] if name in table else np.full(rows, blank) for table, rows in parts])
    return out
