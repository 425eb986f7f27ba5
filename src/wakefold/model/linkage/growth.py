"""Adding tracks to a spanning tree: its edges and those of the new tracks are enough, see docs/filtration.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wakefold.base.parallel import Progress, thread_map
from wakefold.base.types import Floats, Ints
from wakefold.model.linkage.bounds import Boxes, boxes_of, in_lanes
from wakefold.model.linkage.dendrogram import range_maxima
from wakefold.model.linkage.search import TrackIndex
from wakefold.model.linkage.spanning import grown_forest
from wakefold.tracks.tracks import Tracks

PIECE = 64  # new tracks that search in one piece of work


def grown_tree(
    index: TrackIndex,
    order: Ints,
    gaps: Floats,
    new: Tracks,
    threads: int | None = None,
    progress: Progress | None = None,
) -> tuple[Ints, Floats]:
    """A minimum spanning tree of tracks and new ones, which are numbered after them.

    Args:
        index: of the M tracks.
        order, gaps: their dendrogram, ``(M,)`` and ``(M - 1,)``.
        new: K tracks, at least one.
        progress: called with the share of the pieces of work that is done, 0 to 1.

    Returns:
        edges ``(M + K - 1, 2)`` and heights ``(M + K - 1,)``, metres, rising.

    Raises:
        ValueError: another plane, or positions so far apart that a distance overflows.
    """
    old, boxes = index.tracks, index.boxes
    if (old.projection, old.dim) != (new.projection, new.dim):
        raise ValueError("the new tracks lie in another plane: `project` them onto that of the others first")
    features, margin = index.measure(new)
    scale = index.frame.unit, margin
    rank = np.empty(len(old), dtype=np.int64)
    rank[order] = np.arange(len(old))

    tell = progress or (lambda share: None)

    def run(half: float) -> Callable[[Callable[[int], Any], Sequence[int]], list[Any]]:
        return partial(thread_map, threads=threads, progress=lambda done: tell(half + 0.5 * done))

    of_new, nowhere = boxes_of(features), np.full(len(new), -1)
    asking = new, of_new.order, features
    pairs, heights = _edges(asking, nowhere, old, boxes, index.lanes, rank, range_maxima(gaps), scale, run(0.0))
    by = np.argsort(gaps)
    first = np.concatenate([order[:-1][by], len(old) + pairs[:, 0]])
    second = np.concatenate([order[1:][by], pairs[:, 1]])
    forest = grown_forest(None, first, second, np.concatenate([gaps[by], heights]), len(old) + len(new))

    rank = forest.rank[len(old) :]
    pairs, heights = _edges(asking, rank, new, of_new, in_lanes(of_new), rank, forest.maxima, scale, run(0.5))
    pairs += len(old)
    forest = grown_forest(forest, pairs[:, 0], pairs[:, 1], heights, len(old) + len(new))
    return np.stack([forest.first, forest.second], axis=1), forest.heights


def _edges(
    asking: tuple[Tracks, Ints, NDArray[np.float32]],
    entries: Ints,
    others: Tracks,
    boxes: Boxes,
    lanes: NDArray[np.float32],
    rank: Ints,
    maxima: Floats,
    scale: tuple[float, float],
    run: Callable[[Callable[[int], Any], Sequence[int]], list[Any]],
) -> tuple[Ints, Floats]:
    """Edges that could be of use of all tracks ``asking``, with their order and features; see ``kernels.growth``."""
    from wakefold.model.linkage.kernels.growth import edges_to

    (new, by, features), rank = asking, rank[boxes.order]
    tree = rank, _over_boxes(np.minimum, rank, boxes.bounds), _over_boxes(np.maximum, rank, boxes.bounds), maxima
    shape = boxes.order, boxes.bounds, boxes.low, boxes.high
    axes = (0,) * new.dim

    def work(start: int) -> tuple[Ints, Floats]:
        asked = by[start : start + PIECE], (new.points, new.offsets), features, entries
        return edges_to(*asked, (others.points, others.offsets), shape, lanes, tree, scale, axes)

    found = run(work, range(0, len(new), PIECE))
    pairs, heights = zip(*found, strict=True)
    return np.concatenate(pairs), np.concatenate(heights)


def _over_boxes(reduce: np.ufunc, values: Ints, bounds: Ints) -> Ints:
    """Least or largest value in each box, the boxes numbered as in ``wakefold.model.linkage.bounds.Boxes``."""
    levels = [reduce.reduceat(values, bounds[:-1])]
    while len(levels[0]) > 1:
        levels.insert(0, reduce(levels[0][::2], levels[0][1::2]))
    return np.concatenate(levels)
