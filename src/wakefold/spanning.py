"""The minimum spanning tree of tracks under the discrete Fréchet distance, without the matrix of distances.

Kruskal's algorithm with a rising radius. Features of a track that a coupling cannot move by more than the Fréchet
distance F give a lower bound, |f(a) - f(b)| <= F(a, b). All pairs that could be nearer than the radius are found by
their features, in boxes of tracks; of these, only pairs that nothing cheaper joins go to the exact kernel. Once edges
no longer than the radius join all tracks, every pair left out is at least as long as some way around it, and the
tree is minimal. docs/filtration.md has the bounds and the proof.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.dendrogram import largest_between, range_maxima
from wakefold.parallel import thread_map
from wakefold.tracks import Floats, Tracks

Ints = NDArray[np.int64]
Singles = NDArray[np.float32]

LEAF = 8  # tracks in a box that is not divided further, at most
LANDMARKS = 16
GROWTH = 1.5  # of the radius; smaller means fewer distances and more searches
TRACKS = 2048  # tracks to a piece of the search, on average
ROOM = 1 << 14  # pairs a piece of the search may find before their distances are computed
PIECE = 1 << 22  # cells of the dynamic programme in one piece of work: a millisecond
MARGIN = 2.0**-21  # of the unit of features: more than rounding can lift a lower bound, see docs/filtration.md


class Boxes(NamedTuple):
    """A balanced binary tree of boxes in feature space; the halves of box n are 2 n + 1 and 2 n + 2, leaves last."""

    order: Ints  # (M,) tracks such that each box holds a range of them
    features: Singles  # (M, F) in that order
    bounds: Ints  # (leaves + 1,) where the leaves' ranges begin
    low: Singles  # (B, F) corners
    high: Singles


class Forest(NamedTuple):
    """The minimum spanning forest of the edges seen so far, and its dendrogram; tracks numbered in box order."""

    first: Ints  # (edges,)
    second: Ints
    heights: Floats  # rising
    order: Ints  # (M,)
    gaps: Floats  # (M - 1,) inf between trees
    rank: Ints  # (M,) inverse of order
    maxima: Floats  # range maxima of gaps

    def joined_at(self, a: Ints, b: Ints) -> Floats:
        """Height at which the forest joins tracks a and b, different ones; inf if it does not."""
        i, j = self.rank[a], self.rank[b]
        return largest_between(self.maxima, np.minimum(i, j), np.maximum(i, j))


def spanning_tree(
    tracks: Tracks, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> tuple[Ints, Floats]:
    """A minimum spanning tree: edges ``(M - 1, 2)`` and heights ``(M - 1,)``, rising, the bits of ``frechet_matrix``.

    Args:
        tracks: two or more.
        threads: all cores by default; the tree does not depend on it.
        progress: called with the share of the tracks that have joined.

    Raises:
        ValueError: positions so far apart that a distance overflows.
    """
    from wakefold.kernels.frechet_tree import label_boxes

    count = len(tracks)
    boxes, unit = _boxes_of(tracks, threads)
    margin = MARGIN * unit
    forest = _grow(None, np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), count)
    part, box_part = np.arange(count), np.empty(len(boxes.low), dtype=np.int64)
    pieces = max(16, count // TRACKS)
    neighbours = np.abs(np.diff(boxes.features, axis=0)).max(axis=1)
    radius = max(unit * float(np.quantile(neighbours, 0.25)) / 2, margin)
    settled, done = 0.0, np.float32(0)  # pairs with a lower bound under `settled` metres have been dealt with
    while True:
        limit = np.nextafter(np.float32(((radius + margin) / unit) ** 2), np.float32(np.inf))
        tiles = _tiles(boxes, pieces)
        while len(tiles):
            part[forest.order] = np.concatenate([[0], np.cumsum(forest.gaps > settled)])
            label_boxes(part, boxes.bounds, box_part)
            search = partial(_search, boxes, part, box_part, tracks.dim, done, limit)
            found = thread_map(search, [tiles[k::pieces] for k in range(min(pieces, len(tiles)))], threads)
            tiles, a, b, square = map(np.concatenate, zip(*found, strict=True))
            bound = np.maximum(np.sqrt(square.astype(np.float64)) * unit - margin, 0.0)
            forest = _evaluate(tracks, boxes.order, a, b, bound, forest, threads)
        joined = int(np.searchsorted(forest.heights, radius, side="right"))
        if progress:
            progress(joined / (count - 1))
        if joined == count - 1:
            return boxes.order[np.stack([forest.first, forest.second], axis=1)], forest.heights
        settled, done, radius = radius, limit, radius * GROWTH


def _tiles(boxes: Boxes, pieces: int) -> Ints:
    """Pairs of boxes ``(n, 2)`` that hold every pair of tracks once, many to a piece, each kind dealt to all pieces."""
    leaves = len(boxes.bounds) - 1
    width = min(leaves, 8 << pieces.bit_length() // 2)
    first, second = np.triu_indices(width)
    near = np.argsort(second - first, kind="stable")
    return np.stack([first[near], second[near]], axis=1) + (width - 1)


def _search(
    boxes: Boxes, part: Ints, box_part: Ints, dim: int, done: np.float32, limit: np.float32, tiles: Ints
) -> tuple[Ints, Ints, Ints, Singles]:
    """What is left of the tiles when there is no more room, and the pairs found: first, second, square of the bound."""
    from wakefold.kernels.frechet_tree import close_pairs

    stack = np.empty((len(tiles) + 4 * len(boxes.low).bit_length(), 2), dtype=np.int64)
    stack[: len(tiles)] = tiles
    a, b, square = np.empty(ROOM, np.int64), np.empty(ROOM, np.int64), np.empty(ROOM, np.float32)
    shape = boxes.features, part, boxes.bounds, boxes.low, boxes.high, box_part
    top, n = close_pairs(*shape, dim, done, limit, stack, len(tiles), a, b, square)
    return stack[:top].copy(), a[:n].copy(), b[:n].copy(), square[:n].copy()


def _evaluate(
    tracks: Tracks, order: Ints, a: Ints, b: Ints, bound: Floats, forest: Forest, threads: int | None
) -> Forest:
    """The forest with all pairs that could improve it, smallest lower bound first.

    Args:
        order: track at each box position.
        a, b: ``(n,)`` box positions.
        bound: ``(n,)`` lower bounds of their distances, metres.
    """
    by = np.argsort(bound, kind="stable")
    a, b, bound = a[by], b[by], bound[by]
    size = max(512, len(order) // 8)
    while True:
        # What the forest joins at or below the lower bound of a pair, the pair cannot join earlier.
        useful = forest.joined_at(a, b) > bound
        a, b, bound = a[useful], b[useful], bound[useful]
        if len(a) == 0:
            return forest
        heights = _distances(tracks, order[a[:size]], order[b[:size]], threads)
        forest = _grow(forest, a[:size], b[:size], heights, len(order))
        a, b, bound = a[size:], b[size:], bound[size:]
        size += size // 2


def _distances(tracks: Tracks, a: Ints, b: Ints, threads: int | None) -> Floats:
    """Fréchet distances ``(n,)`` of pairs of tracks."""
    from wakefold.kernels.frechet import pairs_of_tracks

    lengths = tracks.lengths
    swap = lengths[a] < lengths[b]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    by = np.lexsort((lengths[b], lengths[a]))  # lanes of a batch get tracks of about the same lengths
    a, b = a[by], b[by]
    found = np.empty(len(a))
    cells = np.cumsum(lengths[a] * lengths[b])
    pieces = np.split(np.arange(len(a)), np.flatnonzero(np.diff(cells // PIECE)) + 1)
    axes = (0,) * tracks.dim

    def work(piece: Ints) -> None:
        part = slice(piece[0], piece[-1] + 1)
        pairs_of_tracks(tracks.points, tracks.offsets, a[part], b[part], axes, found[part])

    thread_map(work, pieces, threads)
    out = np.empty(len(a))
    out[by] = found
    return out


def _grow(forest: Forest | None, first: Ints, second: Ints, heights: Floats, count: int) -> Forest:
    """The minimum spanning forest of a forest's edges and some more, with its dendrogram."""
    from wakefold.kernels.frechet_tree import grow_forest

    if forest is not None:
        first = np.concatenate([forest.first, first])
        second = np.concatenate([forest.second, second])
        heights = np.concatenate([forest.heights, heights])
    by = np.argsort(heights, kind="stable")
    first, second, heights = first[by], second[by], heights[by]
    taken = np.empty(len(by), dtype=np.bool_)
    order, gaps, rank = np.empty(count, np.int64), np.empty(count - 1), np.empty(count, np.int64)
    grow_forest(first, second, heights, taken, order, gaps)
    rank[order] = np.arange(count)
    return Forest(first[taken], second[taken], heights[taken], order, gaps, rank, range_maxima(gaps))


