"""What the beliefs of some filters hold beside their base particles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints


@dataclass(frozen=True, eq=False)
class Stack(Remembers):
    """The coarse particle sets of one step: copies of base particles under their ancestors in use.

    Attributes:
        nodes: ``(A,)`` class ids; children before parents, leaves first (a leaf's set is its share of the base set).
        start: ``(A + 1,)`` first copy of each node.
        particle: ``(S,)`` base particle of each copy.
        copied: ``(N,)`` log-weights of the base particles when they were copied.
        factors: ``(A,)`` log-multiplier of each node's set since then.
        where: tells the positions of the copies; ``points`` asks it once.
    """

    nodes: Ints
    start: Ints
    particle: Ints
    copied: Floats
    factors: Floats
    where: Callable[[], Floats]

    @cached_property
    def points(self) -> Floats:
        """``(S, d)`` positions of the copies: worked out now, as they cost far more than the rest of a step."""
        return self.where()

    @cached_property
    def log_weights(self) -> Floats:
        """``(S,)`` log-weights of the copies."""
        sizes = self.start[1:] - self.start[:-1]  # np.diff takes 5 µs more
        return self.copied[self.particle] + np.repeat(self.factors, sizes)

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"where": partial(np.asarray, self.points)}  # not the model it asks


class Gaussians(NamedTuple):
    """What the particles of ``Calibrated`` carry beside the mean of their position, which is in ``points``.

    Attributes:
        covs: ``(N, d, d)`` covariance of the position, square metres.
        spreads: ``(N,)`` how far the agent is held to stray from its track, sd, metres.
        trust: ``(N, G)`` log-weights of the share of genuine reports at the nodes of the filter's prior.
    """

    covs: Floats
    spreads: Floats
    trust: Floats
