"""Logistic regression, and log-odds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def log_odds(p: Floats) -> Floats:
    """Of probabilities, those nearer to 0 or 1 than a millionth taken to be there."""
    return np.log(np.maximum(p, 1e-6)) - np.log(np.maximum(1.0 - p, 1e-6))


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
    from scipy.optimize import minimize

    penalty = np.append(np.full(x.shape[1] - 1, ridge), 1e-9)
    last, z, p, weighed = np.full(x.shape[1], np.nan), offset, offset, np.empty_like(x)

    def look(w: Floats) -> None:
        nonlocal last, z, p
        if not np.array_equal(w, last):  # the curvature is mostly asked for where the loss has been
            last, z = w.copy(), x @ w + offset
            p = probability(z)

    def loss(w: Floats) -> tuple[float, Floats]:
        look(w)
        value = (importance * np.logaddexp(0.0, np.where(y, -z, z))).sum() + 0.5 * (penalty * w * w).sum()
        return float(value), x.T @ (importance * (p - y)) + penalty * w

    def curvature(w: Floats) -> Floats:
        look(w)
        np.multiply(x, (importance * p * (1.0 - p))[:, None], out=weighed)
        return weighed.T @ x + np.diag(penalty)

    start = np.zeros(x.shape[1])
    return minimize(loss, start, jac=True, hess=curvature, method="trust-exact", options={"gtol": 1e-6}).x
