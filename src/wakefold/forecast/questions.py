"""Questions about held-out tracks: where will the agent be, at moments at which only its fixes so far are known.

Of a track a fix is given at most every so many seconds. A question is a fix, given when the track is old enough, and a
horizon at which the true position is known: on the line between the positions before and after it, and never past
the end of the track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints
from wakefold.forecast import kernels
from wakefold.tracks.shaping import take
from wakefold.tracks.tracks import Tracks

Which = Literal["all", "first"]
SHARES = (0.25, 0.5, 0.75)  # of the duration of a track: when its class is asked for
ROUNDING = 1e-3  # of the time between fixes: clocks count in steps that are no whole numbers, some in single precision


@dataclass(frozen=True, eq=False)
class Questions(Remembers):
    """All that is asked about T tracks at Q moments for H horizons.

    Attributes:
        fixes: the fixes that are given of each track, its first point among them.
        row: ``(Q,)`` rows of ``fixes`` after which is asked, rising; a method may use the rows of the track up to them.
        horizons: ``(H,)`` seconds ahead, rising.
        truth: ``(Q, H, d)`` where the agent was then; NaN where nothing is asked as it is not known.
        class_row: ``(T, 3)`` rows of ``fixes`` after which the class of the whole track is asked for: the last one
            within a quarter, half and three quarters of its duration.
    """

    fixes: Tracks
    row: Ints
    horizons: Floats
    truth: Floats
    class_row: Ints

    def __len__(self) -> int:
        """Number of moments, Q."""
        return len(self.row)

    @cached_property
    def track(self) -> Ints:
        """``(Q,)`` track of each moment."""
        return np.searchsorted(self.fixes.offsets, self.row, side="right") - 1

    @property
    def asked(self) -> Ints:
        """``(H,)`` number of questions for each horizon."""
        return np.isfinite(self.truth[:, :, 0]).sum(axis=0)

    @property
    def here(self) -> Floats:
        """``(Q, d)`` the last fix."""
        return self.fixes.points[self.row]

    def back(self, lags: Sequence[float] | Floats) -> Floats:
        """``(Q, L, d)`` places so many seconds before, on the line between fixes; before the first one, at it."""
        return back(self.fixes, self.row, lags)

    def velocity(self, window: float) -> Floats:
        """``(Q, d)`` mean velocity over the last ``window`` seconds, or since the first fix."""
        age = self.fixes.times[self.row] - self.fixes.times[self.fixes.offsets[self.track]]
        span = np.minimum(window, age)
        gone = self.here - self.back([window])[:, 0]
        return np.divide(gone, span[:, None], out=np.zeros_like(gone), where=span[:, None] > 0)

    def of(self, tracks: Ints | Sequence[int]) -> Questions:
        """Those about some tracks, whose indices rise."""
        chosen = np.asarray(tracks, dtype=np.int64)
        starts, lengths = self.fixes.offsets[chosen], self.fixes.lengths[chosen]
        moved = np.zeros(len(self.fixes), dtype=np.int64)
        moved[chosen] = np.append(0, np.cumsum(lengths))[:-1] - starts
        kept = np.isin(self.track, chosen)
        row = self.row[kept] + moved[self.track[kept]]
        class_row = self.class_row[chosen] + moved[chosen, None]
        return Questions(self.fixes.select(chosen), row, self.horizons, self.truth[kept], class_row)

    def thinned(self, most: int) -> Questions:
        """About so many moments at most, evenly spread."""
        kept = thinning(len(self), most)
        return Questions(self.fixes, self.row[kept], self.horizons, self.truth[kept], self.class_row)


def back(fixes: Tracks, row: Ints, lags: Sequence[float] | Floats) -> Floats:
    """``(Q, L, d)`` places so many seconds before rows of tracks; before the first point of a track, at it."""
    first = fixes.offsets[np.searchsorted(fixes.offsets, row, side="right") - 1]
    out = np.empty((len(row), len(lags), fixes.dim))
    kernels.back(fixes.points, fixes.times, first, row, np.asarray(lags, dtype=np.float64), out)
    return out


def ask(
    tracks: Tracks, horizons: Sequence[float] | Floats, every: float, after: float, which: Which = "all"
) -> Questions:
    """All questions about tracks.

    Args:
        tracks: held out, as they were recorded.
        horizons: seconds ahead.
        every: seconds between the fixes given, at least.
        after: age of a track, seconds, from which on questions are asked.
        which: "all", or the "first" moment of each track alone.
    """
    if which not in ("all", "first"):
        raise ValueError(f"questions must be 'all' or 'first', got {which!r}")
    seen, slack = np.zeros(len(tracks.points), dtype=np.bool_), ROUNDING * every
    kernels.given(tracks.times, tracks.offsets, every - slack, seen)
    rows = np.flatnonzero(seen)
    offsets = np.append(0, np.cumsum(seen))[tracks.offsets]
    fixes = take(tracks, rows, offsets, np.arange(len(tracks)), tracks.ids)
    track = np.repeat(np.arange(len(tracks)), fixes.lengths)
    begin, end = tracks.times[tracks.offsets[:-1]], tracks.times[tracks.offsets[1:] - 1]
    old = (fixes.times - begin[track] >= after - slack) & (np.arange(len(rows)) > fixes.offsets[track])
    row = np.flatnonzero(old)
    if which == "first":
        row = row[np.unique(track[row], return_index=True)[1]]
    ahead = np.array(sorted({float(h) for h in horizons}))
    when = fixes.times[row][:, None] + ahead
    truth = np.empty((len(row), len(ahead), tracks.dim))
    kernels.places(tracks.points, tracks.times, tracks.offsets, track[row], when, truth)
    truth[when > end[track[row], None] + slack] = np.nan
    kept = np.isfinite(truth[:, :, 0]).any(axis=1)
    moments = begin[:, None] + (end - begin)[:, None] * np.array(SHARES)
    class_row = np.array([
        fixes.offsets[t] + np.searchsorted(fixes.times_of(t), moments[t] + slack, side="right") - 1
        for t in range(len(tracks))
    ]).reshape(-1, len(SHARES))  # fmt: skip
    return Questions(fixes, row[kept], ahead, truth[kept], class_row)


def thinning(length: int, most: int) -> Ints:
    """So many indices of ``length`` at most, evenly spread."""
    return np.arange(length) if length <= most else np.unique(np.linspace(0, length - 1, most).astype(np.int64))