def _boxes_of(tracks: Tracks, threads: int | None) -> tuple[Boxes, float]:
    """Boxes of the tracks in feature space, and the unit of the features, metres: a power of two above the diagonal."""
    from wakefold.kernels.frechet_tree import track_features

    low, high = (np.array([reduce(axis) for axis in tracks.points.T]) for reduce in (np.min, np.max))
    middle = low / 2 + high / 2
    with np.errstate(over="ignore"):
        square = float(((high - low) ** 2).sum())
    if not np.isfinite(square):
        raise ValueError("the tracks are too far apart: a distance overflows")
    unit = float(np.ldexp(1.0, np.frexp(np.sqrt(square))[1]))
    directions = _directions(tracks.dim)
    landmarks = (_landmarks(tracks.points) - middle) / unit
    out = np.empty((len(tracks), 2 * tracks.dim + 2 * len(directions) + len(landmarks)), dtype=np.float32)
    pieces = np.unique(np.linspace(0, len(tracks), 65).astype(np.int64))

    def work(piece: tuple[int, int]) -> None:
        track_features(tracks.points, tracks.offsets, middle, 1 / unit, directions, landmarks, *piece, out)

    thread_map(work, list(zip(pieces[:-1].tolist(), pieces[1:].tolist(), strict=True)), threads)
    return _divide(out), unit


