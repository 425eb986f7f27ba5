"""The papers' baselines: bootstrap particle filters without the hierarchy (Hawasly et al. 2016, Section 4)."""

from __future__ import annotations

from typing import Any

import numpy as np

from wakefold.evidence.fix import Fix
from wakefold.filters.belief import Belief, FieldBelief, TrackBelief
from wakefold.filters.kernels import particles as kernel
from wakefold.filters.particles import NOISE, Items, Kind, ParticleFilter
from wakefold.model.model import Model


class BL1(ParticleFilter[TrackBelief]):
    """Bootstrap filter of which each particle follows a single track.

    Args:
        coarse: weigh each particle by coarse evidence through its track's class at the level of the evidence
            ("BL1+coarse", the fair baseline). The published BL1 ignores coarse evidence, and counts what it ignored.

    The other arguments are those of ``ParticleFilter``.
    """

    kind = TrackBelief

    def __init__(self, model: Model, particles: int = 100, *, coarse: bool = False, **settings: Any) -> None:
        super().__init__(model, particles, **settings)
        self.coarse = coarse

    def _step(self, belief: Belief, items: Items, dt: float, now: float | None) -> TrackBelief:
        return _step(self, belief, items, dt, now, self.coarse)


class BL2(ParticleFilter[FieldBelief]):
    """Bootstrap filter of which all particles follow the averaged field of all tracks; ignores coarse evidence.

    The arguments are those of ``ParticleFilter``.
    """

    single, kind = False, FieldBelief

    def _step(self, belief: Belief, items: Items, dt: float, now: float | None) -> FieldBelief:
        return _step(self, belief, items, dt, now, coarse=False)


def _step(f: ParticleFilter[Kind], belief: Belief, items: Items, dt: float, now: float | None, coarse: bool) -> Kind:
    points, classes, logs = f._open(belief)
    f._roll(belief, NOISE, points, classes, dt)
    ignored, told = belief.ignored, []
    for level, item in items:
        if isinstance(item, Fix):
            gain, met = kernel.weigh(points, *f._fix(item), logs)
            if not met:
                points, classes = f._recover_fix(belief, item, classes, logs)
                logs = f._even.copy()
        elif coarse:
            gain = kernel.multiply(logs, f._coarse(item, level)[classes])
            met = gain > -np.inf
            if not met:
                classes = f._recover_class(belief, item, level)
                logs = f._even.copy()
        else:
            ignored += 1
            continue
        told.append((gain, not met))
    return f._after(belief, points, classes, logs, now, told, ignored=ignored)
