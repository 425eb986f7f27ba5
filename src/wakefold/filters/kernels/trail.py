"""Trails of agents in columns: a fix put in its place, and what the memory says of where a trail leads."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.compile import inner, kernel
from wakefold.base.types import Floats, Ints
from wakefold.model.kernels.forest import DEEPEST
from wakefold.model.kernels.recall import (
    MEMBERS,
    doubt,
    finished,
    foretold,
    members,
    novelty,
    rounded,
    shares_at,
    track_masses,
    ways_down,
)
from wakefold.model.kernels.states import features, state, steps

LOST = 6.0  # sd that a fix may be off
DRAWS = 40  # positions that a fix is looked for among
MOST = 30.0  # odds that the fixes before can speak for or against any way known
SLOTS, REPORTS = 20, 4  # fixes and reports that a trail keeps


class Trails(NamedTuple):
    """What is known of A agents, in columns.

    Attributes:
        times: ``(A, SLOTS)`` of the fixes kept, rising: the first there was, and others at about even ratios of their
            age. points: ``(A, SLOTS, d)`` metres. fixes: ``(A,)`` how many are kept.
        clock: ``(A,)`` seconds, of the last step. sd: ``(A,)`` of the last fix, metres per axis.
        reports: ``(A, REPORTS, 2)`` intervals of leaf ranks, the newest last. odds: ``(A, REPORTS)`` of a past state
            outside against one inside. told: ``(A,)`` how many there are.
        key: ``(A, 2)`` of random streams. step: ``(A,)`` number of steps taken.
        who: ``(A,)`` number of the agent among those of the memory, see ``Memory.who``.
    """

    times: Floats
    points: Floats
    fixes: Ints
    clock: Floats
    sd: Floats
    reports: Ints
    odds: Floats
    told: Ints
    key: NDArray[np.uint64]
    step: Ints
    who: Floats


@inner
def _put(times, points, count, at, position):
    """Put a fix in its place among ``count`` kept; how many there are then."""
    where = count
    while where > 0 and times[where - 1] >= at:
        where -= 1
    d = points.shape[1]
    if where < count and times[where] == at:  # what is said last of a moment holds
        for k in range(d):
            points[where, k] = position[k]
        return count
    if count == len(times):
        # the one is left out whose neighbours are closest together, for how long ago it was
        now, least, out = max(times[count - 1], at), math.inf, 1
        for i in range(1, count - 1):
            gap = (times[i + 1] - times[i - 1]) / (now - times[i])
            if gap < least:
                least, out = gap, i
        count -= 1
        for i in range(out, count):
            times[i] = times[i + 1]
            for k in range(d):
                points[i, k] = points[i + 1, k]
        if where > out:
            where -= 1
    for i in range(count, where, -1):
        times[i] = times[i - 1]
        for k in range(d):
            points[i, k] = points[i - 1, k]
    times[where] = at
    for k in range(d):
        points[where, k] = position[k]
    return count + 1


@inner
def put_one(trails, r, at, position, sd, fastest):
    """Put a fix (d,) of a time into its place in a trail; whether it began a new one.

    So it does if it takes more than ``fastest`` m/s to get to, beyond its error.
    """
    n, far = trails.fixes[r], False
    newest = n == 0 or at >= trails.times[r, n - 1]
    if n and newest:
        away = 0.0
        for k in range(len(position)):
            away += (position[k] - trails.points[r, n - 1, k]) ** 2
        far = math.sqrt(away) > fastest * (at - trails.times[r, n - 1]) + LOST * (sd + trails.sd[r])
        if far:
            n = 0
    trails.fixes[r] = _put(trails.times[r], trails.points[r], n, at, position)
    if newest:
        trails.sd[r] = sd
    return far


@kernel
def put(trails, r, at, position, sd, fastest):
    """``put_one`` for Python."""
    return put_one(trails, r, at, position, sd, fastest)


@inner
def add_report(trails, r, lo, hi, odds):
    """Add a report of the leaf ranks lo..hi to a trail; of too many the oldest goes."""
    n = trails.told[r]
    if n == REPORTS:
        for j in range(n - 1):
            trails.reports[r, j] = trails.reports[r, j + 1]
            trails.odds[r, j] = trails.odds[r, j + 1]
        n -= 1
    trails.reports[r, n, 0], trails.reports[r, n, 1], trails.odds[r, n] = lo, hi, odds
    trails.told[r] = n + 1


@kernel
def report(trails, r, lo, hi, odds):
    """``add_report`` for Python."""
    add_report(trails, r, lo, hi, odds)


class Room(NamedTuple):
    """Where the way of one agent down the forests is worked out."""

    raw: Floats
    to_map: NDArray[np.float32]
    to_own: NDArray[np.float32]
    use_map: Ints
    use_own: Ints
    ranges: Ints
    depths: Ints


@inner
def _room(past):
    d, lags = past.points.shape[1], len(past.lags)
    of_map, of_own = len(past.ways.first_node) - 1, len(past.own.first_node) - 1
    count = 2 * d + 9 + d * lags
    return Room(
        np.empty(2 * d + 2 + d * lags),
        np.empty(count, dtype=np.float32),
        np.empty(count, dtype=np.float32),
        np.arange(of_map),
        np.arange(of_own),
        np.empty((of_map + of_own, 2, DEEPEST + 2), dtype=np.int64),
        np.empty(of_map + of_own, dtype=np.int64),
    )


@inner
def _look(times, points, who, fixes, past, room):
    """The state at the last of ``fixes`` and its ways down the forests; its novelty."""
    state(points, times, 0, fixes, times[fixes - 1], past.lags, room.raw)
    features(room.raw, who, points.shape[1], past.lags, past.base, past.slow, past.daily, room.to_map, room.to_own)
    ways_down(room.to_map, room.to_own, past, room.use_map, room.use_own, room.ranges, room.depths)
    return novelty(room.raw, past, len(room.use_map), room.ranges, room.depths)


@inner
def _dice(trails, r):
    words = trails.key[r]
    mixed = (
        words[0]
        ^ (words[1] * np.uint64(0xD6E8FEB86659FD93))
        ^ (np.uint64(trails.step[r] + 1) * np.uint64(0x9E3779B97F4A7C15))
    )
    return mixed | np.uint64(1)


@kernel
def ahead(trails, rows, past, seconds, out, taken):
    """Positions ``out`` (n, H, S, d), ``seconds`` (n, H) after the clock of each row, and the past states ``taken``."""
    room, d, samples = _room(past), past.points.shape[1], out.shape[2]
    shares, counts, dice = np.empty(MEMBERS), np.empty(MEMBERS, dtype=np.int64), np.empty(1, dtype=np.uint64)
    for i in range(len(rows)):
        r = rows[i]
        reports, odds = trails.reports[r, : trails.told[r]], trails.odds[r, : trails.told[r]]
        fixes, since, strange = trails.fixes[r], 0.0, 0.0
        if fixes:
            strange = _look(trails.times[r], trails.points[r], trails.who[r], fixes, past, room)
            since = trails.clock[r] - trails.times[r, fixes - 1]
        for h in range(seconds.shape[1]):
            dice[0] = _dice(trails, r)
            later = since + seconds[i, h]
            if fixes:
                shares_at(past, strange, later, shares)
                rounded(shares, samples, counts)
            else:  # nothing is known of where it is: as any past state
                counts[:] = 0
                counts[MEMBERS - 1] = samples
                room.raw[:] = 0.0
            members(
                room.raw, past, len(room.use_map), room.ranges, room.depths, later, counts, reports, odds, dice,
                taken[i, h], out[i, h],
            )  # fmt: skip
            if not fixes:
                for s in range(samples):
                    row = taken[i, h, s]
                    last = past.begins[past.track[row] + 1] - 1
                    there = min(row + int(steps(later, past.step) + 0.5), last)
                    for k in range(d):
                        out[i, h, s, k] = past.points[there, k]


@kernel
def ended(trails, rows, past, seconds, out):
    """Probability ``out`` (n, H) that each voyage has ended ``seconds`` (n, H) after the clock of each row."""
    room = _room(past)
    for i in range(len(rows)):
        r = rows[i]
        fixes, since = trails.fixes[r], 0.0
        if fixes:
            _look(trails.times[r], trails.points[r], trails.who[r], fixes, past, room)
            since = trails.clock[r] - trails.times[r, fixes - 1]
        for h in range(seconds.shape[1]):
            used = len(room.use_map) if fixes else 0
            out[i, h] = finished(past, used, room.ranges, room.depths, since + seconds[i, h])


@kernel
def masses(trails, rows, past, out):
    """Mass ``out`` (n, M) of each leaf rank for each row, of sum 1."""
    room, members_of_map = _room(past), len(past.masses) - 1
    for i in range(len(rows)):
        r, total = rows[i], 0.0
        reports, odds = trails.reports[r, : trails.told[r]], trails.odds[r, : trails.told[r]]
        mass = out[i]
        unknown = past.masses[members_of_map] if trails.fixes[r] else 1.0
        for rank in range(len(mass)):
            g = unknown / len(mass)
            for j in range(len(odds)):
                if not reports[j, 0] <= rank < reports[j, 1]:
                    g *= odds[j]
            mass[rank] = g
        if trails.fixes[r]:
            _look(trails.times[r], trails.points[r], trails.who[r], trails.fixes[r], past, room)
            used = len(room.use_map)
            track_masses(past, used, room.ranges, room.depths, past.masses, reports, odds, mass)
        for rank in range(len(mass)):
            total += mass[rank]
        for rank in range(len(mass)):
            mass[rank] /= total


@kernel
def none(trails, rows, past, out):
    """Probability ``out`` (n,) that the agent of each row goes none of the ways known.

    What novelty alone says, and whether the last fix was where the ways known, or where any, led to from the fix before
    it by the second lag or more.
    """
    room = _room(past)
    dice = np.empty(1, dtype=np.uint64)
    for i in range(len(rows)):
        r = rows[i]
        n = trails.fixes[r]
        if n == 0:
            out[i] = past.doubts[0]
            continue
        p = doubt(past, _look(trails.times[r], trails.points[r], trails.who[r], n, past, room))
        odds, before = p / (1.0 - p), n - 2
        while before > 0 and trails.times[r, n - 1] - trails.times[r, before] < past.lags[1]:
            before -= 1
        if before > 0:
            dice[0] = _dice(trails, r)
            ways, any_way = _gained(trails, r, before, n - 1, past, room, dice)
            odds *= min(max(math.exp(any_way - ways), 1.0 / MOST), MOST)
        out[i] = odds / (1.0 + odds)


@inner
def _gained(trails, r, before, after, past, room, dice):
    """Log-densities of a kept fix, foretold from those up to another before it; see ``foretold``."""
    strange = _look(trails.times[r], trails.points[r], trails.who[r], before + 1, past, room)
    seconds, floor = trails.times[r, after] - trails.times[r, before], trails.sd[r]
    return foretold(
        room.raw, past, len(room.use_map), room.ranges, room.depths, strange, seconds,
        trails.points[r, after, : past.dim], floor, dice, DRAWS,
    )  # fmt: skip


@kernel
def evidence(trails, rows, past, out):
    """Log-density ``out`` (n,) of the fixes that each row keeps, each foretold from those before it.

    Of the pool of ways known and of any way, by how unlikely it is that the agent goes a known one.
    """
    room = _room(past)
    dice = np.empty(1, dtype=np.uint64)
    for i in range(len(rows)):
        r, out[i] = rows[i], 0.0
        for after in range(1, trails.fixes[r]):
            dice[0] = _dice(trails, r)
            ways, any_way = _gained(trails, r, after - 1, after, past, room, dice)
            p = doubt(past, _look(trails.times[r], trails.points[r], trails.who[r], after, past, room))
            most = max(ways, any_way)
            out[i] += most + math.log((1.0 - p) * math.exp(ways - most) + p * math.exp(any_way - most))
