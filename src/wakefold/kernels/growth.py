"""Edges by which new tracks could join a spanning tree."""

from __future__ import annotations

import numpy as np

from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.dendrogram import largest
from wakefold.kernels.frechet import track_against_tracks
from wakefold.kernels.search import gap_squared


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
    unit, margin = scale
    return ((max(way, largest(maxima, min(entry, first), max(entry, last))) + margin) / unit) ** 2


@kernel
def edges_to(start, stop, points, offsets, features, entries, others, other_offsets, boxes, tree, scale, axes):
    """Edges of some tracks that could be part of a minimum spanning tree, given a tree of those they are to join.

    An edge is of no use if the tracks at its ends are joined by a way no longer than its lower bound: over the entry,
    which is the nearest track met so far, and on through the tree.

    Args:
        start, stop: the tracks that ask.
        points, offsets, features: ragged tracks, and their features ``(K, F)``.
        entries: ``(K,)`` ranks of the tracks that ask if they are in the tree and in the boxes, otherwise -1. Of two
            tracks in the boxes, the first one asks.
        others, other_offsets: ragged tracks in the boxes.
        boxes: their order, features, bounds, low, high: see ``wakefold.features.Boxes``.
        tree: ranks of the others in box order, least and largest rank in each box, range maxima of the gaps.
        scale: (unit of the features, margin of the bounds), metres.
        axes: tuple of d integers.

    Returns:
        ``(E, 2)`` track that asks, other; ``(E,)`` distances, metres.
    """
    order, boxed, bounds, low, high = boxes
    rank, first, last, maxima = tree
    inner, d = len(bounds) - 2, len(axes)
    pairs, heights, count = np.empty((1024, 2), np.int64), np.empty(1024), 0
    stack, gaps = np.empty(64, np.int64), np.empty(64, np.float32)
    fullest = 0
    for leaf in range(inner + 1):
        fullest = max(fullest, bounds[leaf + 1] - bounds[leaf])
    places, found = np.empty(fullest, np.int64), np.empty(fullest)
    for x in range(start, stop):
        entry, way = entries[x], 0.0 if entries[x] >= 0 else np.inf
        stack[0], gaps[0], top = 0, 0.0, 1
        while top > 0:
            top -= 1
            n = stack[top]
            limit = limit_by(way, entry, first[n], last[n], maxima, scale)
            if gaps[top] >= limit:
                continue
            if n < inner:
                left = gap_squared(features, x, low, high, 2 * n + 1, d, limit)
                right = gap_squared(features, x, low, high, 2 * n + 2, d, limit)
                nearer = 1 if left <= right else 0  # of the two, on top
                stack[top + 1 - nearer], gaps[top + 1 - nearer] = 2 * n + 2, right
                stack[top + nearer], gaps[top + nearer] = 2 * n + 1, left
                top += 2
                continue
            m = 0
            for y in range(bounds[n - inner], bounds[n - inner + 1]):
                limit = limit_by(way, entry, rank[y], rank[y], maxima, scale)
                asked_by_other = entries[x] >= 0 and order[y] <= x
                if not asked_by_other and gap_squared(features, x, boxed, boxed, y, d, limit) < limit:
                    places[m] = y
                    m += 1
            if m == 0:
                continue
            track = points[offsets[x] : offsets[x + 1]]
            track_against_tracks(track, others, other_offsets, order[places[:m]], axes, found)
            for k in range(m):
                if count == len(heights):
                    pairs, heights = np.concatenate((pairs, pairs)), np.concatenate((heights, heights))
                pairs[count, 0], pairs[count, 1], heights[count] = x, order[places[k]], found[k]
                count += 1
                if found[k] < way:
                    entry, way = rank[places[k]], found[k]
    return pairs[:count], heights[:count]
