"""Logistic regression, and log-odds."""

from __future__ import annotations

import numpy as np

from wakefold.base import small
from wakefold.base.types import Bools, Floats

ROUNDS, SLOPE = 100, 1e-6  # at which a regression ends: so many steps, or a loss so level


def log_odds(p: Floats) -> Floats:
    """Of probabilities, those nearer to 0 or 1 than a millionth taken to be there."""
    return small.log(np.maximum(p, 1e-6)) - small.log(np.maximum(1.0 - p, 1e-6))


def probability(z: Floats) -> Floats:
    """Of log-odds."""
    from scipy.special import expit

    return expit(z)


def logistic(x: Floats, y: Bools, importance: Floats, offset: Floats, ridge: float) -> Floats:
    """Weights of a penalised logistic regression of ``y (n,)`` on ``x (n, k)``; the last column is not penalised.

    Args:
        importance: ``(n,)`` weight of each row.
        offset: ``(n,)`` added to the log-odds.
        ridge: penalty on squared weights.
    """
    penalty = np.append(np.full(x.shape[1] - 1, ridge), 1e-9)
    x, none = np.ascontiguousarray(x), np.zeros(x.shape[1])

    def loss(w: Floats) -> tuple[float, Floats]:
        z = small.times(x, w) + offset
        return float((importance * np.logaddexp(0.0, np.where(y, -z, z))).sum() + 0.5 * (penalty * w * w).sum()), z

    w = none
    value, z = loss(w)
    for _ in range(ROUNDS):  # Newton's, half a step where a whole one goes too far: the loss is convex
        p = probability(z)
        slope = small.mean(importance * (p - y), x) + penalty * w
        if np.sqrt((slope * slope).sum()) < SLOPE:
            break
        curvature = small.covariance(importance * p * (1.0 - p), x, none) + np.diag(penalty)
        step, share, before = small.solve(curvature, slope), 1.0, value
        while True:
            value, z = loss(w - share * step)
            if value <= before or share < 1e-6:
                break
            share *= 0.5
        w = w - share * step
        if not value < before:
            break
    return w
