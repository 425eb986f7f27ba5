"""Activities: how far along its chain each pair is, from the probabilities of the relation in the chain.

A pair goes through stages: apart (before), related for a first, second, ... part of the least time, related long
enough, and apart (after). The stages refine the relation's two states, so the belief over them follows from what a
filter says at each step: the probability of the relation, and of its switching on and off.
"""

from __future__ import annotations

import math

import numpy as np

from wakefold.base.types import Floats
from wakefold.relations.kernels import stages as kernel
from wakefold.relations.model import Activity

PARTS = 32  # of the least time: it is measured to 1 / sqrt(32) of itself or better
BEFORE, DONE, AFTER = 0, PARTS + 1, PARTS + 2
STAGES = PARTS + 3


def begin(p: Floats) -> Floats:
    """``(P, STAGES)`` belief about new pairs of which the relation has probability ``p (P,)``."""
    out = np.zeros((len(p), STAGES))
    out[:, BEFORE], out[:, 1] = 1.0 - p, p
    return out


def advance(stages: Floats, before: Floats, on: Floats, off: Floats, dt: float, activity: Activity) -> Floats:
    """The belief over stages after a step.

    Args:
        stages: ``(P, STAGES)``, rows sum to 1.
        before: ``(P,)`` probability of the relation of before, given what was seen now.
        on, off: ``(P,)`` probabilities that it has switched since.
        dt: seconds.
    """
    parts = PARTS * dt / activity.min_time if activity.min_time > 0 else math.inf
    whole = int(parts) if parts < PARTS else PARTS
    out = np.empty_like(stages)
    kernel.advance(stages, before, on, off, whole, parts - whole if whole < PARTS else 0.0, out)
    return out


def phases(stages: Floats) -> Floats:
    """``(P, 3)`` probabilities of before, during and after the relation (after: once it has lasted long enough)."""
    return np.column_stack([stages[:, BEFORE], stages[:, 1 : DONE + 1].sum(axis=1), stages[:, AFTER]])


def taken_place(stages: Floats) -> Floats:
    """``(P,)`` probability that the relation has lasted the least time."""
    return stages[:, DONE] + stages[:, AFTER]
