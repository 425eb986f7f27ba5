"""Dendrograms as arrays: from merges to the order of the leaves, from the gaps between them to classes and levels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base import small
from wakefold.base.types import Floats, Ints


def leaf_order(edges: Ints, heights: Floats) -> tuple[Ints, Floats]:
    """Canonical dendrogram order and gaps of a sequence of merges.

    Args:
        edges: ``(M - 1, 2)`` a track of each of the two clusters merged.
        heights: ``(M - 1,)`` rising.

    A cluster is a list of tracks that begins with its smallest track, which also names it. The clusters joined at one
    height are chained by rising name, so the order depends on the classes alone, not on which of several minimum
    spanning trees the edges come from.
    """
    from wakefold.model.linkage.kernels.dendrogram import chain, name_merges

    winner, loser = np.empty((2, len(edges)), dtype=np.int64)
    name_merges(np.ascontiguousarray(edges), heights, winner, loser)
    by = _sorted_within_ties(heights, loser)
    order, gaps = np.empty(len(edges) + 1, dtype=np.int64), np.empty(len(edges))
    chain(winner[by], loser[by], heights[by], order, gaps)
    return order, gaps


def _sorted_within_ties(rising: Floats, then: Ints) -> Ints:
    """``np.lexsort((then, rising))`` of numbers that rise already, quick where few are equal."""
    by = np.arange(len(rising))
    same = rising[1:] == rising[:-1]
    tied = np.flatnonzero(np.append(same, False) | np.append(False, same))
    by[tied] = tied[np.lexsort((then[tied], rising[tied]))]
    return by


def leaf_order_of_matrix(distances: Floats, method: str) -> tuple[Ints, Floats]:
    """Canonical dendrogram order and gaps of symmetric distances ``(M, M)``, M > 1, by scipy's linkage."""
    from scipy.cluster.hierarchy import linkage
    from scipy.spatial.distance import squareform

    z = linkage(squareform(distances), method=method)
    first = list(range(len(distances)))  # one track of each cluster, as scipy numbers them
    edges = np.empty((len(z), 2), dtype=np.int64)
    for row, (a, b) in enumerate(z[:, :2].astype(np.int64).tolist()):
        edges[row] = first[a], first[b]
        first.append(first[a])
    return leaf_order(edges, z[:, 2].copy())


def classes(order: Ints, gaps: Floats) -> dict[str, NDArray]:
    """``rank`` of each track, and ``lo, hi, birth, death, parent`` of all classes, numbered as in ``Filtration``.

    Raises:
        ValueError: ``order`` is not a permutation, or a height is missing, negative or not finite.
    """
    from wakefold.model.linkage.kernels.dendrogram import nest

    tracks = len(order)
    rank = np.full(tracks, -1)
    if tracks and order.shape == (tracks,) and order.min() >= 0 and order.max() < tracks:
        rank[order] = np.arange(tracks)
    if tracks == 0 or (rank < 0).any():
        raise ValueError("order must be a permutation of the tracks, at least one")
    if gaps.shape != (tracks - 1,):
        raise ValueError(f"{tracks} tracks need {tracks - 1} gaps, got {gaps.shape}")
    if not (np.isfinite(gaps).all() and (gaps >= 0).all()):
        raise ValueError("a height of the filtration is negative or not finite")
    low, high, above = np.empty((3, 2 * tracks - 1), dtype=np.int64)
    born = np.empty(2 * tracks - 1)
    count = nest(gaps.copy(), low, high, born, above)  # read-only arrays would be compiled for again
    by = np.argsort(born[tracks:count])
    merged = tracks + by[_sorted_within_ties(born[tracks:count][by], low[tracks:count][by])]
    node_of = np.concatenate([rank, merged])
    class_of = np.empty(count, dtype=np.int64)
    class_of[node_of] = np.arange(count)
    above = above[node_of]
    parents = np.where(above >= 0, class_of[above], -1)
    births = born[node_of]
    deaths = np.where(parents >= 0, births[parents], np.inf)
    intervals = {"rank": rank, "lo": low[node_of], "hi": high[node_of]}
    return intervals | {"birth": births, "death": deaths, "parent": parents}


def range_maxima(gaps: Floats) -> Floats:
    """Sparse table ``(log2 M, M - 1)`` for ``largest_between``: row k holds the maxima of 2^k neighbouring gaps."""
    width = max(len(gaps), 1)
    table = np.zeros((width.bit_length(), width))
    table[0, : len(gaps)] = gaps
    for k in range(1, len(table)):
        half = 1 << (k - 1)
        np.maximum(table[k - 1, :-half], table[k - 1, half:], out=table[k, :-half])
        table[k, -half:] = table[k - 1, -half:]
    return table


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
    part = -share * small.log(share)  # what a class adds to the entropy of its level
    fall = np.bincount(parent[:-1], weights=part[:-1], minlength=len(size)) - part  # at the birth of a merged class
    heights, group = np.unique(np.append(0.0, birth[tracks:]), return_inverse=True)
    falls = np.bincount(group, weights=np.append(0.0, fall[tracks:]))
    return heights, np.log(tracks) - np.cumsum(falls)


