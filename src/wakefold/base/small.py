"""Small linear algebra and elementary functions that give the same bits on every processor.

BLAS and LAPACK pick another kernel, and numpy other vector instructions, on another processor: a last digit changes,
the signs of eigenvectors flip, and a particle is drawn otherwise. These sum in one order, in code compiled without
fused operations (docs/design.md, The same on every processor).
"""

import math

import numpy as np

from wakefold.base.compile import inner, kernel

SINGULAR = 1e-14  # share of a variance below which what is left of it, given those before, is rounding
TERMS = 26  # of series of matrices of norm 1: those left out are below 1e-18


@kernel
def _exp(x):
    for i in range(len(x)):
        x[i] = math.exp(x[i])


@kernel
def _log(x):
    for i in range(len(x)):
        x[i] = math.log(x[i])


@kernel
def _power(x, exponent):
    for i in range(len(x)):
        x[i] = x[i] ** exponent


def exp(x):
    """Exponentials of an array of any shape."""
    out = np.array(x, dtype=np.float64, order="C")
    _exp(out.reshape(-1))
    return out


def log(x):
    """Natural logarithms of an array of any shape; -inf of 0, without a warning."""
    out = np.array(x, dtype=np.float64, order="C")
    _log(out.reshape(-1))
    return out


def power(x, exponent):
    """An array of any shape to a power."""
    out = np.array(x, dtype=np.float64, order="C")
    _power(out.reshape(-1), float(exponent))
    return out


@kernel
def mean(weights, points):
    """Weighted sum (d,) of points (n, d)."""
    out = np.zeros(points.shape[1])
    for i in range(len(points)):
        for k in range(points.shape[1]):
            out[k] += weights[i] * points[i, k]
    return out


@kernel
def covariance(weights, points, centre):
    """Weighted sum (d, d) of the squares of points (n, d) about a centre (d,)."""
    d = points.shape[1]
    out = np.zeros((d, d))
    for i in range(len(points)):
        for j in range(d):
            off = weights[i] * (points[i, j] - centre[j])
            for k in range(j + 1):
                out[j, k] += off * (points[i, k] - centre[k])
    for j in range(d):
        for k in range(j):
            out[k, j] = out[j, k]
    return out


@kernel
def times(x, w):
    """Products (n,) of rows x (n, k) with w (k,)."""
    out = np.empty(len(x))
    for i in range(len(x)):
        total = 0.0
        for k in range(x.shape[1]):
            total += x[i, k] * w[k]
        out[i] = total
    return out


@kernel
def solve(a, b):
    """x (k,) of a x = b, ``a`` (k, k) symmetric and positive definite."""
    size = len(b)
    root, x = np.empty((size, size)), b.copy()
    for j in range(size):
        for k in range(j + 1):
            total = a[j, k]
            for m in range(k):
                total -= root[j, m] * root[k, m]
            root[j, k] = math.sqrt(total) if j == k else total / root[k, k]
        for m in range(j):
            x[j] -= root[j, m] * x[m]
        x[j] /= root[j, j]
    for j in range(size - 1, -1, -1):
        for m in range(j + 1, size):
            x[j] -= root[m, j] * x[m]
        x[j] /= root[j, j]
    return x


@inner
def root(cov, out):
    """Lower triangular ``out`` (D, D) with ``out out' = cov``, which may be singular."""
    size = len(cov)
    for j in range(size):
        for k in range(j, size):
            total = cov[k, j]
            for m in range(j):
                total -= out[j, m] * out[k, m]
            out[j, k] = 0.0
            if k == j:
                out[j, j] = math.sqrt(total) if total > SINGULAR * cov[j, j] else 0.0
            else:
                out[k, j] = total / out[j, j] if out[j, j] > 0.0 else 0.0


@inner
def transform(x, c, f, q, out_x, out_c, work):
    """A Gaussian moved: ``out_x = f x`` (D, d), ``out_c = f c f' + q`` (D, D); ``work`` (D, D) is written over."""
    size = len(f)
    for i in range(size):
        for k in range(x.shape[1]):
            total = 0.0
            for j in range(size):
                total += f[i, j] * x[j, k]
            out_x[i, k] = total
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += f[i, k] * c[k, j]
            work[i, j] = total
    for i in range(size):
        for j in range(i + 1):
            total = q[i, j]
            for k in range(size):
                total += work[i, k] * f[j, k]
            out_c[i, j] = out_c[j, i] = total


@inner
def _product(a, b):
    out = np.zeros((len(a), b.shape[1]))
    for i in range(len(a)):
        for k in range(len(b)):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@kernel
def transition(drag, pull, diffusion, dt):
    """``couplings.transition``: both results (2n, 2n), ``dt`` above 0.

    The series of exp(a t) and of the integral of exp(a s) g exp(a s)' over a time h, in which velocities times h are
    the state so that ``a`` has norm 1 at most; then h is doubled up to ``dt``.
    """
    n = len(drag)
    fast, near = 0.0, 0.0
    for i in range(n):
        rate = draw = 0.0
        for j in range(n):
            rate += abs(drag[i, j])
            draw += abs(pull[i, j])
        fast, near = max(fast, rate), max(near, draw)
    doublings, h = 0, dt
    while fast * h > 0.5 or near * h * h > 0.5:
        doublings, h = doublings + 1, 0.5 * h
    a, g = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    for i in range(n):
        a[i, n + i] = 1.0
        for j in range(n):
            a[n + i, j], a[n + i, n + j] = -pull[i, j] * h * h, -drag[i, j] * h
            g[n + i, n + j] = diffusion[i, j] * h * h * h
    f, term, q = np.eye(2 * n), np.eye(2 * n), g.copy()
    for k in range(1, TERMS):
        term, g = _product(a, term) / k, _product(a, g) / (k + 1)  # ``g`` is symmetric: the other half is its transpose
        for i in range(2 * n):
            for j in range(i + 1):
                g[i, j] = g[j, i] = g[i, j] + g[j, i]
        f += term
        q += g
    for _ in range(doublings):
        q += _product(_product(f, q), f.T)
        f = _product(f, f)
    for i in range(n):
        for j in range(n):
            f[i, n + j] *= h
            f[n + i, j] /= h
            q[i, n + j] /= h
            q[n + i, j] /= h
            q[n + i, n + j] /= h * h
    for i in range(2 * n):
        for j in range(i):
            q[i, j] = q[j, i] = 0.5 * (q[i, j] + q[j, i])
    return f, q
