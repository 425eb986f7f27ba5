"""Many agents at once: a block of observations put into their trails in order, and the answers to all of them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base import small
from wakefold.base.compile import inner, kernel
from wakefold.base.types import Bools, Floats, Ints
from wakefold.filters.kernels.trail import add_report, ahead, masses, none, put_one


class Block(NamedTuple):
    """Observations in the order in which they came.

    Attributes:
        rows: ``(n,)`` of the trails. fresh: ``(n,)`` whether the trail starts anew. keys: ``(n, 2)`` and who
            ``(n,)`` of those that do.
        at: ``(n,)`` seconds. known: ``(n,)`` whether there is a fix. positions: ``(n, d)``, sd ``(n,)`` of it, metres.
        first: ``(n + 1,)`` first report of each. intervals: ``(r, 2)``, odds ``(r,)`` of the reports.
    """

    rows: Ints
    fresh: Bools
    keys: NDArray[np.uint64]
    who: Floats
    at: Floats
    known: Bools
    positions: Floats
    sd: Floats
    first: Ints
    intervals: Ints
    odds: Floats


@inner
def _copy(trails, r, out, i):
    out.times[i], out.points[i], out.fixes[i] = trails.times[r], trails.points[r], trails.fixes[r]
    out.clock[i], out.sd[i], out.reports[i] = trails.clock[r], trails.sd[r], trails.reports[r]
    out.odds[i], out.told[i], out.key[i], out.step[i] = trails.odds[r], trails.told[r], trails.key[r], trails.step[r]
    out.who[i] = trails.who[r]


@kernel
def follow(trails, block, fastest, out, begun):
    """Take a block of observations in; ``out`` are the trails (n, ...) as they were right after each.

    Args:
        begun: (n,) is set where a fix was so far off that its trail began anew.
    """
    for i in range(len(block.rows)):
        r, first = block.rows[i], block.first[i]
        if block.fresh[i]:
            trails.fixes[r], trails.told[r], trails.step[r] = 0, 0, 0
            trails.times[r], trails.points[r], trails.reports[r], trails.odds[r] = 0.0, 0.0, 0, 1.0
            trails.who[r] = block.who[i]
            trails.key[r], trails.clock[r], trails.sd[r] = block.keys[i], block.at[i], 1.0
            if block.known[i]:
                put_one(trails, r, block.at[i], block.positions[i], block.sd[i], fastest)
        if not block.fresh[i] or first < block.first[i + 1]:
            trails.step[r] += 1
            trails.clock[r] = max(trails.clock[r], block.at[i])
        if block.known[i] and not block.fresh[i]:
            begun[i] = put_one(trails, r, block.at[i], block.positions[i], block.sd[i], fastest)
        for j in range(first, block.first[i + 1]):
            add_report(trails, r, block.intervals[j, 0], block.intervals[j, 1], block.odds[j])
        _copy(trails, r, out, i)


@kernel
def effective(mass):
    """Effective number of what has masses of sum 1."""
    total = 0.0
    for k in range(len(mass)):
        total += mass[k] * mass[k]
    return 1.0 / total


@kernel
def answers(trails, past, dim, seconds, samples, cuts, first_cut, means, spreads, best, probability, tracks, doubts):
    """What is believed of n agents.

    Args:
        dim: number of coordinates of the tracks.
        seconds: (H,) after their clocks that positions are asked for.
        samples: number of positions drawn for each.
        cuts: of all levels, leaf ranks that classes begin at; ``first_cut`` (L + 1,) where those of each level begin.
        means: (n, H, d) and ``spreads`` (n, H) standard deviation per axis, of positions.
        best: (n, L) number of the likeliest class of each level in leaf order, and its ``probability`` (n, L).
        tracks: (n,) effective number of tracks. doubts: (n,) probability of none.
    """
    n, horizons = len(trails.fixes), len(seconds)
    rows, ask = np.arange(n), np.empty((1, horizons))
    drawn = np.empty((1, horizons, samples, past.points.shape[1]))
    taken, mass = np.empty((1, horizons, samples), dtype=np.int64), np.empty((1, len(past.rank)))
    weights, sums = np.full(samples, 1.0 / samples), np.empty(len(past.rank) + 1)
    ask[0] = seconds
    for i in range(n):
        one = rows[i : i + 1]
        ahead(trails, one, past, ask, drawn, taken)
        for h in range(horizons):
            points = np.ascontiguousarray(drawn[0, h, :, :dim])
            centre = small.mean(weights, points)
            cov, total = small.covariance(weights, points, centre), 0.0
            for k in range(dim):
                means[i, h, k] = centre[k]
                total += cov[k, k] + (trails.sd[i] * trails.sd[i] if trails.fixes[i] else 0.0)
            spreads[i, h] = math.sqrt(total / dim)
        masses(trails, one, past, mass)
        sums[0] = 0.0
        for k in range(len(past.rank)):
            sums[k + 1] = sums[k] + mass[0, k]
        for level in range(len(first_cut) - 1):
            likeliest = -1.0
            for c in range(first_cut[level], first_cut[level + 1] - 1):
                p = max(sums[cuts[c + 1]] - sums[cuts[c]], 0.0)
                if p > likeliest:
                    likeliest, best[i, level] = p, c - first_cut[level]
            probability[i, level] = likeliest
        tracks[i] = effective(mass[0])
        none(trails, one, past, doubts[i : i + 1])
