"""What a scene holds about the pairs of each relation: of each kind of engine, its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats, Ints


@dataclass(frozen=True, eq=False)
class Pairs:
    """Beliefs about one relation, in order of the pair of objects.

    Attributes:
        first, second: ``(P,)`` objects, as places in ``Scene``.
        p: ``(P,)`` probability that the relation holds.
        looked: ``(P,)`` seconds for which both have been seen.
        stages: for each activity about this relation ``(P, S)``, the belief over its stages.
    """

    first: Ints
    second: Ints
    p: Floats
    looked: Floats
    stages: tuple[Floats, ...]


@dataclass(frozen=True, eq=False)
class GaussianPairs(Pairs):
    """Of the engine "collapsed".

    Attributes:
        counts, states: ``(P, 2)``, ``(H, 8)`` how many Gaussians over the relative state a pair has, unrelated and
            related, and these, pair after pair: relative position and velocity, their covariance (position, cross,
            velocity) and the probability of each.
    """

    counts: Ints
    states: Floats


@dataclass(frozen=True, eq=False)
class ParticlePairs(Pairs):
    """Of the engines with particles.

    Attributes:
        bits: ``(M, P)`` the relation in each particle.
    """

    bits: NDArray[np.bool_]

    def keep(self, rows: NDArray) -> ParticlePairs:
        """The pairs at ``rows`` (places or a mask)."""
        stages = tuple(s[rows] for s in self.stages)
        bits = np.ascontiguousarray(self.bits[:, rows])
        return ParticlePairs(self.first[rows], self.second[rows], self.p[rows], self.looked[rows], stages, bits)
