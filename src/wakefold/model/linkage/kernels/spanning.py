"""Which pairs of tracks can matter for the minimum spanning tree: pairs of boxes of tracks, and a growing forest."""

from __future__ import annotations

# The first parameter of an intrinsic is numba's typing context, which the caller does not give.
# pyright: reportCallIssue=false
import numpy as np

from wakefold.base.compile import inner, kernel, ordered_kernel
from wakefold.model.kernels.simd import fill, higher, load, magnitude, minus, plus, store, times, within
from wakefold.model.linkage.kernels.dendrogram import find, largest
from wakefold.model.linkage.kernels.search import gap_squared


@kernel
def grow_forest(first, second, heights, taken, order, gaps):
    """Kruskal's algorithm over edges by rising height, and the dendrogram of the forest it finds.

    Args:
        first, second: ``(n,)`` tracks of each edge.
        heights: ``(n,)`` rising.
        taken: ``(n,)`` bool, set where an edge joins two parts.
        order: ``(M,)`` tracks such that each part at each height is a range.
        gaps: ``(M - 1,)`` height that joins neighbours of ``order``, inf between trees.
    """
    tracks = len(order)
    root, head = np.empty(tracks, np.int64), np.empty(tracks, np.int64)
    tail, after = np.empty(tracks, np.int64), np.empty(tracks, np.int64)
    above = np.empty(tracks)
    for x in range(tracks):
        root[x] = head[x] = tail[x] = x
        after[x], above[x] = -1, np.inf
    for k in range(len(first)):
        a, b = find(root, first[k]), find(root, second[k])
        taken[k] = a != b
        if a != b:
            after[tail[a]], above[tail[a]] = head[b], heights[k]
            root[b], tail[a] = a, tail[b]
    rank = 0
    for x in range(tracks):
        if root[x] == x:
            y = head[x]
            while y >= 0:
                order[rank] = y
                if rank < tracks - 1:
                    gaps[rank] = above[y]
                y = after[y]
                rank += 1


@kernel
def useful_pairs(first, second, bound, start, rank, maxima, out):
    """The next pairs that could improve a forest: it does not join them at or below the bound of their distance.

    Args:
        first, second, bound: ``(n,)`` pairs of tracks.
        start: the pair to begin with.
        rank: ``(M,)`` of each track in the order of the forest.
        maxima: range maxima of its gaps, see ``wakefold.model.linkage.dendrogram.range_maxima``.
        out: room for the indices of the pairs.

    Returns:
        the pair to go on with, n when all have been looked at, and the number of pairs written.
    """
    count = 0
    while start < len(first) and count < len(out):
        i, j = rank[first[start]], rank[second[start]]
        if largest(maxima, min(i, j), max(i, j)) > bound[start]:
            out[count] = start
            count += 1
        start += 1
    return start, count


@inner
def gaps_squared(features, a, lanes, leaf, d):
    """``gap_squared`` of one track and the tracks of a leaf box, one in every lane."""
    first = leaf * features.shape[1]
    zero = fill(lanes, np.float32(0.0))
    worst = zero
    for end in range(0, 2 * d, d):
        total = zero
        for k in range(end, end + d):
            g = minus(fill(lanes, features[a, k]), load(lanes, first + k))
            total = plus(total, times(g, g))
        worst = higher(worst, total)
    widest = zero
    for k in range(2 * d, features.shape[1]):
        widest = higher(widest, magnitude(minus(fill(lanes, features[a, k]), load(lanes, first + k))))
    return higher(worst, times(widest, widest))


@ordered_kernel
def close_pairs(boxes, parts, d, done, limit, stack, top, found):
    """Pairs of tracks of different parts with ``done <= bound < limit``, as many as there is room for.

    Args:
        boxes: features ``(M, F)`` of the tracks in box order, see ``wakefold.model.linkage.bounds``; the same, flat:
            for each leaf box and feature one vector with a track in every lane, inf where none is; tracks of the leaf
            boxes; lower and upper corners ``(B, F)`` of all boxes.
        parts: labels of the tracks ``(M,)`` and of all boxes.
        d: coordinates of a point.
        done, limit: squares of lower bounds.
        stack: ``(n, 2)`` pairs of boxes; ``stack[:top]`` are still to be looked at.
        found: room for the first and the second of the pairs and the squares of their bounds.

    Returns:
        the new top of the stack, 0 when nothing is left to look at, and the number of pairs written.
    """
    (features, lanes, bounds, low, high), (part, box_part), (first, second, bound) = boxes, parts, found
    leaves = len(bounds) - 1
    inner = leaves - 1
    count = 0
    least, most, squares = fill(lanes, done), fill(lanes, limit), np.empty(64, np.float32)
    while top > 0:
        n, m = stack[top - 1]
        skip = box_part[n] >= 0 and box_part[n] == box_part[m]
        if skip or (n != m and gap_squared(low, high, n, low, high, m, d, limit) >= limit):
            top -= 1
        elif n >= inner and m >= inner:
            start, stop = bounds[m - inner], bounds[m - inner + 1]
            if count + (stop - start) * (bounds[n - inner + 1] - bounds[n - inner]) > len(first):
                return top, count
            top -= 1
            for a in range(bounds[n - inner], bounds[n - inner + 1]):
                square = gaps_squared(features, a, lanes, m - inner, d)
                close = within(square, least, most)
                if n == m:  # the tracks after this one only
                    close = close >> (a - start + 1) << (a - start + 1)
                if close == 0:
                    continue
                store(squares, 0, square)
                for lane in range(stop - start):
                    if close >> lane & 1 and part[a] != part[start + lane]:
                        first[count], second[count], bound[count] = a, start + lane, squares[lane]
                        count += 1
        elif n == m:
            left, right = 2 * n + 1, 2 * n + 2
            stack[top - 1, 0], stack[top - 1, 1] = left, left
            stack[top, 0], stack[top, 1] = left, right
            stack[top + 1, 0], stack[top + 1, 1] = right, right
            top += 2
        else:
            wide, other = min(n, m), max(n, m)  # a smaller number lies higher, so it is split first
            stack[top - 1, 0], stack[top - 1, 1] = 2 * wide + 1, other
            stack[top, 0], stack[top, 1] = 2 * wide + 2, other
            top += 1
    return 0, count