def levels_by_entropy(size: Ints, birth: Floats, parent: Ints, number: int) -> Floats:
    """At most ``number`` heights between single tracks and the root, nearest to equal steps of entropy."""
    if number < 1:
        raise ValueError(f"number must be at least 1, got {number}")
    heights, entropy = entropy_by_height(size, birth, parent)
    between = slice(1, -1) if len(heights) > 2 else slice(0, 1)
    heights, entropy = heights[between], entropy[between]
    targets = np.log(size[-1]) * np.arange(number, 0, -1) / (number + 1)
    return np.unique(heights[np.abs(entropy[:, None] - targets).argmin(axis=0)])


def levels_by_persistence(birth: Floats, death: Floats, persistence: float) -> Floats:
    """The fewest births such that each class with ``death - birth >= persistence`` is alive at one of them."""
    if not (persistence >= 0 and np.isfinite(persistence)):
        raise ValueError(f"persistence must be finite and not negative, got {persistence}")
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


def linkage_matrix(lo: Ints, hi: Ints, birth: Floats, children: Callable[[int], Ints]) -> Floats:
    """``(M - 1, 4)`` merges as scipy.cluster.hierarchy writes them; a class with k children takes k - 1 rows.

    Args:
        lo, hi, birth: ``(C,)`` of each class, numbered as in ``Filtration``.
        children: of a class.
    """
    tracks = int(hi[-1])
    z = np.empty((tracks - 1, 4))
    number = list(range(tracks)) + [0] * (len(birth) - tracks)  # scipy's number of each class
    row = 0
    for c in range(tracks, len(birth)):
        first, *others = children(c).tolist()
        left, size = number[first], hi[first] - lo[first]
        for child in others:
            size += hi[child] - lo[child]
            z[row] = (*sorted((left, number[child])), birth[c], size)
            left = tracks + row
            row += 1
        number[c] = left
    return z


def newick(names: Sequence[str], birth: Floats, parent: Ints, children: Callable[[int], Ints]) -> str:
    """The tree as one line of Newick text; a branch is as long as ``birth(parent) - birth(child)``.

    Args:
        names: ``(M,)`` of the tracks.
        birth, parent: ``(C,)`` of each class, numbered as in ``Filtration``.
        children: of a class.
    """
    words: list[str] = []
    stack: list[int | str] = [len(birth) - 1]
    while stack:
        item = stack.pop()
        if isinstance(item, str):
            words.append(item)
            continue
        length = f":{float(birth[parent[item]] - birth[item])!r}" if parent[item] >= 0 else ""
        if item < len(names):
            words.append(_newick_name(str(names[item])) + length)
            continue
        words.append("(")
        stack.append(")" + length)
        for k, child in enumerate(children(item)[::-1].tolist()):
            stack.extend([",", child] if k else [child])
    return "".join(words) + ";"


def _newick_name(name: str) -> str:
    """Quoted unless plain: Newick reads an unquoted underscore as a blank."""
    return name if name and name.replace(".", "").replace("-", "").isalnum() else "'" + name.replace("'", "''") + "'"


def children(lo: Ints, parent: Ints) -> tuple[Ints, Ints]:
    """Children of all classes, the root last: those of class c are ``listed[starts[c]:starts[c + 1]]``."""
    listed = np.lexsort((lo[:-1], parent[:-1]))
    count = np.bincount(parent[:-1], minlength=len(parent))
    return np.concatenate([[0], np.cumsum(count)]), listed


def tree_distance(lo: Ints, hi: Ints, maxima: Floats, a: ArrayLike, b: ArrayLike) -> Floats | float:
    """See ``Filtration.tree_distance``; ``maxima`` are the ``range_maxima`` of the gaps."""
    from wakefold.model.linkage.kernels.dendrogram import joined_at

    a, b = np.asarray(a, dtype=np.int64), np.asarray(b, dtype=np.int64)
    if b.ndim == 0:  # a filter asks so at every report, and ``broadcast_arrays`` alone takes 10 µs
        b = np.full(a.shape, b)
    elif a.shape != b.shape:
        a, b = map(np.array, np.broadcast_arrays(a, b))
    found = np.empty(a.shape)
    if not joined_at(lo, hi, maxima, a.ravel(), b.ravel(), found.reshape(-1)):
        raise ValueError(f"classes run from 0 to {len(lo) - 1}")
    return float(found) if found.ndim == 0 else found


def html(levels: Iterable[float], cuts: Iterable[Ints]) -> str:
    """A table of levels (metres) with the classes there, whose cut points in leaf order are given; each row once."""
    rows = []
    for level, cut in zip(levels, cuts, strict=True):
        size = np.diff(cut)
        cells = (f"{level:.6g}", f"{len(size):,}", f"{size.max():,}", f"{(size == 1).sum():,}")
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = "".join(f"<th>{name}</th>" for name in ("level", "classes", "largest", "single tracks"))
    return f"<table><tr>{head}</tr>{''.join(dict.fromkeys(rows))}</table>"


def check_level(b: float) -> None:
    """Refuse what is no level, with a ValueError."""
    if not 0 <= b < np.inf:
        raise ValueError(f"a level must be finite and not negative, got {b}")
