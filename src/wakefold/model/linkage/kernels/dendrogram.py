"""Dendrograms in loops: merges to leaf order, gaps to classes."""

from __future__ import annotations

import numpy as np

from wakefold.base.compile import inner, kernel


@inner
def find(root, x):
    """Representative of the set of x; halves the path to it."""
    while root[x] != x:
        root[x] = root[root[x]]
        x = root[x]
    return x


@inner
def largest(maxima, i, j):
    """``max(gaps[i:j])`` from the table of ``wakefold.model.linkage.dendrogram.range_maxima``, 0 where i = j."""
    if i == j:
        return 0.0
    k = 0
    while 2 << k <= j - i:
        k += 1
    return max(maxima[k, i], maxima[k, j - (1 << k)])


@kernel
def joined_at(lo, hi, maxima, a, b, out):
    """Birth of the youngest common ancestor of classes a and b, 0 for a class and itself, into ``out``, all (n,).

    It is the largest gap of the range that spans both. False, and no more is written, at a number that is no class.

    Args:
        lo, hi: (C,) ranks of each class.
        maxima: see ``largest``.
    """
    for i in range(len(a)):
        if not (0 <= a[i] < len(lo) and 0 <= b[i] < len(lo)):
            return False
        first, last = min(lo[a[i]], lo[b[i]]), max(hi[a[i]], hi[b[i]]) - 1
        out[i] = 0.0 if a[i] == b[i] else largest(maxima, first, last)
    return True


@kernel
def climb(classes, parent, death, level, out):
    """The class alive at a level that holds each of ``classes``, none of them born after it, into ``out``, all (n,)."""
    for i in range(len(classes)):
        c = classes[i]
        if i > 0 and c == classes[i - 1]:  # resampling leaves runs of one class
            out[i] = out[i - 1]
            continue
        while death[c] <= level:
            c = parent[c]
        out[i] = c


@kernel
def name_merges(edges, heights, winner, loser):
    """The clusters that merges join, each named by its smallest track.

    Args:
        edges: ``(M - 1, 2)`` a track of each of the two clusters merged.
        heights: ``(M - 1,)`` rising.
        winner, loser: ``(M - 1,)`` written: the cluster of ``loser`` becomes part of that of ``winner`` at this height.
            Each track but the first loses once.
    """
    root, start = np.empty(len(edges) + 1, np.int64), 0
    for track in range(len(root)):
        root[track] = track
    for k in range(len(edges)):
        a, b = find(root, edges[k, 0]), find(root, edges[k, 1])
        root[max(a, b)] = min(a, b)
        loser[k] = max(a, b)
        if k + 1 == len(edges) or heights[k + 1] > heights[k]:
            for tied in range(start, k + 1):
                winner[tied] = find(root, loser[tied])
            start = k + 1


@kernel
def chain(winner, loser, heights, order, gaps):
    """Append the cluster of each loser to that of its winner, in the sequence given.

    Args:
        winner, loser, heights: ``(M - 1,)`` see ``name_merges``.
        order, gaps: ``(M,)``, ``(M - 1,)`` written: the tracks, and the height that joins each to the one before.
    """
    tail, after, above = np.empty(len(order), np.int64), np.empty(len(order), np.int64), np.empty(len(order))
    for track in range(len(order)):
        tail[track], after[track] = track, -1
    for k in range(len(winner)):
        last = tail[winner[k]]
        after[last], above[last], tail[winner[k]] = loser[k], heights[k], tail[loser[k]]
    track = 0
    for rank in range(len(gaps)):
        order[rank], gaps[rank] = track, above[track]
        track = after[track]
    order[len(gaps)] = track


@kernel
def nest(gaps, lo, hi, birth, parent):
    """Classes of a dendrogram: the leaves by rank, then the merged ones as they are met from left to right.

    Args:
        gaps: ``(M - 1,)`` heights between neighbouring leaves.
        lo, hi, birth, parent: ``(2 M - 1,)``, written.

    Returns:
        number of classes.
    """
    tracks = len(gaps) + 1
    for r in range(tracks):
        lo[r], hi[r], birth[r], parent[r] = r, r + 1, 0.0, -1
    stack, top, count = np.empty(tracks, np.int64), 0, tracks  # classes still open, births falling
    for r in range(tracks):
        gap = gaps[r] if r < tracks - 1 else np.inf
        node = r
        while top > 0 and birth[stack[top - 1]] < gap:
            top -= 1
            parent[node] = stack[top]
            node = stack[top]
            hi[node] = r + 1
        if r < tracks - 1:
            if top == 0 or birth[stack[top - 1]] > gap:
                lo[count], birth[count], parent[count] = lo[node], gap, -1
                stack[top] = count
                top += 1
                count += 1
            parent[node] = stack[top - 1]
    return count
