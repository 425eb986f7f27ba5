"""Edges by which new tracks could join a spanning tree."""

from __future__ import annotations

# The first parameter of an intrinsic is numba's typing context, which the caller does not give.
# pyright: reportCallIssue=false
import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.model.kernels.simd import LANES, store
from wakefold.model.linkage.kernels.dendrogram import largest
from wakefold.model.linkage.kernels.frechet import track_against_tracks
from wakefold.model.linkage.kernels.search import gap_squared
from wakefold.model.linkage.kernels.spanning import gaps_squared

LANES32 = LANES["float32"]


@inner
def limit_of(length, scale):
    """Squared lower bound, in units, from which on a distance is at least a length."""
    unit, margin = scale
    return ((length + margin) / unit) ** 2


@inner
def limit_by(way, entry, first, last, maxima, scale):
    """Squared bound from which on an edge is of no use, in units: a way of known edges is as short.

    Args:
        way: distance to the entry, metres.
        entry: its rank in the tree, -1 if there is none yet.
        first, last: least and largest rank of the tracks at the other end of the edge.
        maxima: range maxima of the gaps of the tree.
        scale: (unit of the features, margin of the bounds), metres.
    """
    if entry < 0:
        return np.inf
    return limit_of(max(way, largest(maxima, min(entry, first), max(entry, last))), scale)


@kernel
def edges_to(asking, tracks, features, entries, others, boxes, lanes, tree, scale, axes):
    """Edges of some tracks that could be part of a minimum spanning tree, given a tree of those they are to join.

    An edge is of no use if the tracks at its ends are joined by a way no longer than its lower bound: over the entry,
    which is the nearest track met so far, and on through the tree.

    Args:
        asking: the tracks that ask; those near each other in turn find boxes and ranks in the cache.
        tracks, features: points and offsets of ragged tracks, and their features ``(K, F)``.
        entries: ``(K,)`` ranks of the tracks that ask if they are in the tree and in the boxes, otherwise -1. Of two
            tracks in the boxes, the first one asks.
        others: points and offsets of the tracks in the boxes.
        boxes: their order, bounds, low, high: see ``wakefold.model.linkage.bounds.Boxes``.
        lanes: features of the tracks in the boxes once more, see ``wakefold.model.linkage.bounds.in_lanes``.
        tree: ranks of the others in box order, least and largest rank in each box, range maxima of the gaps.
        scale: (unit of the features, margin of the bounds), metres.
        axes: tuple of d integers.

    Returns:
        ``(E, 2)`` track that asks, other; ``(E,)`` distances, metres.
    """
    (points, offsets), (other_points, other_offsets) = tracks, others
    order, bounds, low, high = boxes
    rank, first, last, maxima = tree
    inner, d = len(bounds) - 2, len(axes)
    pairs, heights, count = np.empty((1024, 2), np.int64), np.empty(1024), 0
    stack, gaps = np.empty(64, np.int64), np.empty(64, np.float32)
    squares, places, found = np.empty(LANES32, np.float32), np.empty(LANES32, np.int64), np.empty(LANES32)
    for x in asking:
        entry, way = entries[x], 0.0 if entries[x] >= 0 else np.inf
        stack[0], gaps[0], top = 0, 0.0, 1
        while top > 0:
            top -= 1
            n = stack[top]
            gap = gaps[top]  # the tree, whose table is large, is asked only where the way alone does not keep the box
            if gap >= limit_of(way, scale) and gap >= limit_by(way, entry, first[n], last[n], maxima, scale):
                continue
            if n < inner:
                left = gap_squared(features, features, x, low, high, 2 * n + 1, d, np.inf)
                right = gap_squared(features, features, x, low, high, 2 * n + 2, d, np.inf)
                nearer = 1 if left <= right else 0  # of the two, on top
                stack[top + 1 - nearer], gaps[top + 1 - nearer] = 2 * n + 2, right
                stack[top + nearer], gaps[top + nearer] = 2 * n + 1, left
                top += 2
                continue
            m, start = 0, bounds[n - inner]
            store(squares, 0, gaps_squared(features, x, lanes, n - inner, d))
            for y in range(start, bounds[n - inner + 1]):
                asked_by_other = entries[x] >= 0 and order[y] <= x
                if not asked_by_other and squares[y - start] < limit_by(way, entry, rank[y], rank[y], maxima, scale):
                    places[m] = y
                    m += 1
            if m == 0:
                continue
            track = points[offsets[x] : offsets[x + 1]]
            track_against_tracks(track, other_points, other_offsets, order[places[:m]], axes, found)
            for k in range(m):
                if count == len(heights):
                    pairs, heights = np.concatenate((pairs, pairs)), np.concatenate((heights, heights))
                pairs[count, 0], pairs[count, 1], heights[count] = x, order[places[k]], found[k]
                count += 1
                if found[k] < way:
                    entry, way = rank[places[k]], found[k]
    return pairs[:count], heights[:count]
