"""Which particles survive: systematic, stratified, multinomial and residual resampling."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from wakefold.base import small
from wakefold.base.types import Floats, Ints
from wakefold.filters.kernels import particles as kernel

Resampling = Literal["systematic", "stratified", "multinomial", "residual"]
SCHEMES: tuple[str, ...] = get_args(Resampling)


def resample(log_weights: Floats, u: Floats, scheme: Resampling) -> Ints:
    """Indices ``(N,)`` of the particles that survive, in rising order.

    Args:
        u: uniforms on [0, 1): one for "systematic", N for the others.
    """
    count = len(log_weights)
    if scheme == "residual":  # the whole parts are kept for certain, the rest is multinomial over the fractions
        weights = small.exp(log_weights - log_weights.max())
        weights *= count / weights.sum()
        sure = np.floor(weights + 1e-9).astype(np.int64)  # a weight of 1/N is worth one particle despite rounding
        rest = count - int(sure.sum())
        kept = np.repeat(np.arange(count), sure)[:count]
        if rest <= 0:
            return kept
        extra = _pick(small.log(np.maximum(weights - sure, 0.0)), np.sort(u[:rest]))
        return np.sort(np.concatenate([kept, extra]))
    if scheme == "multinomial":
        return _pick(log_weights, np.sort(u))
    return pick_strata(log_weights, u, count)


def _pick(log_weights: Floats, positions: Floats) -> Ints:
    out = np.empty(len(positions), dtype=np.int64)
    kernel.pick(log_weights, positions, out)
    return out


def pick_strata(log_weights: Floats, u: Floats, count: int) -> Ints:
    """Indices ``(count,)``, in rising order, one drawn in each stratum of the cumulated weights."""
    out = np.empty(count, dtype=np.int64)
    kernel.pick_strata(log_weights, u, out)
    return out
