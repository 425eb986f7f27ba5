"""Arithmetic on ragged arrays of tracks: pieces, steps, resampling. What `wakefold.tracks.shaping` is made of.

Everywhere ``points`` is ``(P, d)`` metres, ``times`` ``(P,)`` seconds, and track ``i`` owns the rows
``offsets[i]:offsets[i + 1]``. The result for one track never depends on the tracks beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from wakefold.base.types import Bools, Floats, Ints

_MOST_POINTS = 1_000_000_000  # a resampling that would make more points than this is a mistake in the data or units


class Pieces(NamedTuple):
    """Consecutive runs of rows cut from tracks.

    Attributes:
        rows: the rows kept, in order.
        offsets: ``(K + 1,)``, piece k owns ``rows[offsets[k]:offsets[k + 1]]``.
        track: ``(K,)`` the track each piece came from.
        number: ``(K,)`` its number inside that track, from 0.
    """

    rows: Ints
    offsets: Ints
    track: Ints
    number: Ints


def pieces(offsets: Ints, kept: Bools, cut: Bools) -> Pieces:
    """Maximal runs of ``kept`` rows of one track, begun anew at every row marked in ``cut``; both ``(P,)``."""
    begins = cut.copy()
    begins[offsets[:-1]] = True
    begins[1:] |= ~kept[:-1]
    begins &= kept
    rows = np.flatnonzero(kept)
    first = np.flatnonzero(begins)
    track = np.searchsorted(offsets, first, side="right") - 1
    number = np.arange(len(first)) - np.searchsorted(track, track)
    return Pieces(rows, np.append(np.searchsorted(rows, first), len(rows)), track, number)


def gaps(times: Floats, offsets: Ints, longest: float) -> Bools:
    """``(P,)`` true where more than ``longest`` seconds went by since the point before of the same track."""
    after = np.zeros(len(times), dtype=bool)
    after[1:] = np.diff(times) > longest
    after[offsets[:-1]] = False
    return after


def ragged_rows(starts: Ints, lengths: Ints) -> Ints:
    """The rows ``starts[i], ..., starts[i] + lengths[i] - 1`` of every run, one run after the other."""
    ends = np.cumsum(lengths)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - ends + lengths, lengths)


def step_lengths(points: Floats, offsets: Ints) -> Floats:
    """``(P,)`` distance from the point before in the same track, metres; 0 for first points."""
    steps = np.zeros(len(points))
    steps[1:] = np.sqrt(np.square(np.diff(points, axis=0)).sum(axis=1))
    steps[offsets[:-1]] = 0.0
    return steps


def sum_by_track(values: Floats, offsets: Ints) -> Floats:
    """``(M,)`` sums of a per-point array ``(P,)`` over each track."""
    return np.add.reduceat(values, offsets[:-1]) if len(offsets) > 1 else np.zeros(0)


def distance_along(points: Floats, offsets: Ints) -> Floats:
    """``(P,)`` distance travelled since the first point of the track, metres."""
    steps = step_lengths(points, offsets)
    # Summed track by track: one running sum over all would round differently with other tracks in front.
    return np.concatenate([np.zeros(0), *(np.cumsum(steps[a:b]) for a, b in pairwise(offsets.tolist()))])


def interpolate(
    points: Floats, times: Floats, offsets: Ints, rulers: Floats, step: float, marks: Callable[..., Floats]
) -> tuple[Floats, Floats, Ints]:
    """New points by linear interpolation where ``marks(first, last, step)`` of each track's ruler ``(P,)`` says.

    Returns:
        points ``(Q, d)``, times ``(Q,)``, offsets ``(M + 1,)``.

    Raises:
        ValueError: it would make more than 1e9 points.
    """
    extents = rulers[offsets[1:] - 1] - rulers[offsets[:-1]]
    if not (extents / step).sum() < _MOST_POINTS:
        raise ValueError(f"steps of {step:g} over {extents.sum():g} in all make too many points")
    new_points, new_times = [points[:0]], [times[:0]]
    for first, end in pairwise(offsets.tolist()):
        p, t, ruler = points[first:end], times[first:end], rulers[first:end]
        at = marks(ruler[0], ruler[-1], step) if len(t) > 1 else ruler
        moved = np.stack([np.interp(at, ruler, x) for x in p.T], axis=1)
        when = np.interp(at, ruler, t)
        # A stationary stretch at either end is a jump of the interpolant: the ends are set, not interpolated.
        moved[0], when[0], moved[-1], when[-1] = p[0], t[0], p[-1], t[-1]
        # Points closer in time than the clock's resolution fall together: the earlier stays, and both ends do.
        fresh = np.ones(len(when), dtype=bool)
        fresh[1:-1] = (when[1:-1] > np.maximum.accumulate(when)[:-2]) & (when[1:-1] < when[-1])
        new_points.append(moved[fresh])
        new_times.append(when[fresh])
    lengths = [len(t) for t in new_times]
    return np.concatenate(new_points), np.concatenate(new_times), np.cumsum(lengths)


def even_distances(first: float, last: float, step: float) -> Floats:
    """first, ..., last in the fewest equal steps no longer than ``step``: no sliver at the end, whose velocity
    would be rounding noise, and the same places for a track walked backwards."""
    # The slack keeps an extent that is a multiple of the step but for rounding from gaining one.
    steps = max(1, int(np.ceil((last - first) / step * (1 - 1e-12))))
    return np.linspace(first, last, steps + 1)


def even_times(first: float, last: float, step: float) -> Floats:
    """first, first + step, ..., and last; a last step under a millisecond is merged into the one before."""
    at = first + step * np.arange(1, int((last - first) / step) + 1)
    return np.concatenate([[first], at[at < last - 1e-3], [last]])
