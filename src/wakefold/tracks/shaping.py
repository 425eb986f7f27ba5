"""Choosing, cutting and thinning tracks. Each function is also a method of `Tracks` and returns new tracks."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.types import Floats, Ints
from wakefold.base.units import Duration, Length, Time, metres, seconds, timestamp
from wakefold.base.wording import counted
from wakefold.tracks import ragged
from wakefold.tracks.arrays import TrackArrays
from wakefold.tracks.projection import Projection

T = TypeVar("T", bound=TrackArrays)


def select(tracks: T, chosen: ArrayLike) -> T:
    """The chosen tracks, in the order given: indices or a boolean mask ``(M,)``."""
    which = np.asarray(chosen)
    which = np.flatnonzero(which) if which.dtype == bool else which.astype(np.int64)
    lengths = tracks.lengths[which]
    rows = ragged.ragged_rows(tracks.offsets[which], lengths)
    return take(tracks, rows, np.append(0, np.cumsum(lengths)), which, tracks.ids[which])


def filter(
    tracks: T,
    *,
    min_points: int = 0,
    min_length: Length = 0.0,
    min_duration: Duration = 0.0,
    box: tuple[float, float, float, float] | None = None,
    lonlat_box: tuple[float, float, float, float] | None = None,
    time: tuple[Time | None, Time | None] | None = None,
    agents: Collection[str | int] | None = None,
) -> T:
    """The tracks that meet every condition, whole; ``notes`` says how many failed which.

    Args:
        min_points: fewest points of a track.
        min_length: shortest distance travelled, metres or such as "2km".
        min_duration: shortest duration, seconds or such as "10min".
        box: (x0, y0, x1, y1), metres; every point of the track lies in it, edges included.
        lonlat_box: (west, south, east, north), degrees, likewise; west > east crosses the antimeridian.
        time: (begin, end); every point lies in begin <= t < end; None leaves a side open.
        agents: values of the attribute ``agent``, or track ids where there is no such attribute.
    """
    tests = {
        "min_points": tracks.lengths >= min_points,
        "min_length": tracks.length >= metres(min_length),
        "min_duration": tracks.duration >= seconds(min_duration),
    }
    if box is not None:
        x0, y0, x1, y1 = box
        x, y = tracks.points[:, 0], tracks.points[:, min(1, tracks.dim - 1)]
        tests["box"] = _every(tracks.offsets, (x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1))
    if lonlat_box is not None:
        west, south, east, north = lonlat_box
        lon, lat = geodetic(tracks).to_geodetic(tracks.points).T
        between = (lon - west) % 360 <= (east - west if east - west == 360 else (east - west) % 360)
        tests["lonlat_box"] = _every(tracks.offsets, between & (south <= lat) & (lat <= north))
    if time is not None:
        begin, end = time
        after = tracks.times >= timestamp(begin) if begin is not None else True
        before = tracks.times < timestamp(end) if end is not None else True
        tests["time"] = _every(tracks.offsets, np.ones(len(tracks.times), dtype=bool) & after & before)
    if agents is not None:
        tests["agents"] = np.isin(_agents(tracks).astype(np.str_), [str(a) for a in agents])
    good, failed = np.ones(len(tracks), dtype=bool), []
    for name, passed in tests.items():
        if (good & ~passed).any():
            failed.append(f"{(good & ~passed).sum():,} by {name}")
        good &= passed
    left_out = [f"filter: {(~good).sum():,} of {len(tracks):,} tracks left out ({', '.join(failed)})"] if failed else []
    return _noted(select(tracks, good), left_out)


def segment(
    tracks: T,
    max_gap: Duration | None = None,
    *,
    min_points: int = 2,
    max_speed: float | None = None,
    stop_radius: Length | None = None,
    stop_time: Duration | None = None,
) -> T:
    """Tracks cut where the agent was silent, where it cannot have gone and where it stood still.

    A gap is more than ``max_gap`` between two successive points. A leg from one point to the next that needs more than
    ``max_speed`` joins what belongs to different agents, or to no one. A stop is a maximal run of points that stays
    within ``stop_radius`` of its first point for at least ``stop_time``, gaps or not, the earliest first; its
    points are cut out and the moving pieces before and after it are kept.

    Piece k of track "a" is called "a#k", counted before short pieces are left out. The attribute ``agent``
    (the id of the track cut, where there was none) and all other attributes are repeated for every piece.
    ``notes`` says how many stops, short pieces and points were left out.

    Args:
        max_gap: seconds, or such as "30min".
        min_points: pieces with fewer points are left out; 1 keeps all.
        max_speed: metres per second.
        stop_radius: metres, or such as "50m".
        stop_time: seconds, or such as "10min".

    Raises:
        ValueError: no gap, speed or stop is given, a speed of 0 or less, or only one of the two numbers of a stop.
    """
    if (stop_radius is None) != (stop_time is None):
        raise ValueError("a stop needs both stop_radius and stop_time")
    if max_gap is None and max_speed is None and stop_radius is None:
        raise ValueError("give max_gap, max_speed, or stop_radius and stop_time")
    if max_speed is not None and not max_speed > 0:
        raise ValueError("max_speed must be above 0")
    moving = np.ones(len(tracks.points), dtype=bool)
    if stop_radius is not None and stop_time is not None:
        from wakefold.tracks.kernels.ragged import mark_stops

        if not (least := seconds(stop_time)) > 0:
            raise ValueError("stop_time must be above 0")
        stopped = np.zeros(len(tracks.points), dtype=bool)
        mark_stops(tracks.points, tracks.times, tracks.offsets, metres(stop_radius), least, stopped)
        moving = ~stopped
    longest = np.inf if max_gap is None else seconds(max_gap)
    cuts = ragged.gaps(tracks.times, tracks.offsets, longest)
    if max_speed is not None:
        cuts |= fast_legs(tracks, max_speed)
    cut = ragged.pieces(tracks.offsets, moving, cuts)
    ids = np.array([f"{tracks.ids[i]}#{k}" for i, k in zip(cut.track, cut.number, strict=True)], dtype=np.str_)
    every = take(tracks, cut.rows, cut.offsets, cut.track, ids)
    every = replace(every, attributes={**every.attributes, "agent": _agents(tracks)[cut.track]})
    short = every.lengths < min_points
    notes = [f"segment: {counted(len(tracks), 'track')} cut into {counted(len(every), 'piece')}"]
    if not moving.all():
        notes.append(f"segment: {counted((~moving).sum(), 'point')} in stops left out")
    if short.any():
        pieces, points = counted(short.sum(), "piece"), counted(every.lengths[short].sum(), "point")
        notes.append(f"segment: {pieces} of under {min_points} points left out ({points})")
    return _noted(select(every, ~short), notes)


def fast_legs(tracks: TrackArrays, speed: float) -> NDArray[np.bool_]:
    """``(P,)`` true where getting here from the point before of the same track takes more than a speed, m/s."""
    legs = ragged.step_lengths(tracks.points, tracks.offsets)
    return (legs > 0) & (legs > speed * np.diff(tracks.times, prepend=-np.inf))


def resample(tracks: T, spacing: Length | None = None, *, period: Duration | None = None) -> T:
    """New points by linear interpolation, evenly along each track or evenly in time.

    First and last points stay as they are. By distance, a track is divided into the fewest equal steps no
    longer than ``spacing`` (along the track; standing still is one long step, a track that never moves keeps
    its two ends). By time, points are ``period`` apart from the first on; the last step may be shorter.
    Gaps are bridged in a straight line: `segment` first. Attributes stay, per-point columns go.

    Args:
        spacing: metres, or such as "200m".
        period: seconds, or such as "60s".

    Raises:
        ValueError: both or neither given, one of them 0, or more than 1e9 points would come of it.
    """
    if spacing is not None and period is None:
        rulers, step = ragged.distance_along(tracks.points, tracks.offsets), metres(spacing)
        marks = ragged.even_distances
    elif period is not None and spacing is None:
        rulers, step = tracks.times, seconds(period)
        marks = ragged.even_times
    else:
        raise ValueError("give either spacing or period")
    if step == 0:
        raise ValueError("spacing or period must be above 0")
    points, times, offsets = ragged.interpolate(tracks.points, tracks.times, tracks.offsets, rulers, step, marks)
    return replace(tracks, points=points, times=times, offsets=offsets, columns={})


def simplify(tracks: T, tolerance: Length) -> T:
    """Fewer points: every point left out lies within ``tolerance`` of the line between its kept neighbours
    (Douglas and Peucker 1973). Only the shape counts, not the times.

    Args:
        tolerance: metres, or such as "20m".
    """
    from wakefold.tracks.kernels.ragged import douglas_peucker

    kept = np.zeros(len(tracks.points), dtype=bool)
    douglas_peucker(tracks.points, tracks.offsets, metres(tolerance), kept)
    offsets = np.append(0, np.cumsum(kept))[tracks.offsets]
    thinned = take(tracks, np.flatnonzero(kept), offsets, np.arange(len(tracks)), tracks.ids)
    return _noted(thinned, [f"simplify: {(~kept).sum():,} of {len(kept):,} points left out"])


def project(tracks: T, projection: Projection) -> T:
    """The same tracks in another plane: what is compared must share one. Third coordinates stay.

    Raises:
        ValueError: the tracks are planar.
    """
    if projection == tracks.projection:
        return tracks
    lonlat = geodetic(tracks).to_geodetic(tracks.points)
    points = np.column_stack([projection.to_plane(*lonlat.T), tracks.points[:, 2:]])
    return replace(tracks, points=points, projection=projection)


def take(tracks: T, rows: NDArray[Any], offsets: NDArray[np.int64], track: NDArray[np.int64], ids: NDArray) -> T:
    """New tracks from ``rows`` of the points; new track k has the attributes of old track ``track[k]``."""
    return replace(
        tracks,
        points=tracks.points[rows],
        times=tracks.times[rows],
        offsets=offsets,
        ids=ids,
        attributes={name: values[track] for name, values in tracks.attributes.items()},
        columns={name: values[rows] for name, values in tracks.columns.items()},
    )


def geodetic(tracks: TrackArrays) -> Projection:
    """The projection of tracks that have one; ValueError for planar tracks."""
    if tracks.projection is None:
        raise ValueError("these tracks are planar: they have no longitude and latitude")
    return tracks.projection


def _agents(tracks: TrackArrays) -> NDArray[Any]:
    return tracks.attributes.get("agent", tracks.ids)


def _every(offsets: NDArray[np.int64], passed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``(M,)`` whether all points of a track passed."""
    return ragged.sum_by_track((~passed).astype(np.float64), offsets) == 0


def _noted(tracks: T, notes: Sequence[str]) -> T:
    return replace(tracks, notes=(*tracks.notes, *notes)) if notes else tracks


def along(tracks: TrackArrays, chosen: Ints, share: Floats) -> Floats:
    """Positions ``(N, d)`` at a share of the duration of each of the chosen tracks (N,)."""
    from wakefold.tracks.kernels import ragged as kernels

    out = np.empty((len(chosen), tracks.dim))
    kernels.along(tracks.points, tracks.times, tracks.offsets, chosen, share, out)
    return out
