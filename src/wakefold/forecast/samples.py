"""Answers as samples: drawn from weighted points without chance, scored against the truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wakefold.base.parallel import Progress, cores, thread_map
from wakefold.base.types import Floats, Ints
from wakefold.forecast import kernels

SAMPLES = 100  # of every answer
BLOCK = 2000  # answers that are scored in one call


def systematic(weights: Floats, count: int = SAMPLES) -> Ints:
    """``(count,)`` indices of weighted things, each as often as its weight says, give or take one.

    Args:
        weights: ``(n,)``, any positive sum.
    """
    sums = np.cumsum(weights)
    at = (np.arange(count) + 0.5) / count * sums[-1]
    return np.minimum(np.searchsorted(sums, at, side="right"), len(weights) - 1)


def evenly(length: int, count: int = SAMPLES) -> Ints:
    """``(count,)`` indices of so many things, all as often as one another, give or take one."""
    return (2 * np.arange(count) + 1) * length // (2 * count)


def normal_samples(count: int = SAMPLES) -> Floats:
    """``(count, 2)`` points that lie as a normal distribution does: on a spiral, turned by golden angles."""
    k = np.arange(count)
    radius, angle = np.sqrt(-2.0 * np.log1p(-(k + 0.5) / count)), k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


class Judged(NamedTuple):
    """Scores of N answers; NaN where nothing was asked.

    Attributes:
        point: ``(Q, H, d)`` geometric median of the samples.
        error: ``(Q, H)`` distance of the truth from it.
        energy: ``(Q, H)`` fair energy score: mean distance of a sample from the truth less half the mean distance of
            two different samples.
        depth: ``(Q, H)`` share of the samples where their density is higher than at the truth: the truth lies inside
            the region of highest density of mass m where ``depth <= m``.
    """

    point: Floats
    error: Floats
    energy: Floats
    depth: Floats

    def within(self, mass: float) -> Floats:
        """``(Q, H)`` 1 where the truth lies in the region of highest density of so much mass, 0 where not, or NaN."""
        return np.where(np.isnan(self.depth), np.nan, self.depth <= mass)


def judged(samples: Floats, truth: Floats, progress: Progress | None = None) -> Judged:
    """Score answers ``(Q, H, S, d)`` against truths ``(Q, H, d)``, of which NaN are not asked for."""
    asked = np.isfinite(truth[:, :, 0])
    flat, true = np.ascontiguousarray(samples[asked]), np.ascontiguousarray(truth[asked])
    middle, found = np.empty_like(true), np.empty((len(true), 3))
    starts = range(0, len(true), BLOCK)

    def one(at: int) -> None:
        part = slice(at, at + BLOCK)
        kernels.judge(flat[part], true[part], middle[part], found[part])

    thread_map(one, starts, min(cores(), max(len(starts), 1)), progress)
    point, scores = np.full(truth.shape, np.nan), np.full((*asked.shape, 3), np.nan)
    point[asked], scores[asked] = middle, found
    return Judged(point, scores[..., 0], scores[..., 1], scores[..., 2])


def middles(samples: Floats) -> Floats:
    """Geometric medians ``(Q, H, d)`` of samples ``(Q, H, S, d)``."""
    flat = np.ascontiguousarray(samples.reshape(-1, *samples.shape[2:]))
    out = np.empty((len(flat), samples.shape[-1]))
    kernels.middles(flat, out)
    return out.reshape(*samples.shape[:2], -1)
