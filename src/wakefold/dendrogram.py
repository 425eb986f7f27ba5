"""Dendrograms as arrays: from merges to the order of the leaves, from the gaps between them to classes and levels."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


def leaf_order(edges: Ints, heights: Floats) -> tuple[Ints, Floats]:
    """Canonical dendrogram order and gaps of a sequence of merges.

    Args:
        edges: ``(M - 1, 2)`` a track of each of the two clusters merged.
        heights: ``(M - 1,)`` rising.

    A cluster is a linked list of tracks that begins with its smallest track, which also stands for it. The clusters
    joined at one height are chained by rising smallest track, so the order depends on the classes alone, not on which
    of several minimum spanning trees the edges come from.
    """
    tracks = len(edges) + 1
    root, tail, after, above = list(range(tracks)), list(range(tracks)), [-1] * tracks, [0.0] * tracks

    def find(x: int) -> int:
        while root[x] != x:
            root[x] = x = root[root[x]]
        return x

    def chain(cluster: int, other: int, height: float) -> None:
        after[tail[cluster]], above[tail[cluster]] = other, height
        root[other], tail[cluster] = cluster, tail[other]

    bounds = np.concatenate([[0], np.flatnonzero(np.diff(heights)) + 1, [len(heights)]]).tolist()
    pairs, levels = edges.tolist(), heights.tolist()
    for start, stop in pairwise(bounds):
        if stop == start + 1:
            cluster, other = sorted(map(find, pairs[start]))
            chain(cluster, other, levels[start])
            continue
        clusters = sorted({find(x) for pair in pairs[start:stop] for x in pair})
        for a, b in pairs[start:stop]:
            root[find(a)] = find(b)
        smallest: dict[int, int] = {}
        for cluster, whole in [(cluster, find(cluster)) for cluster in clusters]:
            if whole in smallest:
                chain(smallest[whole], cluster, levels[start])
            else:
                smallest[whole] = cluster
        for cluster in smallest.values():
            root[cluster] = cluster
    order = [0]
    while after[order[-1]] >= 0:
        order.append(after[order[-1]])
    ranked = np.array(order, dtype=np.int64)
    return ranked, np.array(above)[ranked[:-1]]


def classes(order: Ints, rank: Ints, gaps: Floats) -> dict[str, NDArray]:
    """``lo, hi, birth, death, parent`` of all classes, numbered as in ``Filtration``, in one pass over the gaps."""
    tracks = len(order)
    # Nodes: the leaves by rank, then merged classes as they are met. The stack holds those still open, births falling.
    lo, birth, parent, hi = list(range(tracks)), [0.0] * tracks, [-1] * tracks, list(range(1, tracks + 1))
    stack: list[int] = []
    for r, gap in enumerate([*gaps.tolist(), np.inf]):
        node = r
        while stack and birth[stack[-1]] < gap:
            child, node = node, stack.pop()
            parent[child], hi[node] = node, r + 1
        if r == tracks - 1:
            break
        if not (stack and birth[stack[-1]] == gap):
            stack.append(len(lo))
            lo.append(lo[node])
            hi.append(0)
            birth.append(gap)
            parent.append(-1)
        parent[node] = stack[-1]
    low, high, born, above = np.array(lo), np.array(hi), np.array(birth), np.array(parent, dtype=np.int64)
    node_of = np.concatenate([rank, tracks + np.lexsort((low[tracks:], born[tracks:]))])
    class_of = np.empty(len(node_of), dtype=np.int64)
    class_of[node_of] = np.arange(len(node_of))
    above = above[node_of]
    parents = np.where(above >= 0, class_of[above], -1)
    births = born[node_of]
    deaths = np.where(parents >= 0, births[parents], np.inf)
    return {"lo": low[node_of], "hi": high[node_of], "birth": births, "death": deaths, "parent": parents}


def range_maxima(gaps: Floats) -> Floats:
    """Sparse table ``(log2 M, M - 1)`` for ``largest_between``: row k holds the maxima of 2^k neighbouring gaps."""
    rows = [gaps if len(gaps) else np.zeros(1)]
    while 1 << len(rows) <= len(gaps):
        half = 1 << (len(rows) - 1)
        row = rows[-1].copy()
        row[:-half] = np.maximum(row[:-half], rows[-1][half:])
        rows.append(row)
    return np.stack(rows)


def largest_between(maxima: Floats, i: Ints, j: Ints) -> Floats:
    """``max(gaps[i:j])``, elementwise, from the table of ``range_maxima``; 0 where i = j."""
    k = np.maximum(np.frexp(j - i)[1] - 1, 0)  # floor of the logarithm to base 2
    last = np.maximum(j - (1 << k), 0)
    return np.where(i < j, np.maximum(maxima[k, np.minimum(i, maxima.shape[1] - 1)], maxima[k, last]), 0.0)


def entropy_by_height(size: Ints, birth: Floats, parent: Ints) -> tuple[Floats, Floats]:
    """Heights at which the partition changes, 0 first, and the entropy of the class of a random track from there on.

    Args:
        size, birth, parent: ``(C,)`` of each class, numbered as in ``Filtration``.
    """
    tracks = int(size[-1])
    share = size / tracks
    part = -share * np.log(share)  # what a class adds to the entropy of its level
    fall = np.bincount(parent[:-1], weights=part[:-1], minlength=len(size)) - part  # at the birth of a merged class
    heights, group = np.unique(np.append(0.0, birth[tracks:]), return_inverse=True)
    falls = np.bincount(group, weights=np.append(0.0, fall[tracks:]))
    return heights, np.log(tracks) - np.cumsum(falls)


def levels_by_entropy(size: Ints, birth: Floats, parent: Ints, number: int) -> Floats:
    """At most ``number`` heights between single tracks and the root, nearest to equal steps of entropy."""
    heights, entropy = entropy_by_height(size, birth, parent)
    between = slice(1, -1) if len(heights) > 2 else slice(0, 1)
    heights, entropy = heights[between], entropy[between]
    targets = np.log(size[-1]) * np.arange(number, 0, -1) / (number + 1)
    return np.unique(heights[np.abs(entropy[:, None] - targets).argmin(axis=0)])


def levels_by_persistence(birth: Floats, death: Floats, persistence: float) -> Floats:
    """The fewest births such that each class with ``death - birth >= persistence`` is alive at one of them."""
    lasting = death - birth >= persistence
    out: list[float] = []
    latest, first_death = 0.0, np.inf
    # By rising birth: a class born after the first death among those waiting cannot share their level.
    for born, dead in sorted(zip(birth[lasting].tolist(), death[lasting].tolist(), strict=True)):
        if born >= first_death:
            out.append(latest)
            first_death = np.inf
        latest, first_death = born, min(first_death, dead)
    return np.array([*out, latest] if lasting.any() else [])
