"""Predicates about two objects, as small postfix programs over a row of pair features.

A feature is a number computed from the two objects' positions and velocities; a predicate is the probability, under
the Gaussian belief about the objects, that a statement holds. With no variance (sampled objects) it is 0 or 1.
"""

import math

import numpy as np

from wakefold.kernels.codes import (
    AHEAD,
    ALONG,
    AND,
    BESIDE,
    BOTH_SEEN,
    CLOSING,
    DIST2,
    FEATURES,
    FIRST2,
    NEAR,
    NOT,
    OPENING,
    OR,
    SAME_VELOCITY,
    SECOND2,
    SLOW,
    SPEED2,
    VAR,
    VAR_1,
    VAR_2,
    VAR_V,
)
from wakefold.kernels.compile import inner, kernel


@inner
def ball(mean2, variance, radius, d):
    """Probability that a Gaussian point lies within ``radius`` of the origin.

    Args:
        mean2: squared length of its mean.
        variance: per axis, of ``d`` axes.

    The non-central chi-squared law by Sankaran (Biometrika 1963, 50: 199-204), good to .005; beyond five standard
    deviations 0 or 1.
    """
    if variance <= 0.0:
        return 1.0 if mean2 <= radius * radius else 0.0
    away = math.sqrt(mean2) - radius
    if away * abs(away) > 25.0 * variance:
        return 0.0
    if away * abs(away) < -25.0 * variance:
        return 1.0
    lam, x = mean2 / variance, radius * radius / variance
    a, b = d + lam, d + 2.0 * lam
    h = 1.0 - 2.0 / 3.0 * a * (d + 3.0 * lam) / (b * b)
    p = b / (a * a)
    m = (h - 1.0) * (1.0 - 3.0 * h)
    z = ((x / a) ** h - (1.0 + h * p * (h - 1.0 - 0.5 * (2.0 - h) * m * p))) / (
        h * math.sqrt(2.0 * p) * (1.0 + 0.5 * m * p)
    )
    return 0.5 * math.erfc(-z * 0.7071067811865476)


@inner
def evaluate(ops, numbers, f, d, stack):
    """Probability that a program's statement holds, for features ``f`` (12,); conjuncts are taken as independent.

    Args:
        ops: (n,) operations in postfix order.
        numbers: (n, 2) their constants.
        stack: (n,) to work on.
    """
    top = -1
    for i in range(len(ops)):
        op = ops[i]
        if op == NOT:
            stack[top] = 1.0 - stack[top]
            continue
        if op == AND:
            top -= 1
            stack[top] *= stack[top + 1]
            continue
        if op == OR:
            top -= 1
            stack[top] = 1.0 - (1.0 - stack[top]) * (1.0 - stack[top + 1])
            continue
        top += 1
        if op == NEAR:
            stack[top] = ball(f[DIST2], f[VAR], numbers[i, 0], d)
        elif op == SAME_VELOCITY:
            stack[top] = ball(f[SPEED2], f[VAR_V], numbers[i, 0], d)
        elif op == SLOW:
            stack[top] = ball(f[FIRST2], f[VAR_1], numbers[i, 0], d) * ball(f[SECOND2], f[VAR_2], numbers[i, 0], d)
        elif op == AHEAD:
            stack[top] = 1.0 if 0.0 < f[ALONG] <= numbers[i, 0] and f[BESIDE] <= numbers[i, 1] else 0.0
        elif op == CLOSING:
            stack[top] = 1.0 if -f[OPENING] >= numbers[i, 0] else 0.0
        else:
            stack[top] = f[BOTH_SEEN]
    return stack[0]


@inner
def features(u, w, var, var_v, va, vb, var_a, var_b, seen, f):
    """Fill ``f`` (12,) for one pair: relative position ``u`` and velocity ``w`` (second minus first), velocities."""
    d = len(u)
    f[DIST2] = f[SPEED2] = f[FIRST2] = f[SECOND2] = 0.0
    along = opening = 0.0
    for k in range(d):
        f[DIST2] += u[k] * u[k]
        f[SPEED2] += w[k] * w[k]
        f[FIRST2] += va[k] * va[k]
        f[SECOND2] += vb[k] * vb[k]
        along += u[k] * va[k]
        opening += u[k] * w[k]
    f[VAR], f[VAR_V], f[VAR_1], f[VAR_2] = var, var_v, var_a, var_b
    speed, distance = math.sqrt(f[FIRST2]), math.sqrt(f[DIST2])
    f[ALONG] = along / speed if speed > 0.0 else 0.0
    f[BESIDE] = math.sqrt(max(f[DIST2] - f[ALONG] * f[ALONG], 0.0))
    f[OPENING] = opening / distance if distance > 0.0 else 0.0
    f[BOTH_SEEN] = seen


@kernel
def truth(ops, numbers, u, w, var, var_v, va, vb, var_a, var_b, seen, out):
    """``evaluate`` for n pairs: ``u, w, va, vb`` (n, d), the others (n,)."""
    f, stack = np.empty(FEATURES), np.empty(len(ops))
    for i in range(len(u)):
        features(u[i], w[i], var[i], var_v[i], va[i], vb[i], var_a[i], var_b[i], seen[i], f)
        out[i] = evaluate(ops, numbers, f, u.shape[1], stack)


@inner
def switch(holds, known, rates, dt):
    """Probabilities that a relation comes to hold, and that it ceases, within ``dt`` seconds.

    Args:
        holds: probability of its predicate.
        known: whether both objects are seen.
        rates: (on, off, break, hidden), 1/s.
    """
    on = rates[0] * holds if known else 0.0
    off = rates[1] + rates[2] * (1.0 - holds) if known else rates[3]
    total = on + off
    if total <= 0.0:
        return 0.0, 0.0
    change = -math.expm1(-total * dt) / total
    return on * change, off * change


@kernel
def switches(ops, numbers, u, w, var, var_v, va, vb, var_a, var_b, seen, rates, dt, on, off):
    """``switch`` for n pairs with the features of ``truth``, into ``on`` and ``off`` (n,)."""
    f, stack = np.empty(FEATURES), np.empty(max(len(ops), 1))
    for i in range(len(u)):
        holds = 1.0
        if len(ops) > 0 and seen[i] > 0.0:
            features(u[i], w[i], var[i], var_v[i], va[i], vb[i], var_a[i], var_b[i], seen[i], f)
            holds = evaluate(ops, numbers, f, u.shape[1], stack)
        on[i], off[i] = switch(holds, seen[i] > 0.0, rates, dt)
