"""The minimum spanning tree of tracks under the discrete Fréchet distance, without the matrix of distances.

Kruskal's algorithm with a rising radius. Features of a track that a coupling cannot move by more than the Fréchet
distance F give a lower bound, |f(a) - f(b)| <= F(a, b). All pairs that could be nearer than the radius are found by
their features, in boxes of tracks; of these, only pairs that nothing cheaper joins go to the exact kernel. Once edges
no longer than the radius join all tracks, every pair left out is at least as long as some way around it, and the
tree is minimal. docs/filtration.md has the bounds and the proof.
"""

from __future__ import annotations

import hashlib
import math
import os
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base import store
from wakefold.base.parallel import Executor, Progress, Threads
from wakefold.base.types import Floats, Ints, Singles
from wakefold.model.linkage.bounds import MARGIN, Boxes
from wakefold.model.linkage.dendrogram import largest_between, range_maxima
from wakefold.model.linkage.distance import in_units
from wakefold.model.linkage.search import TrackIndex
from wakefold.tracks.tracks import Tracks

Directory = str | os.PathLike[str]
KIND = "spanning forest"

GROWTH = 1.5  # of the radius; smaller means fewer distances and more searches
TRACKS = 2048  # tracks to a piece of the search, on average
ROOM = 1 << 15  # pairs a piece of the search may find before their distances are computed
PIECE = 1 << 22  # cells of the dynamic programme in one piece of work, at least: a millisecond
LONG = 64  # points of the mean track from which on distances are computed in float32 first,
MANY = 4096  # if there are so many tracks: of fewer it spares less time than it takes to compile
PIECES = 4096  # pieces of work in a batch of distances, at most
FADE, RISE = 0.75, 3  # of the time each radius takes, see Estimate


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


class Work(NamedTuple):
    """The tracks, and who computes with them."""

    tracks: Tracks
    executor: Executor
    points: Any  # of the tracks, as the executor shares them
    offsets: Any
    singles: Any  # the points in float32 where tracks are many and long, else None
    exponent: int  # of 2, the unit of the singles in metres
    extent: float  # no two points are further apart, metres


class Estimate:
    """Share of the time that has passed, from what is known of the time that is left.

    What is left of a radius is expected to take FADE times what that part of the radius before took, and each radius
    to come FADE times the one before it; all of these 1 + RISE times as long while no tracks have joined, since radii
    take longer and longer until most have. How many will come is known once the edges seen join all tracks: the tree
    needs no radius above the longest of them. A radius is expected to have the rounds of search and distances that the
    one before it had. FADE and RISE are those of pedestrians, 100,000 and 1,000,000.
    """

    def __init__(self, progress: Progress | None):
        self.progress = progress
        self.begin = self.mark = monotonic()
        self.last = self.later = self.shown = 0.0
        self.rounds = self.rounds_before = 2  # a guess for the first radius

    def radius(self) -> None:
        """A radius begins."""
        now = monotonic()
        self.last, self.mark = now - self.mark, now
        self.rounds, self.rounds_before = 0, self.rounds

    def round(self, to_come: float, apart: float) -> None:
        """A round begins; ``to_come`` more radii follow at most (inf: not known), a share of the tracks is apart."""
        self.rounds += 1
        self.later = (1 + RISE * apart) * FADE * (1 - FADE**to_come) / (1 - FADE)

    def show(self, done: float) -> None:
        """A share of this round is done. The share shown never falls."""
        if self.progress:
            now = monotonic()
            done = (self.rounds - 1 + done) / max(self.rounds, self.rounds_before)
            rest = (1 - done) * FADE * self.last
            left = rest + self.later * (now - self.mark + rest)
            if now > self.begin:
                self.shown = max(self.shown, (now - self.begin) / (now - self.begin + left))
            self.progress(self.shown)


