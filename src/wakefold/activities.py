"""Activities: how far along its chain each pair is, from the probabilities of the relation in the chain.

A pair goes through stages: apart (before), related for a first, second, ... part of the least time, related long
enough, and apart (after). The stages refine the relation's two states, so the belief over them follows from what a
filter says at each step: the probability of the relation, and of its switching on and off.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wakefold.relations import Activity

Floats = NDArray[np.float64]
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
    out = stages.copy()
    related = slice(1, DONE + 1)
    held = out[:, related].sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        out[:, related] *= np.where(held > 0.0, before / held, 0.0)[:, None]
        apart = np.where(held < 1.0, (1.0 - before) / (1.0 - held), 0.0)
    out[:, BEFORE] *= apart
    out[:, AFTER] *= apart
    fresh = np.where(held > 0.0, 0.0, before)  # what was seen now says it, and nothing before did
    out[:, 1] += fresh
    out[:, related] = _longer(out[:, related], PARTS * dt / activity.min_time if activity.min_time > 0 else math.inf)
    ended, resumed = out[:, related] * off[:, None], out[:, AFTER] * on
    started = out[:, BEFORE] * on
    out[:, related] -= ended
    out[:, BEFORE] += ended[:, :-1].sum(axis=1) - started
    out[:, AFTER] += ended[:, -1] - resumed
    out[:, 1] += started
    out[:, DONE] += resumed
    np.maximum(out, 0.0, out=out)
    return out / out.sum(axis=1, keepdims=True)


def _longer(stages: Floats, parts: float) -> Floats:
    """Move ``(P, PARTS + 1)`` forward by ``parts``, a fraction by chance; the last stage keeps all."""
    whole = min(int(parts), PARTS) if math.isfinite(parts) else PARTS
    fraction = 0.0 if whole == PARTS else parts - whole
    out = np.zeros_like(stages)
    for shift, weight in ((whole, 1.0 - fraction), (whole + 1, fraction)):
        if weight > 0.0:
            out[:, shift:-1] += weight * stages[:, : max(PARTS - shift, 0)]
            out[:, -1] += weight * stages[:, max(PARTS - shift, 0) :].sum(axis=1)
    return out


def phases(stages: Floats) -> Floats:
    """``(P, 3)`` probabilities of before, during and after the relation (after: once it has lasted long enough)."""
    return np.column_stack([stages[:, BEFORE], stages[:, 1 : DONE + 1].sum(axis=1), stages[:, AFTER]])


def taken_place(stages: Floats) -> Floats:
    """``(P,)`` probability that the relation has lasted the least time."""
    return stages[:, DONE] + stages[:, AFTER]