def _directions(dim: int) -> Floats:
    """Unit vectors ``(n, dim)`` spread over half of all directions."""
    if dim == 2:
        angle = np.arange(8) * (np.pi / 8)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # From the centre of a cube to its faces, edges and corners.
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    half = grid[len(grid) // 2 + 1 :]
    return half / np.linalg.norm(half, axis=1, keepdims=True)


def _landmarks(points: Floats) -> Floats:
    """Points far from one another, ``(n, d)``: each the furthest from those before it, among a sample."""
    sample = points[:: -(-len(points) // 4096)]
    chosen = [sample.mean(axis=0)]
    distance = np.full(len(sample), np.inf)
    for _ in range(LANDMARKS - 1):
        distance = np.minimum(distance, ((sample - chosen[-1]) ** 2).sum(axis=1))
        chosen.append(sample[distance.argmax()])
    return np.array(chosen)


def _divide(features: Singles) -> Boxes:
    """Halve the tracks at the median of their widest feature, again and again."""
    from wakefold.kernels.frechet_tree import corners

    count = len(features)
    order, bounds = np.arange(count), np.array([0, count])
    lows, highs = [], []
    while True:
        low, high = np.empty((2, len(bounds) - 1, features.shape[1]), dtype=np.float32)
        corners(features, bounds, low, high)
        lows.append(low)
        highs.append(high)
        if np.diff(bounds).max() <= LEAF:
            return Boxes(order, features, bounds, np.concatenate(lows), np.concatenate(highs))
        widest = np.repeat((high - low).argmax(axis=1), np.diff(bounds))
        box = np.repeat(np.arange(len(low)), np.diff(bounds))
        by = np.lexsort((features[np.arange(count), widest], box))
        order, features = order[by], features[by]
        bounds = np.sort(np.concatenate([bounds, (bounds[:-1] + bounds[1:]) // 2]))