def spanning_tree(
    tracks: Tracks,
    threads: int | None = None,
    progress: Progress | None = None,
    *,
    executor: Executor | None = None,
    checkpoint: Directory | None = None,
    index: TrackIndex | None = None,
) -> tuple[Ints, Floats]:
    """A minimum spanning tree: edges ``(M - 1, 2)`` and heights ``(M - 1,)``, rising, the bits of ``frechet_matrix``.

    Args:
        tracks: two or more.
        threads: of this machine, all cores by default; the tree does not depend on it.
        progress: called with the share of the time estimated to have passed, 0 to 1, never falling.
        executor: where searches and distances run, these threads by default; the tree does not depend on it.
        checkpoint: directory that keeps the edges known, renewed many times in each radius. If it is there, the work
            goes on from it; the heights, and so the classes, are those of a run that was never interrupted.
        index: of the tracks, if it is at hand.

    Raises:
        ValueError: positions so far apart that a distance overflows; a checkpoint that is damaged or of other tracks.
    """
    estimate = Estimate(progress)
    count = len(tracks)
    index = index or TrackIndex(tracks, threads)
    boxes, unit = index.boxes, index.frame.unit
    margin = MARGIN * unit
    fingerprint = _fingerprint(tracks) if checkpoint is not None else ""
    forest, settled = _begin(checkpoint, fingerprint, boxes.order)
    executor = executor or Threads(threads)
    share = executor.share
    singles, exponent = None, 0
    if count >= MANY and len(tracks.points) >= LONG * count:
        (rounded,), exponent = in_units([tracks.points], "float32")
        singles = share(rounded)
    work = Work(tracks, executor, share(tracks.points), share(tracks.offsets), singles, exponent, unit)
    shape = tuple(map(share, (boxes.features, index.lanes, boxes.bounds, boxes.low, boxes.high)))
    part = np.arange(count)
    pieces = max(16, count // TRACKS)
    neighbours = np.abs(np.diff(boxes.features, axis=0)).max(axis=1)
    first_radius = max(unit * float(np.quantile(neighbours, 0.25)) / 2, margin)
    done = np.float32(0)  # pairs with a lower bound under `settled` metres, squared and in units, have been dealt with
    while np.searchsorted(forest.heights, settled, side="right") < count - 1:
        radius = settled * GROWTH if settled else first_radius
        limit = np.nextafter(np.float32(((radius + margin) / unit) ** 2), np.float32(np.inf))
        estimate.radius()
        tiles = _tiles(boxes, pieces)
        while len(tiles):
            estimate.round(*_to_do(radius, forest))
            part[forest.order] = np.concatenate([[0], np.cumsum(forest.gaps > settled)])
            shared = (*shape, share(part), share(_parts_of_boxes(part, boxes)), tracks.dim, done, limit)
            dealt = [tiles[k::pieces] for k in range(min(pieces, len(tiles)))]
            found = executor.map(_search, dealt, shared, lambda p: estimate.show(p / 2))
            tiles, a, b, square = map(np.concatenate, zip(*found, strict=True))
            bound = np.maximum(np.sqrt(square.astype(np.float64)) * unit - margin, 0.0)
            forest = _evaluate(work, boxes.order, a, b, bound, forest, lambda p: estimate.show(0.5 + p / 2))
            if checkpoint is not None:
                _keep(checkpoint, fingerprint, boxes.order, forest, settled)
        settled, done = radius, limit
    if checkpoint is not None:
        _keep(checkpoint, fingerprint, boxes.order, forest, settled)
    if progress:
        progress(1.0)
    return boxes.order[np.stack([forest.first, forest.second], axis=1)], forest.heights


def _to_do(radius: float, forest: Forest) -> tuple[float, float]:
    """Radii to come after this one, at most (inf while the forest does not join all tracks); share not yet joined."""
    apart = 1 - int(np.searchsorted(forest.heights, radius, side="right")) / (len(forest.order) - 1)
    if len(forest.heights) < len(forest.order) - 1:
        return math.inf, apart
    return math.ceil(math.log(max(1.0, forest.heights[-1] / radius)) / math.log(GROWTH)), apart


def _fingerprint(tracks: Tracks) -> str:
    """SHA-256 of where the tracks run."""
    digest = hashlib.sha256(repr((tracks.points.shape, tracks.offsets.shape)).encode())
    for array in (tracks.points, tracks.offsets):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _keep(directory: Directory, fingerprint: str, order: Ints, forest: Forest, settled: float) -> None:
    """Write the forest, its tracks numbered as given, and the radius it is complete for."""
    arrays = {"first": order[forest.first], "second": order[forest.second], "heights": forest.heights}
    store.save(directory, arrays, {"tracks": fingerprint, "settled": settled}, KIND)


def _begin(directory: Directory | None, fingerprint: str, order: Ints) -> tuple[Forest, float]:
    """The forest and radius that ``_keep`` wrote; without a directory to read, no edges and 0."""
    count, settled = len(order), 0.0
    first, second, heights = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    if directory is not None and Path(directory).exists():
        arrays, meta = store.load(directory, KIND)
        if meta.get("tracks") != fingerprint:
            raise ValueError(f"{os.fspath(directory)} is a checkpoint of other tracks")
        place = np.empty(count, dtype=np.int64)
        place[order] = np.arange(count)
        try:
            first, second, heights = place[arrays["first"]], place[arrays["second"]], np.array(arrays["heights"])
            settled = float(meta["settled"])
            sound = first.shape == second.shape == heights.shape == (heights.size,) and heights.dtype == np.float64
            sound = sound and bool((heights >= 0).all() and np.isfinite(heights).all() and 0 <= settled < np.inf)
        except (KeyError, IndexError, TypeError, ValueError):
            sound = False
        if not sound:
            raise store.StoreError(f"{os.fspath(directory)} is damaged: not a forest of these tracks")
    return grown_forest(None, first, second, heights, count), settled


def _parts_of_boxes(part: Ints, boxes: Boxes) -> Ints:
    """Part of each box whose tracks are all of one part, -1 of the others; ``part (M,)`` of tracks in box order."""
    low, high = (reduce.reduceat(part, boxes.bounds[:-1]) for reduce in (np.minimum, np.maximum))
    levels = [np.where(low == high, low, -1)]
    while len(levels[-1]) > 1:
        first, second = levels[-1].reshape(-1, 2).T
        levels.append(np.where(first == second, first, -1))
    return np.concatenate(levels[::-1])


def _tiles(boxes: Boxes, pieces: int) -> Ints:
    """Pairs of boxes ``(n, 2)`` that hold every pair of tracks once, many to a piece, each kind dealt to all pieces."""
    leaves = len(boxes.bounds) - 1
    width = min(leaves, 8 << pieces.bit_length() // 2)
    first, second = np.triu_indices(width)
    near = np.argsort(second - first, kind="stable")
    return np.stack([first[near], second[near]], axis=1) + (width - 1)


def _search(
    tiles: Ints,
    features: Singles,
    lanes: Singles,
    bounds: Ints,
    low: Singles,
    high: Singles,
    part: Ints,
    box_part: Ints,
    dim: int,
    done: np.float32,
    limit: np.float32,
) -> tuple[Ints, Ints, Ints, Singles]:
    """What is left of the tiles when there is no more room, and the pairs found: first, second, square of the bound."""
    from wakefold.model.linkage.kernels.spanning import close_pairs

    stack = np.empty((len(tiles) + 4 * len(low).bit_length(), 2), dtype=np.int64)
    stack[: len(tiles)] = tiles
    a, b, square = np.empty(ROOM, np.int64), np.empty(ROOM, np.int64), np.empty(ROOM, np.float32)
    boxes = features, lanes, bounds, low, high
    top, n = close_pairs(boxes, (part, box_part), dim, done, limit, stack, len(tiles), (a, b, square))
    return stack[:top].copy(), a[:n].copy(), b[:n].copy(), square[:n].copy()


def _evaluate(work: Work, order: Ints, a: Ints, b: Ints, bound: Floats, forest: Forest, progress: Progress) -> Forest:
    """The forest with all pairs that could improve it, smallest lower bound first.

    Args:
        order: track at each box position.
        a, b: ``(n,)`` box positions.
        bound: ``(n,)`` lower bounds of their distances, metres.
    """
    from wakefold.model.linkage.kernels.spanning import useful_pairs

    by = np.argsort(bound, kind="stable")
    a, b, bound = a[by], b[by], bound[by]
    start, size = 0, max(512, len(order) // 8)
    while start < len(a):
        begin, batch = start, np.empty(size, dtype=np.int64)
        start, count = useful_pairs(a, b, bound, begin, forest.rank, forest.maxima, batch)
        first, second = a[batch[:count]], b[batch[:count]]
        if count and work.singles is not None:
            near = _sift(work, order, first, second, forest)
            first, second = first[near], second[near]
        if len(first):
            tell = partial(_tell, progress, begin / len(a), start / len(a))
            heights = _distances(work, work.points, order[first], order[second], tell)
            forest = grown_forest(forest, first, second, heights, len(order))
        size += size // 2
    return forest


def _tell(progress: Progress, begin: float, end: float, share: float) -> None:
    """Of a part of the work, from ``begin`` to ``end`` of the whole."""
    progress(begin + share * (end - begin))


def _sift(work: Work, order: Ints, a: Ints, b: Ints, forest: Forest) -> NDArray[np.bool_]:
    """Which of the pairs ``(n,)`` may improve the forest, by their distances in float32.

    A pair that known edges and others of these pairs join, even at their upper bounds, below its own lower bound
    is of no use. Those others, all in a forest of upper bounds, are kept.
    """
    distance = np.ldexp(_distances(work, work.singles, order[a], order[b], lambda share: None), work.exponent)
    error = 2.0**-23 * (work.extent + 4 * distance)  # twice what docs/filtration.md derives: it has the exact distance
    trial = grown_forest(forest, a, b, distance + error, len(order))
    return trial.joined_at(a, b) >= distance - error


def _distances(work: Work, points: Any, a: Ints, b: Ints, progress: Progress) -> Floats:
    """Fréchet distances ``(n,)`` of pairs of tracks with these points."""
    lengths = work.tracks.lengths
    swap = lengths[a] < lengths[b]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    by = np.lexsort((lengths[b], lengths[a]))  # lanes of a batch get tracks of about the same lengths
    pairs = np.stack([a[by], b[by]])
    cells = np.cumsum(lengths[pairs[0]] * lengths[pairs[1]])
    piece = cells // max(PIECE, cells[-1] // PIECES)
    pieces = np.split(pairs, np.flatnonzero(np.diff(piece)) + 1, axis=1)
    found = work.executor.map(_measure, pieces, (points, work.offsets), progress)
    out = np.empty(len(by))
    out[by] = np.concatenate(found)
    return out


def _measure(pairs: Ints, points: Floats, offsets: Ints) -> Floats:
    """Fréchet distances of pairs ``(2, n)`` of tracks, those of similar lengths beside one another."""
    from wakefold.model.linkage.kernels.frechet import pairs_of_tracks

    first, second = pairs.copy()  # contiguous, and writeable wherever this runs: the kernel is compiled for one type
    out = np.empty(len(first))
    pairs_of_tracks(points, offsets, first, points, offsets, second, (0,) * points.shape[1], out)
    return out


def grown_forest(forest: Forest | None, first: Ints, second: Ints, heights: Floats, count: int) -> Forest:
    """The minimum spanning forest of a forest's edges and some more, with its dendrogram."""
    from wakefold.model.linkage.kernels.spanning import grow_forest

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
