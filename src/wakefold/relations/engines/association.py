"""Which detection is of which object, where the sensor does not tell: the best joint assignments of small clusters."""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from wakefold.base import small
from wakefold.base.types import Floats, Ints
from wakefold.relations.detections import Detections

if TYPE_CHECKING:
    from wakefold.relations.engines.objects import Objects


GATE = 5.0  # sd: detections farther from an object are not its
TINY = 1e-12  # in place of a density or probability of zero that is divided by


def k_best(cost: Floats, k: int) -> list[tuple[float, Ints]]:
    """The ``k`` cheapest assignments of rows to distinct columns, cheapest first (Murty 1968).

    Args:
        cost: ``(n, m)``, n <= m; infinite where a row cannot have a column.

    Returns:
        (total, column of each row); fewer than ``k`` where there are no more.
    """
    found: list[tuple[float, Ints]] = []
    heap: list[tuple[float, int, Ints, Floats, int]] = []
    count = 0

    def add(matrix: Floats, fixed: int) -> None:
        nonlocal count
        try:
            rows, columns = linear_sum_assignment(matrix)
        except ValueError:  # nothing is feasible any more
            return
        total = float(cost[rows, columns].sum())
        if math.isfinite(total):
            heapq.heappush(heap, (total, count, columns, matrix, fixed))
            count += 1

    if cost.size:
        add(cost, 0)
    else:
        return [(0.0, np.zeros(0, dtype=np.int64))]
    while heap and len(found) < k:
        total, _, columns, matrix, fixed = heapq.heappop(heap)
        found.append((total, columns.astype(np.int64)))
        for row in range(fixed, len(cost)):  # split what is left: as this one up to a row, which has another column
            split = matrix.copy()
            for done in range(row):
                kept = split[done, columns[done]]
                split[done], split[:, columns[done]] = np.inf, np.inf
                split[done, columns[done]] = kept
            split[row, columns[row]] = np.inf
            add(split, row)
    return found


def associate(objects: Objects, scan: Detections, chance: Floats, hypotheses: int) -> tuple[Ints, Ints, Floats]:
    """The detection of each object in the best joint assignment of its cluster, and the existence of each object.

    An object and a detection within 5 standard deviations may belong together; what hangs together so is a cluster.
    Within it the ``hypotheses`` best assignments are weighed: an object is detected with its probability ``chance``
    or missed, a detection without an object is clutter or a new object.

    Returns:
        ``(n,)`` detection of each object, -1 for none; detections of new objects; ``(n,)`` existence.
    """
    n, m, d = len(objects.ids), len(scan), scan.positions.shape[1]
    found = np.full(n, -1, dtype=np.int64)
    existence = objects.existence
    missed = np.maximum(1.0 - existence * chance, TINY)
    after = np.where(existence > 0, existence * (1.0 - chance) / missed, 0.0)  # of an object that is missed
    if n == 0 or m == 0:
        return found, np.arange(m), after
    i, j, square, s = _within(objects, scan)
    away = max(scan.clutter + scan.birth, TINY)
    gain = small.log(existence * chance / (missed * away))[i] - 0.5 * (square + d * small.log(2.0 * np.pi * s))
    possible = gain > -np.inf
    i, j, gain = i[possible], j[possible], gain[possible]
    graph = coo_array((np.ones(len(i)), (i, n + j)), shape=(n + m, n + m))
    _, label = connected_components(graph, directed=False)
    order = np.argsort(label[i], kind="stable")
    cuts = np.flatnonzero(np.diff(label[i][order])) + 1
    out = after.copy()
    for part in np.split(order, cuts) if len(order) else []:
        rows, row = np.unique(i[part], return_inverse=True)
        columns, column = np.unique(j[part], return_inverse=True)
        cost = np.full((len(rows), len(columns) + len(rows)), np.inf)
        cost[row, column] = -gain[part]
        cost[np.arange(len(rows)), len(columns) + np.arange(len(rows))] = 0.0
        best = k_best(cost, 1 if len(rows) == 1 and len(columns) == 1 else hypotheses)
        if len(rows) == 1 and len(columns) == 1:
            best = sorted([(float(cost[0, 0]), np.array([0])), (0.0, np.array([1]))], key=lambda h: h[0])
        totals = np.array([total for total, _ in best])
        weights = small.exp(totals[0] - totals)
        weights /= weights.sum()
        taken = np.array([c < len(columns) for _, c in best])  # (hypotheses, objects)
        detected = (weights[:, None] * taken).sum(axis=0)
        out[rows] = detected + (1.0 - detected) * after[rows]
        first = best[0][1]
        found[rows] = np.where(first < len(columns), columns[np.minimum(first, len(columns) - 1)], -1)
    fresh = np.setdiff1d(np.arange(m), found[found >= 0])
    return found, fresh, out


def _within(objects: Objects, scan: Detections) -> tuple[Ints, Ints, Floats, Floats]:
    """Objects and detections within ``GATE``: places of both, squared distance in variances, variance per axis."""
    reach = GATE * np.sqrt(objects.cov[:, 0].max() + (scan.sd**2).max())
    lists = KDTree(scan.positions).query_ball_point(objects.mean[:, 0], reach)
    i = np.repeat(np.arange(len(lists)), [len(found) for found in lists])
    j = np.fromiter((x for found in lists for x in found), dtype=np.int64, count=len(i))
    s = objects.cov[i, 0] + scan.sd[j] ** 2
    square = ((scan.positions[j] - objects.mean[i, 0]) ** 2).sum(axis=1) / s
    near = square <= GATE**2
    return i[near], j[near], square[near], s[near]
