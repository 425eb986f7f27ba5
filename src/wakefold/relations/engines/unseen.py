"""Where a sensor does not see, and what it tells that it has not seen an object."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from wakefold.base.types import Floats, Ints
from wakefold.relations.detections import Detections
from wakefold.relations.engines.association import TINY
from wakefold.relations.scene import Particles

# Middles of seven parts of equal probability of a normal law, scaled to variance 1: where detect_prob is asked.
_PARTS = ndtri((np.arange(7) + 0.5) / 7)
_NODES = np.stack(np.meshgrid(_PARTS, _PARTS), axis=-1).reshape(-1, 2) / _PARTS.std()


class Blind(NamedTuple):
    """How well a sensor sees where an object may be, of each particle and object.

    Attributes:
        variance: ``(M, n)`` of its position, per axis.
        away: ``(M, n, nodes, 2)`` places about its mean.
        chance: ``(M, n, nodes)`` of being detected there.
    """

    variance: Floats
    away: Floats
    chance: Floats

    def missed(self, at: Ints, object_: int) -> tuple[Floats, Floats]:
        """What it tells of an object in particles ``at`` that it is not detected: it is where one cannot see.

        Returns:
            ``(k, 2)`` how far its mean moves, ``(k,)`` the share of its variance that is left.
        """
        variance, away = self.variance[at, object_], self.away[at, object_]
        missed = np.maximum(1.0 - self.chance[at, object_], TINY)
        missed /= missed.sum(axis=1, keepdims=True)
        shift = (missed[:, :, None] * away).sum(axis=1)
        square = away**2
        left = (missed * (square[:, :, 0] + square[:, :, 1])).sum(axis=1) - (shift**2).sum(axis=1)
        share = np.divide(left, 2.0 * variance, out=np.ones_like(left), where=variance > 0.0)
        return shift, np.clip(share, 0.05, 1.0)


def chances(particles: Particles, scan: Detections) -> tuple[Floats, Blind | None]:
    """``(M, n)`` probability that each object is detected, and where, unless that is the same everywhere."""
    count, _, n, _ = particles.mean.shape
    if not callable(scan.detect_prob) or n == 0:
        return np.full((count, n), 0.0 if callable(scan.detect_prob) else scan.detect_prob), None
    own = np.arange(n)
    variance = np.maximum(particles.cov[:, own, own], 0.0)
    away = np.sqrt(variance)[:, :, None, None] * _NODES
    asked = particles.mean[:, 0, :, None] + away
    chance = scan.chance(asked.reshape(-1, 2)).reshape(count, n, len(_NODES))
    return chance.mean(axis=2), Blind(variance, away, chance)


def narrow(mean: Floats, cov: Floats, missed: NDArray[np.bool_], members: Ints, blind: Blind) -> None:
    """Move and narrow a block's Gaussians by what it tells that objects were not detected, in place.

    Args:
        mean, cov: ``(M, 2 size, 2)``, ``(M, 2 size, 2 size)``.
        missed: ``(M, size)``; members: ``(size,)`` objects.
    """
    for i, member in enumerate(members.tolist()):
        at = np.flatnonzero(missed[:, i] & (cov[:, i, i] > 0.0))
        if not len(at):
            continue
        shift, share = blind.missed(at, member)
        told = (share < 0.999) | (shift != 0.0).any(axis=1)
        at, shift, share = at[told], shift[told], share[told]
        gain = cov[at, :, i] / cov[at, i, i, None]
        mean[at] += gain[:, :, None] * shift[:, None]
        cov[at] -= ((1.0 - share) * cov[at, i, i])[:, None, None] * gain[:, :, None] * gain[:, None]
