"""Objects one by one: a Kalman filter each, and the relative state of two.

All axes share one covariance (noise is the same along each), kept as (position, cross, velocity). A motion is
(f00, f01, f10, f11, q00, q01, q11): x' = f00 x + f01 v, v' = f10 x + f11 v, and its noise.
"""

import math

from wakefold.base.compile import inner, kernel


@inner
def _spread(c, k, motion):
    """Predict the covariance at ``c[k : k + 3]`` in place."""
    f00, f01, f10, f11 = motion[0], motion[1], motion[2], motion[3]
    pp, pv, vv = c[k], c[k + 1], c[k + 2]
    c[k] = f00 * f00 * pp + 2.0 * f00 * f01 * pv + f01 * f01 * vv + motion[4]
    c[k + 1] = f00 * f10 * pp + (f00 * f11 + f01 * f10) * pv + f01 * f11 * vv + motion[5]
    c[k + 2] = f10 * f10 * pp + 2.0 * f10 * f11 * pv + f11 * f11 * vv + motion[6]


@inner
def _innovation(mean, cov, z, variance):
    """Squared innovation over its variance, and that variance."""
    away = 0.0
    for k in range(len(z)):
        away += (z[k] - mean[0, k]) ** 2
    s = cov[0] + variance
    return away / s, s


@inner
def _update(mean, cov, z, s):
    """Kalman update by a position; ``s``: variance of the innovation."""
    g0, g1 = cov[0] / s, cov[1] / s
    for k in range(len(z)):
        away = z[k] - mean[0, k]
        mean[0, k] += g0 * away
        mean[1, k] += g1 * away
    pp, pv = cov[0], cov[1]
    cov[0] = (1.0 - g0) * pp
    cov[1] = (1.0 - g0) * pv
    cov[2] -= g1 * pv


@kernel
def predict(mean, cov, motion):
    """Move n objects: ``mean`` (n, 2, d), ``cov`` (n, 3), in place, by ``motion`` (n, 7)."""
    for i in range(len(mean)):
        for k in range(mean.shape[2]):
            x, v = mean[i, 0, k], mean[i, 1, k]
            mean[i, 0, k] = motion[i, 0] * x + motion[i, 1] * v
            mean[i, 1, k] = motion[i, 2] * x + motion[i, 3] * v
        _spread(cov[i], 0, motion[i])


@kernel
def update(mean, cov, which, z, variance):
    """Update objects ``which`` (m,) by positions ``z`` (m, d) in place; the log-likelihood of the positions."""
    total = 0.0
    for j in range(len(which)):
        i = which[j]
        square, s = _innovation(mean[i], cov[i], z[j], variance[j])
        total -= 0.5 * (square + z.shape[1] * math.log(2.0 * math.pi * s))
        _update(mean[i], cov[i], z[j], s)
    return total


@kernel
def difference(first, second, mean, cov, out_mean, out_cov):
    """Relative state of independent objects, second minus first: ``out_mean`` (P, 2, d), ``out_cov`` (P, 3)."""
    for i in range(len(first)):
        a, b = first[i], second[i]
        for j in range(2):
            for k in range(mean.shape[2]):
                out_mean[i, j, k] = mean[b, j, k] - mean[a, j, k]
        for j in range(3):
            out_cov[i, j] = cov[a, j] + cov[b, j]
