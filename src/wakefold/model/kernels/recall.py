"""What past states say of an agent's state now: neighbours in the forests, what became of them, and on which tracks.

An answer is a pool of members (docs/trail.md). The first three take past states of the forest of the map, for which the
agent goes where they went; the next three those of the forest of the own frame, for which it departs from constant
velocity as they did; the last takes any past state, of which it does the same. Within a forest, members differ in how
many past states, still on their way at the time asked about, a node must hold to be their neighbourhood.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.compile import inner
from wakefold.base.types import Floats, Ints, Singles
from wakefold.model.kernels.forest import descend, uniform
from wakefold.model.kernels.states import heading, steps

MAP, OWN, MEMBERS = 3, 3, 7
NEEDS = (1, 4, 16, 4, 16, 64)  # past states in the neighbourhoods of the members
TRIES = 20  # draws of a past state that reports speak for
FAR = 2.0  # times the greatest novelty known: from there on places known say nothing


class Trees(NamedTuple):
    """A forest; see ``forest``.

    Attributes:
        nodes: ``(N, 4)``; ``cuts`` the same memory as float32.
        rows: ``(R,)`` past states in the order of the leaves.
        first_node, first_row: ``(T + 1,)`` of each tree.
    """

    nodes: NDArray[np.int32]
    cuts: Singles
    rows: NDArray[np.int32]
    first_node: Ints
    first_row: Ints


class Past(NamedTuple):
    """Past states, and all that is known of how to ask them.

    Attributes:
        points: ``(S, d)`` metres, those of a track one after the other, ``step`` seconds apart.
        going: ``(S, 2)`` velocity over the base lag, m/s.
        track: ``(S,)``. begins: ``(M + 1,)`` first state of each track. rank: ``(M,)`` leaf rank of each.
        longest: ``(S,)`` the states by falling time to the end of their tracks, of ``left`` steps.
        step: seconds. lags: ``(K,)`` seconds. base: number of the lag that tells velocity.
        slow: m/s that are added to a speed before its logarithm. daily: whether the time of day counts.
        ways, own: the forests.
        horizons: ``(H,)`` seconds, rising. unusual: ``(B,)`` metres, rising: see ``novelty``.
        shares: ``(B, H, 7)`` of the members in a forecast. masses: ``(4,)`` of the members of the map, and of no
            knowledge, in the classes. doubts: ``(B,)`` how likely it is that an agent goes none of the ways known.
        dim: number of coordinates of the tracks.
    """

    points: Floats
    going: Singles
    track: NDArray[np.int32]
    begins: Ints
    rank: Ints
    longest: NDArray[np.int32]
    left: Ints
    step: float
    lags: Floats
    base: int
    slow: float
    daily: bool
    ways: Trees
    own: Trees
    horizons: Floats
    unusual: Floats
    shares: Floats
    masses: Floats
    doubts: Floats
    dim: int


@inner
def ways_down(x_map, x_own, past, use_map, use_own, ranges, depths):
    """The ways of an agent down the trees to be used: ranges (T, 2, DEEPEST + 2) and depths (T,), map first."""
    for i in range(len(use_map)):
        depths[i] = descend(x_map, past.ways, use_map[i], ranges[i, 0], ranges[i, 1])
    n = len(use_map)
    for i in range(len(use_own)):
        depths[n + i] = descend(x_own, past.own, use_own[i], ranges[n + i, 0], ranges[n + i, 1])


@inner
def _steps_left(past, row):
    return past.begins[past.track[row] + 1] - 1 - row


@inner
def neighbourhood(rows, past, ranges, depth, ahead, need):
    """The smallest node with ``need`` states still on their way ``ahead`` steps later: its range, and their number."""
    level = depth - 1
    while True:
        a, b = ranges[0, level], ranges[1, level]
        count = 0
        if ahead > 0.0:
            for i in range(a, b):
                if _steps_left(past, rows[i]) >= ahead:
                    count += 1
        else:
            count = b - a
        if count >= need or level == 0:
            return a, b, count
        level -= 1


@inner
def _told(past, row, reports, factors):
    """What reports make of a past state: the product of their factors; see ``members``."""
    g, rank = 1.0, past.rank[past.track[row]]
    for r in range(len(factors)):
        if not reports[r, 0] <= rank < reports[r, 1]:
            g *= factors[r]
    return g


@inner
def _member(rows, past, ranges, depths, ahead, need, reports, factors, dice, out):
    """Past states ``out`` (n,) of a member, ``ahead`` steps before what is asked: evenly over trees and their rows.

    With reports, in proportion to what they make of each state.
    """
    trees, n = len(depths), len(out)
    turn = uniform(dice)
    if len(factors) == 0:
        for i in range(n):
            t = int((i + turn) / n * trees)
            a, b, count = neighbourhood(rows, past, ranges[t], depths[t], ahead, need)
            if count == 0:
                out[i] = rows[a + int(uniform(dice) * (b - a))]
                continue
            k = int(uniform(dice) * count)
            for j in range(a, b):
                if ahead <= 0.0 or _steps_left(past, rows[j]) >= ahead:
                    if k == 0:
                        out[i] = rows[j]
                        break
                    k -= 1
        return
    weight, total = np.empty(trees), 0.0
    for t in range(trees):
        a, b, count = neighbourhood(rows, past, ranges[t], depths[t], ahead, need)
        weight[t] = 0.0
        for j in range(a, b):
            if count == 0 or _steps_left(past, rows[j]) >= ahead:
                weight[t] += _told(past, rows[j], reports, factors)
        weight[t] /= count if count else b - a
        total += weight[t]
    t, before = 0, 0.0
    for i in range(n):
        at = (i + turn) / n * total
        while t < trees - 1 and before + weight[t] <= at:
            before += weight[t]
            t += 1
        a, b, count = neighbourhood(rows, past, ranges[t], depths[t], ahead, need)
        left = uniform(dice) * weight[t] * (count if count else b - a)
        out[i] = rows[a]
        for j in range(a, b):
            if count == 0 or _steps_left(past, rows[j]) >= ahead:
                out[i] = rows[j]
                left -= _told(past, rows[j], reports, factors)
                if left < 0.0:
                    break


@inner
def _anyone(past, ahead, reports, factors, dice, out):
    """Past states ``out`` (n,) of the last member: any still on its way ``ahead`` steps later."""
    low, high = 0, len(past.longest)  # how many are
    while low < high:
        middle = (low + high) // 2
        if past.left[middle] >= ahead:
            low = middle + 1
        else:
            high = middle
    many, most = max(low, 1), 1.0
    for r in range(len(factors)):
        most *= max(factors[r], 1.0)
    for i in range(len(out)):
        for _ in range(TRIES if len(factors) else 1):
            out[i] = past.longest[int(uniform(dice) * many)]
            if len(factors) == 0 or uniform(dice) * most < _told(past, out[i], reports, factors):
                break


@inner
def moved(past, row, seconds, out):
    """Displacement ``out`` (d,) of a past state within ``seconds``, or until its track ends."""
    last = past.begins[past.track[row] + 1] - 1
    later = steps(seconds, past.step)
    a = min(row + int(later), last)
    b = min(a + 1, last)
    share = later - int(later) if a < last else 0.0
    for k in range(past.points.shape[1]):
        out[k] = past.points[a, k] + share * (past.points[b, k] - past.points[a, k]) - past.points[row, k]


@inner
def members(raw, past, used, ranges, depths, seconds, counts, reports, factors, dice, rows, out):
    """Positions ``out`` (n, d) ``seconds`` ahead, so many as ``counts`` (7,) says of each member in turn.

    Of more seconds than the longest track lasts, after so many as it does.

    Args:
        raw: the agent's state. used: number of trees of the map among ``depths``.
        reports: (r, 2) intervals of leaf ranks. factors: (r,) odds of a past state outside against one inside.
        rows: (n,) is filled with the past states.
    """
    d = past.points.shape[1]
    seconds = min(seconds, past.left[0] * past.step)
    ahead = math.ceil(steps(seconds, past.step) - 1e-9)
    ground, c, s = heading(raw, d, past.lags, past.base)
    n = 0
    for m in range(MEMBERS):
        first, n = n, n + counts[m]
        if counts[m] == 0:
            continue
        if m < MAP:
            _member(past.ways.rows, past, ranges[:used], depths[:used], ahead, NEEDS[m], reports, factors, dice,
                    rows[first:n])  # fmt: skip
        elif m < MAP + OWN:
            _member(past.own.rows, past, ranges[used:], depths[used:], ahead, NEEDS[m], reports, factors, dice,
                    rows[first:n])  # fmt: skip
        else:
            _anyone(past, ahead, reports, factors, dice, rows[first:n])
        for i in range(first, n):
            moved(past, rows[i], seconds, out[i])
            if m >= MAP:
                vx, vy = np.float64(past.going[rows[i], 0]), np.float64(past.going[rows[i], 1])
                x, y = out[i, 0] - seconds * vx, out[i, 1] - seconds * vy
                speed = math.sqrt(vx * vx + vy * vy)
                cj, sj = (vx / speed, vy / speed) if speed > 0.0 else (1.0, 0.0)
                along, across = x * cj + y * sj, y * cj - x * sj
                out[i, 0] = seconds * ground * c + along * c - across * s
                out[i, 1] = seconds * ground * s + along * s + across * c
            for k in range(d):
                out[i, k] += raw[k]


@inner
def finished(past, used, ranges, depths, seconds):
    """Probability that a voyage on its way at the last fix has ended ``seconds`` later.

    By the past states of the map's second member, and one of each kind more, as if seen; without trees by all states.
    """
    there, gone = 0, 0
    later = math.ceil(steps(seconds, past.step) - 1e-9)
    if used == 0:
        for i in range(len(past.left)):
            there += 1
            gone += past.left[i] < later
    for t in range(used):
        a, b, _ = neighbourhood(past.ways.rows, past, ranges[t], depths[t], 0.0, NEEDS[1])
        for j in range(a, b):
            there += 1
            gone += _steps_left(past, past.ways.rows[j]) < later
    return (gone + 0.5) / (there + 1.0) if later > 0 else 0.0


@inner
def novelty(raw, past, used, ranges, depths):
    """How far the agent is from past states in the leaves of the map, metres: place, and velocity over the base lag."""
    d, total = past.points.shape[1], 0.0
    ground, c, s = heading(raw, d, past.lags, past.base)
    for t in range(used):
        row, away = past.ways.rows[min(ranges[t, 0, depths[t] - 1], len(past.ways.rows) - 1)], 0.0
        for k in range(d):
            away += (raw[k] - past.points[row, k]) ** 2
        x, y = ground * c - past.going[row, 0], ground * s - past.going[row, 1]
        total += math.sqrt(away) + past.lags[past.base] * math.sqrt(x * x + y * y)
    return total / max(used, 1)


@inner
def _kind(past, strange):
    """Where a novelty stands among those known: the one before, and how far on to the next."""
    b, last = 0, len(past.unusual) - 1
    if strange >= past.unusual[last]:
        return last, 0.0
    if strange <= past.unusual[0]:
        return 0, 0.0
    while strange >= past.unusual[b + 1]:
        b += 1
    return b, (strange - past.unusual[b]) / (past.unusual[b + 1] - past.unusual[b])


@inner
def doubt(past, strange):
    """How likely it is, by novelty alone, that an agent goes none of the ways known."""
    b, p = _kind(past, strange)
    return past.doubts[b] + p * (past.doubts[min(b + 1, len(past.doubts) - 1)] - past.doubts[b])


@inner
def shares_at(past, strange, seconds, out):
    """Shares ``out`` (7,) of the members, between those known for a novelty and a horizon (in its logarithm).

    Beyond the novelties known the last member, which takes no notice of the place, takes over.
    """
    b, p = _kind(past, strange)
    h, q, last = 0, 0.0, len(past.horizons) - 1
    if seconds >= past.horizons[last]:
        h = last
    elif seconds > past.horizons[0]:
        while seconds >= past.horizons[h + 1]:
            h += 1
        q = math.log(seconds / past.horizons[h]) / math.log(past.horizons[h + 1] / past.horizons[h])
    above, later = min(b + 1, len(past.unusual) - 1), min(h + 1, len(past.horizons) - 1)
    for m in range(MEMBERS):
        near = past.shares[b, h, m] + q * (past.shares[b, later, m] - past.shares[b, h, m])
        far = past.shares[above, h, m] + q * (past.shares[above, later, m] - past.shares[above, h, m])
        out[m] = near + p * (far - near)
    most = past.unusual[len(past.unusual) - 1]
    if most > 0.0 and strange > most:
        beyond = min((strange / most - 1.0) / (FAR - 1.0), 1.0)
        for m in range(MEMBERS):
            out[m] *= 1.0 - beyond
        out[MEMBERS - 1] += beyond


@inner
def rounded(shares, n, counts):
    """Whole numbers ``counts`` of sum n in proportion to shares of sum 1, each within 1 of it."""
    total, done = 0.0, 0
    for m in range(len(shares)):
        total += shares[m]
        upto = n if m == len(shares) - 1 else min(int(total * n + 0.5), n)
        counts[m] = upto - done
        done = upto


@inner
def track_masses(past, used, ranges, depths, masses, reports, factors, mass):
    """Add the members of the map to the mass ``mass`` (M,) of leaf ranks, by their shares ``masses``."""
    for m in range(MAP):
        if masses[m] <= 0.0:
            continue
        for t in range(used):
            a, b, _ = neighbourhood(past.ways.rows, past, ranges[t], depths[t], 0.0, NEEDS[m])
            each = masses[m] / (used * (b - a))
            for i in range(a, b):
                row = past.ways.rows[i]
                mass[past.rank[past.track[row]]] += each * _told(past, row, reports, factors)


@inner
def log_density(points, first, last, at, floor):
    """Log-density at ``at`` (d,) of Gaussians about the points first..last, as wide as these are spread, and ``floor``.

    The width is Silverman's for the median distance from the mean.
    """
    d, n = len(at), last - first
    centre, away = np.zeros(d), np.empty(n)
    for k in range(d):
        for i in range(first, last):
            centre[k] += points[i, k] / n
    for i in range(n):
        total = 0.0
        for k in range(d):
            total += (points[first + i, k] - centre[k]) ** 2
        away[i] = math.sqrt(total)
    width2 = (0.8 * np.sort(away)[n // 2] * n ** (-1.0 / (d + 4.0))) ** 2 + floor * floor
    most, total = -math.inf, 0.0
    for i in range(n):
        off = 0.0
        for k in range(d):
            off += (points[first + i, k] - at[k]) ** 2
        away[i] = -0.5 * off / width2
        most = max(most, away[i])
    for i in range(n):
        total += math.exp(away[i] - most)
    return most + math.log(total / n) - 0.5 * d * math.log(2.0 * math.pi * width2)


@inner
def foretold(raw, past, used, ranges, depths, strange, seconds, at, floor, dice, draws):
    """Log-densities of a position ``at`` (dim,) ``seconds`` ahead: by the members that know ways, and by the last."""
    shares, counts = np.empty(MEMBERS), np.empty(MEMBERS, dtype=np.int64)
    none, no = np.empty((0, 2), dtype=np.int64), np.empty(0)
    shares_at(past, strange, seconds, shares)
    total = 1.0 - shares[MEMBERS - 1]
    if not total > 1e-6:
        shares[MEMBERS - 2] = total = 1.0
    shares[MEMBERS - 1] = 0.0
    for m in range(MEMBERS):
        shares[m] /= total
    rounded(shares, draws, counts)
    counts[MEMBERS - 1] += draws
    rows, out = np.empty(2 * draws, dtype=np.int64), np.empty((2 * draws, past.points.shape[1]))
    members(raw, past, used, ranges, depths, seconds, counts, none, no, dice, rows, out)
    return log_density(out, 0, draws, at, floor), log_density(out, draws, 2 * draws, at, floor)
