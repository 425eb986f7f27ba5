"""How much the members of a pool are worth, by what they foretell of states that they do not know."""

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.model.kernels.forest import DEEPEST
from wakefold.model.kernels.recall import (
    MAP,
    MEMBERS,
    NEEDS,
    foretold,
    members,
    neighbourhood,
    novelty,
    ways_down,
)

KNOWN = 2  # the horizon at which it is asked whether an agent goes a known way


@kernel
def held_out(
    raw, x_map, x_own, past, track, moved_to, alive, use_map, use_own, draws, floor, near, cross, strange, known, plain
):
    """How well each member foretells states it does not know of, and how alike the members are.

    Args:
        raw, x_map, x_own: (n, .) states asked about. track: (n,) kept in no tree that is asked.
        moved_to: (n, H, d) true displacements at ``past.horizons``. alive: (n, H) whether they are known.
        use_map, use_own: (n, t) trees to be asked of each, filled up with -1.
        near: (n, H, 7) mean distance of each member's positions from the truth.
        cross: (n, H, 7, 7) mean distance between positions of two members.
        floor: metres; width that densities have at least.
        strange: (n,) novelty. known, plain: (n,) log-densities of the truth at the horizon ``KNOWN``, see ``foretold``.
    """
    d, none, no = past.points.shape[1], np.empty((0, 2), dtype=np.int64), np.empty(0)
    trees = use_map.shape[1] + use_own.shape[1]
    ranges, depths = np.empty((trees, 2, DEEPEST + 2), dtype=np.int64), np.empty(trees, dtype=np.int64)
    counts, rows = np.full(MEMBERS, draws), np.empty(MEMBERS * draws, dtype=np.int64)
    out = np.empty((MEMBERS * draws, d))
    for i in range(len(raw)):
        of_map, of_own = use_map[i][use_map[i] >= 0], use_own[i][use_own[i] >= 0]
        used = len(of_map)
        ways_down(x_map[i], x_own[i], past, of_map, of_own, ranges, depths)
        there = depths[: used + len(of_own)]
        strange[i] = novelty(raw[i], past, used, ranges, there)
        dice = np.array([np.uint64(i + 1) * np.uint64(0x9E3779B97F4A7C15)])
        for h in range(len(past.horizons)):
            if not alive[i, h]:
                continue
            members(
                raw[i], past, used, ranges[: len(there)], there, past.horizons[h], counts, none, no, dice, rows, out
            )
            _distances(out, raw[i], moved_to[i, h], draws, near[i, h], cross[i, h])
        if alive[i, KNOWN]:
            at, room = (raw[i, :d] + moved_to[i, KNOWN])[: past.dim], ranges[: len(there)]
            known[i], plain[i] = foretold(
                raw[i], past, used, room, there, strange[i], past.horizons[KNOWN], at, floor, dice, draws
            )


@inner
def _distances(points, raw, moved_to, draws, near, cross):
    d = points.shape[1]
    for m in range(MEMBERS):
        total = 0.0
        for i in range(m * draws, (m + 1) * draws):
            away = 0.0
            for k in range(d):
                away += (points[i, k] - raw[k] - moved_to[k]) ** 2
            total += math.sqrt(away)
        near[m] = total / draws
        for o in range(m + 1):
            total = 0.0
            for i in range(m * draws, (m + 1) * draws):
                for j in range(o * draws, (o + 1) * draws):
                    away = 0.0
                    for k in range(d):
                        away += (points[i, k] - points[j, k]) ** 2
                    total += math.sqrt(away)
            pairs = draws * (draws - 1) if o == m else draws * draws  # the fair score leaves a draw out against itself
            cross[m, o] = cross[o, m] = total / pairs


@kernel
def best_shares(near, cross, out):
    """Shares ``out`` (m,) of sum 1 of members in a pool of least energy score: near . out - out cross out / 2.

    Weight goes from the worst member that has some to the best, as much as lowers the score most.
    """
    m = len(near)
    slope = np.empty(m)
    for _ in range(2000):
        best, worst, most = 0, -1, 0.0
        for i in range(m):
            slope[i] = near[i]
            for j in range(m):
                slope[i] -= cross[i, j] * out[j]
            most = max(most, abs(slope[i]))
            if slope[i] < slope[best]:
                best = i
        for i in range(m):
            if out[i] > 0.0 and (worst < 0 or slope[i] > slope[worst]):
                worst = i
        gain = slope[worst] - slope[best]
        if not gain > 1e-9 * most:
            break
        bend = 2.0 * cross[best, worst] - cross[best, best] - cross[worst, worst]
        part = min(gain / bend, out[worst]) if bend > 0.0 else out[worst]
        out[best] += part
        out[worst] -= part


@kernel
def class_shares(raw, x_map, past, use_map, lo, hi, fallback, out):
    """Masses ``out`` (n, L, 4) that the members of the map, and no knowledge, give to true classes.

    Args:
        use_map: as in ``held_out``. lo, hi: (n, L) intervals of leaf ranks.
        fallback: (n, L) mass without knowledge.
    """
    trees = use_map.shape[1]
    ranges, depths = np.empty((trees, 2, DEEPEST + 2), dtype=np.int64), np.empty(trees, dtype=np.int64)
    for i in range(len(raw)):
        of_map = use_map[i][use_map[i] >= 0]
        used = len(of_map)
        ways_down(x_map[i], x_map[i], past, of_map, of_map[:0], ranges, depths)
        for level in range(lo.shape[1]):
            out[i, level, MAP] = fallback[i, level]
            for m in range(MAP):
                total = 0.0
                for t in range(used):
                    a, b, _ = neighbourhood(past.ways.rows, past, ranges[t], depths[t], 0.0, NEEDS[m])
                    inside = 0
                    for j in range(a, b):
                        rank = past.rank[past.track[past.ways.rows[j]]]
                        inside += lo[i, level] <= rank < hi[i, level]
                    total += inside / (b - a)
                out[i, level, m] = total / max(used, 1)
