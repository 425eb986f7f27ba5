"""Lower bounds of the discrete Fréchet distance: features of tracks, and boxes of tracks in the space of features.

A coupling at Fréchet distance F pairs first point with first, last with last, and every point of each track with some
point of the other. None of these features can therefore differ by more than F between two tracks: first point, last
point, reach along and against some directions, distances to some landmarks. docs/filtration.md derives the margin
that rounding takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wakefold.base.parallel import thread_map
from wakefold.base.types import Floats, Ints, Singles
from wakefold.tracks.tracks import Tracks

LEAF = 8  # tracks in a box that is not divided further, at most; a vector holds one feature of all of them
LANDMARKS = 8  # of 4, 8 and 16 landmarks with 4 or 8 directions, 8 with 4 cost least on crowds, routes and hubs
MARGIN = 2.0**-21  # of the unit of features: more than rounding can lift a lower bound


class Frame(NamedTuple):
    """What features are measured against. The unit is a power of two not below the diagonal of the points, metres."""

    middle: Floats  # (d,) of the bounding box
    unit: float
    directions: Floats  # (u, d) unit vectors
    landmarks: Floats  # (z, d) points


class Boxes(NamedTuple):
    """A balanced binary tree of boxes in feature space; the halves of box n are 2 n + 1 and 2 n + 2, leaves last."""

    order: Ints  # (M,) tracks such that each box holds a range of them
    features: Singles  # (M, F) in that order
    bounds: Ints  # (leaves + 1,) where the leaves' ranges begin
    low: Singles  # (B, F) corners
    high: Singles


def frame_of(points: Floats) -> Frame:
    """The frame of features for tracks with these points.

    Raises:
        ValueError: positions so far apart that a distance overflows.
    """
    low, high = (np.array([reduce(axis) for axis in points.T]) for reduce in (np.min, np.max))
    diagonal = extent(low, high)
    unit = float(np.ldexp(1.0, max(int(np.frexp(diagonal)[1]), -1000)))
    return Frame(low / 2 + high / 2, unit, _directions(points.shape[1]), _landmarks(points))


def extent(low: Floats, high: Floats) -> float:
    """Diagonal of a bounding box.

    Raises:
        ValueError: it is so long that a distance overflows.
    """
    with np.errstate(over="ignore"):
        square = float(((high - low) ** 2).sum())
    if not np.isfinite(square):
        raise ValueError("the tracks are too far apart: a distance overflows")
    return float(np.sqrt(square))


def features_of(tracks: Tracks, frame: Frame, threads: int | None = None) -> Singles:
    """Features ``(M, F)`` of tracks, in units of the frame: first point, last point, then the others."""
    from wakefold.model.linkage.kernels.bounds import track_features

    out = np.empty((len(tracks), 2 * tracks.dim + 2 * len(frame.directions) + len(frame.landmarks)), dtype=np.float32)
    landmarks = (frame.landmarks - frame.middle) / frame.unit
    pieces = np.unique(np.linspace(0, len(tracks), 65).astype(np.int64))
    axes = (0,) * tracks.dim

    def work(piece: tuple[int, int]) -> None:
        shape = tracks.points, tracks.offsets, frame.middle, 1 / frame.unit, frame.directions, landmarks
        track_features(*shape, *piece, axes, out)

    thread_map(work, list(zip(pieces[:-1].tolist(), pieces[1:].tolist(), strict=True)), threads)
    return out


def boxes_of(features: Singles) -> Boxes:
    """Halve the tracks at the median of their widest feature, again and again."""
    from wakefold.model.linkage.kernels.bounds import divide

    levels = [np.array([0, len(features)])]
    while np.diff(levels[-1]).max() > LEAF:
        bounds = levels[-1]
        levels.append(np.sort(np.concatenate([bounds, (bounds[:-1] + bounds[1:]) // 2])))
    starts, stops = (np.concatenate([bounds[side] for bounds in levels]) for side in (np.s_[:-1], np.s_[1:]))
    order = np.arange(len(features))
    low, high = np.empty((2, len(starts), features.shape[1]), dtype=np.float32)
    divide(features, order, starts, stops, low, high, np.empty(len(features), dtype=np.float32))
    return Boxes(order, features[order], levels[-1], low, high)


def in_lanes(boxes: Boxes) -> Singles:
    """Features of the tracks of each leaf side by side, as ``close_pairs`` takes them; inf where there is no track."""
    from wakefold.model.kernels.simd import LANES

    width = LANES["float32"]
    lengths = np.diff(boxes.bounds)
    assert lengths.max() <= width
    out = np.full((len(lengths), boxes.features.shape[1], width), np.inf, dtype=np.float32)
    leaf = np.repeat(np.arange(len(lengths)), lengths)
    out[leaf, :, np.arange(len(leaf)) - boxes.bounds[leaf]] = boxes.features
    return out.reshape(-1)


def _directions(dim: int) -> Floats:
    """Unit vectors ``(n, dim)`` spread over half of all directions."""
    if dim == 2:
        angle = np.arange(4) * (np.pi / 4)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if dim > 3:  # a cube of many sides has too many corners: to the faces
        return np.eye(dim)
    # From the centre of a cube to its faces and corners.
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    half = grid[len(grid) // 2 + 1 :]
    half = half[np.isin(np.abs(half).sum(axis=1), (1, dim))]
    return half / np.linalg.norm(half, axis=1, keepdims=True)


def _landmarks(points: Floats) -> Floats:
    """Points far from one another, ``(n, d)``: each the furthest from those before it, among a sample."""
    sample = np.ascontiguousarray(points[:: -(-len(points) // 4096)].T)
    chosen = [sample.mean(axis=1)]
    distance = np.full(sample.shape[1], np.inf)
    for _ in range(LANDMARKS - 1):
        distance = np.minimum(distance, ((sample - chosen[-1][:, None]) ** 2).sum(axis=0))
        chosen.append(sample[:, distance.argmax()])
    return np.array(chosen)
