"""Which stored tracks are near a track under the discrete Fréchet distance, without measuring them all."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints, Singles
from wakefold.model.linkage.bounds import MARGIN, boxes_of, extent, features_of, frame_of, in_lanes
from wakefold.model.linkage.distance import distances_from, frechet_matrix
from wakefold.tracks.tracks import Tracks

FAR = 2.0**40  # units of the features: further away, a feature is taken to be here, which only lowers the bound


class TrackIndex(Remembers):
    """Tracks in a tree of boxes, to be asked many times. Costs about 300 bytes a track, and 2 µs of a core.

    Attributes:
        tracks: those searched.
        frame: what their features are measured against.
        boxes: of the tracks in feature space.
    """

    def __init__(self, tracks: Tracks, threads: int | None = None):
        """
        Raises:
            ValueError: no tracks, or positions so far apart that a distance overflows.
        """
        if len(tracks) == 0:
            raise ValueError("no tracks to search")
        self.tracks = tracks
        self.frame = frame_of(tracks.points)
        self.boxes = boxes_of(features_of(tracks, self.frame, threads))

    @cached_property
    def lanes(self) -> Singles:
        """Features once more, see ``in_lanes``."""
        return in_lanes(self.boxes)

    def query(self, track: ArrayLike, *, within: float | None = None, k: int | None = None) -> tuple[Ints, Floats]:
        """The tracks near this one, exactly.

        Args:
            track: ``(n, d)`` positions (or ``(n,)`` for d = 1), in the plane of the tracks.
            within: at most this far, metres.
            k: at most so many, the nearest.

        Returns:
            indices of the tracks and their discrete Fréchet distances (the bits of ``frechet``), nearest first, those
            equally near by index.

        Raises:
            ValueError: neither ``within`` nor ``k``, one out of range, an empty track, one of other dimension or with
                a position that is not finite, or a distance that overflows.
        """
        if within is None and k is None:
            raise ValueError("say how near (within) or how many (k)")
        if within is not None and not within >= 0:
            raise ValueError(f"within must not be negative, got {within}")
        if k is not None and k < 1:
            raise ValueError(f"k must be at least 1, got {k}")
        reach = np.inf if within is None else float(within)
        wanted = len(self.tracks) if k is None else min(k, len(self.tracks))
        asked = Tracks.from_arrays([track], ids=["query"])
        if asked.dim != self.tracks.dim:
            raise ValueError(f"a track of {asked.dim} coordinates among tracks of {self.tracks.dim}")
        features, margin = self.measure(asked)
        if wanted < len(self.tracks):
            # Any so many tracks tell how far the nearest are at most. Tracks of small bounds do so best.
            radius, rows = self.frame.unit / 1024, np.empty(0, np.int64)
            while len(rows) < wanted and radius < 2 * reach:
                rows, _ = self._near(features, min(radius, reach), margin)
                radius *= 2
            if len(rows) >= wanted:
                reach = min(reach, float(self._distances(asked, rows[:wanted]).max()))
        rows, bounds = self._near(features, reach, margin)
        found, size = np.empty(0), wanted
        while len(found) < np.searchsorted(bounds, reach, side="right"):
            found = np.append(found, self._distances(asked, rows[len(found) : len(found) + size]))
            if len(found) >= wanted:
                reach = min(reach, float(np.partition(found, wanted - 1)[wanted - 1]))
            size *= 2
        indices = self.boxes.order[rows[: len(found)]]
        by = np.lexsort((indices, found))
        by = by[found[by] <= reach][:wanted]
        return indices[by], found[by]

    def measure(self, asked: Tracks) -> tuple[Singles, float]:
        """Features ``(n, F)`` of other tracks, and what rounding can lift lower bounds by, metres.

        Raises:
            ValueError: positions so far apart that a distance overflows.
        """
        low, high = (np.array([reduce(axis) for axis in asked.points.T]) for reduce in (np.min, np.max))
        middle, unit = self.frame.middle, self.frame.unit
        # No two points, of these tracks and those searched, are further apart than this.
        diagonal = unit + 2 * extent(np.minimum(low, middle), np.maximum(high, middle))
        with np.errstate(over="ignore"):
            return np.clip(features_of(asked, self.frame), -FAR, FAR), MARGIN * diagonal

    def _near(self, features: Singles, reach: float, margin: float) -> tuple[Ints, Floats]:
        """Box positions of the tracks whose lower bound is at most ``reach``, and the bounds, metres, rising."""
        from wakefold.model.linkage.kernels.search import near

        unit, boxes = self.frame.unit, self.boxes
        rows, squares = np.empty(len(boxes.order), np.int64), np.empty(len(boxes.order), np.float32)
        shape = boxes.features, boxes.bounds, boxes.low, boxes.high, self.tracks.dim
        count = near(features, 0, *shape, limit_of(reach, margin, unit), rows, squares)
        bounds = np.maximum(np.sqrt(squares[:count].astype(np.float64)) * unit - margin, 0.0)
        by = np.argsort(bounds, kind="stable")
        return rows[by], bounds[by]

    def _distances(self, asked: Tracks, rows: Ints) -> Floats:
        return distances_from(asked, self.tracks, self.boxes.order[rows])


def limit_of(reach: float, margin: float, unit: float) -> float:
    """Square of the least lower bound, in units, that shows two tracks to be further apart than ``reach``."""
    with np.errstate(over="ignore"):
        return float(np.nextafter(np.square(np.float64((reach + margin) / unit)), np.inf))


def medoid(tracks: Tracks, members: Ints, limit: int) -> int:
    """The member whose summed Fréchet distance to the others is least (first track of several).

    Args:
        members: indices of tracks; of more than ``limit``, this many spread evenly over the list stand for all.
    """
    if limit < 1:
        raise ValueError(f"limit must be at least 1, got {limit}")
    if len(members) > limit:
        members = members[np.linspace(0, len(members) - 1, limit).round().astype(np.int64)]
    members = np.sort(members)
    return int(members[np.argmin(frechet_matrix(tracks.select(members)).sum(axis=1))])
