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

    Clusters are linked lists of tracks. All merges of one height are done together and the clusters they join stand
    in the order of their first tracks, so the order depends on the classes alone, not on which of several minimum
    spanning trees the edges come from.
    """
    tracks = len(edges) + 1
    root, first, tail = list(range(tracks)), list(range(tracks)), list(range(tracks))
    head, after, above = list(range(tracks)), [-1] * tracks, [0.0] * tracks

    def find(x: int) -> int:
        while root[x] != x:
            root[x] = x = root[root[x]]
        return x

    bounds = np.concatenate([[0], np.flatnonzero(np.diff(heights)) + 1, [len(heights)]]).tolist()
    pairs, level = edges.tolist(), heights.tolist()
    for start, stop in pairwise(bounds):
        parts = {find(x) for pair in pairs[start:stop] for x in pair}
        for a, b in pairs[start:stop]:
            root[find(a)] = find(b)
        whole: dict[int, int] = {}
        for part in sorted(parts, key=first.__getitem__):
            top = find(part)
            if top in whole:
                after[tail[whole[top]]] = head[part]
                above[tail[whole[top]]] = level[start]
                tail[whole[top]] = tail[part]
            else:
                whole[top] = part
        for top, part in whole.items():
            head[top], tail[top], first[top] = head[part], tail[part], first[part]
    order = [head[find(0)]]
    while after[order[-1]] >= 0:
        order.append(after[order[-1]])
    ranked = np.array(order, dtype=np.int64)
    return ranked, np.array(above)[ranked[:-1]]


def classes(order: Ints, rank: Ints, gaps: Floats) -> dict[str, NDArray]:
    """Intervals, heights and parents of all classes from the gaps between ranks, in one pass with a stack."""
    tracks = len(order)
    lo, hi, birth = [], [], []
    stack: list[tuple[int, float]] = []  # open classes, (lo, birth), births falling
    for r, gap in enumerate(gaps.tolist()):
        start = r
        while stack and stack[-1][1] < gap:
            start, height = stack.pop()
            lo.append(start)
            hi.append(r + 1)
            birth.append(height)
        if not (stack and stack[-1][1] == gap):
            stack.append((start, gap))
    for start, height in reversed(stack):
        lo.append(start)
        hi.append(tracks)
        birth.append(height)
    inner = np.lexsort((np.array(lo, dtype=np.int64), np.array(birth)))
    out_lo = np.concatenate([rank, np.array(lo, dtype=np.int64)[inner]])
    out_hi = np.concatenate([rank + 1, np.array(hi, dtype=np.int64)[inner]])
    out_birth = np.concatenate([np.zeros(tracks), np.array(birth)[inner]])
    parent = _parents(out_lo, out_hi)
    death = np.where(parent >= 0, out_birth[parent], np.inf)
    return {"lo": out_lo, "hi": out_hi, "birth": out_birth, "death": death, "parent": parent}


def _parents(lo: Ints, hi: Ints) -> Ints:
    """The smallest interval around each of a family of nested, distinct intervals; -1 for the outermost."""
    parent = [-1] * len(lo)
    stack: list[int] = []
    ends = hi.tolist()
    for c in np.lexsort((-hi, lo)).tolist():
        while stack and ends[stack[-1]] < ends[c]:
            stack.pop()
        if stack:
            parent[c] = stack[-1]
        stack.append(c)
    return np.array(parent, dtype=np.int64)


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
