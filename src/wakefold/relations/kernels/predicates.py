"""Predicates about two objects, as small postfix programs over what is believed of the two.

A predicate is the probability, under the Gaussian belief about the objects, that a statement holds. With no variance
(sampled objects) it is 0 or 1.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.compile import inner, kernel
from wakefold.relations.kernels.codes import AHEAD, AND, CLOSING, NEAR, NOT, OR, SAME_VELOCITY, SLOW, UNLESS

AT_ONCE = 64  # pairs: a program is interpreted once for so many of them
FEATURES = 13


class Features(NamedTuple):
    """Of n pairs what a program asks for, in the order of ``evaluate``.

    Attributes:
        u, w: (n, 2) position and velocity of the second object less those of the first.
        var, var_v: (n,) their variances per axis.
        va, vb: (n, 2) velocities of both.
        var_a, var_b: (n,) their variances per axis.
        seen: (n,) whether both were seen lately.
    """

    u: NDArray[np.float64]
    w: NDArray[np.float64]
    var: NDArray[np.float64]
    var_v: NDArray[np.float64]
    va: NDArray[np.float64]
    vb: NDArray[np.float64]
    var_a: NDArray[np.float64]
    var_b: NDArray[np.float64]
    seen: NDArray[np.bool_]


@inner
def ball(mean2, variance, radius):
    """Probability that a Gaussian point of the plane lies within ``radius`` of the origin.

    Args:
        mean2: squared length of its mean.
        variance: per axis.

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
    a, b = 2.0 + lam, 2.0 + 2.0 * lam
    h = 1.0 - 2.0 / 3.0 * a * (2.0 + 3.0 * lam) / (b * b)
    p = b / (a * a)
    m = (h - 1.0) * (1.0 - 3.0 * h)
    spread = h * math.sqrt(2.0 * p) * (1.0 + 0.5 * m * p)
    z = ((x / a) ** h - (1.0 + h * p * (h - 1.0 - 0.5 * (2.0 - h) * m * p))) / spread
    return 0.5 * math.erfc(-z * 0.7071067811865476)


@inner
def evaluate(ops, numbers, many, f, until, stack):
    """Probability that a program's statement holds of ``many`` pairs, into ``stack[0]``; conjuncts are independent.

    Args:
        ops: (n,) operations in postfix order.
        numbers: (n, 2) their constants.
        f: (FEATURES, AT_ONCE) of the pairs: relative position (0, 1) and velocity (2, 3), second minus first; their
            variances per axis (4, 5); velocity of the first (6, 7) and the second (8, 9); their variances (10, 11);
            whether both are seen (12).
        until: (AT_ONCE,) to work on: operations before this one are left out, as they cannot change the value.
        stack: (n, AT_ONCE) to work on.
    """
    until[:many] = 0
    top = -1
    for at in range(len(ops)):
        op, number, other = ops[at], numbers[at, 0], numbers[at, 1]
        if op == UNLESS:
            for i in range(many):
                if until[i] <= at and stack[top, i] == other:
                    until[i] = at + 1 + int(number)
            continue
        if op in (AND, OR):
            top -= 1
        elif op != NOT:
            top += 1
        for i in range(many):
            if until[i] > at:
                continue
            if op == NOT:
                stack[top, i] = 1.0 - stack[top, i]
            elif op == AND:
                stack[top, i] *= stack[top + 1, i]
            elif op == OR:
                stack[top, i] = 1.0 - (1.0 - stack[top, i]) * (1.0 - stack[top + 1, i])
            elif op == NEAR:
                stack[top, i] = ball(f[0, i] * f[0, i] + f[1, i] * f[1, i], f[4, i], number)
            elif op == SAME_VELOCITY:
                stack[top, i] = ball(f[2, i] * f[2, i] + f[3, i] * f[3, i], f[5, i], number)
            elif op == SLOW:
                first = ball(f[6, i] * f[6, i] + f[7, i] * f[7, i], f[10, i], number)
                stack[top, i] = first * ball(f[8, i] * f[8, i] + f[9, i] * f[9, i], f[11, i], number)
            elif op == AHEAD:
                ux, uy, ax, ay = f[0, i], f[1, i], f[6, i], f[7, i]
                speed = math.sqrt(ax * ax + ay * ay)
                along = (ux * ax + uy * ay) / speed if speed > 0.0 else 0.0
                beside = math.sqrt(max(ux * ux + uy * uy - along * along, 0.0))
                stack[top, i] = 1.0 if 0.0 < along <= number and beside <= other else 0.0
            elif op == CLOSING:
                ux, uy, wx, wy = f[0, i], f[1, i], f[2, i], f[3, i]
                distance = math.sqrt(ux * ux + uy * uy)
                stack[top, i] = 1.0 if distance > 0.0 and -(ux * wx + uy * wy) >= number * distance else 0.0
            else:
                stack[top, i] = f[12, i]


@kernel
def truth(program, features, out):
    """Probability that a program's statement holds of n pairs, into ``out``; 1 where the program is empty."""
    (ops, numbers), (u, w, var, var_v, va, vb, var_a, var_b, seen) = program, features
    f, until = np.empty((FEATURES, AT_ONCE)), np.empty(AT_ONCE, dtype=np.int64)
    stack = np.empty((max(len(ops), 1), AT_ONCE))
    if len(ops) == 0:
        out[:] = 1.0
        return
    for lo in range(0, len(u), AT_ONCE):
        many = min(AT_ONCE, len(u) - lo)
        for i in range(many):
            k = lo + i
            f[0, i], f[1, i], f[2, i], f[3, i], f[4, i], f[5, i] = u[k, 0], u[k, 1], w[k, 0], w[k, 1], var[k], var_v[k]
            f[6, i], f[7, i], f[8, i], f[9, i] = va[k, 0], va[k, 1], vb[k, 0], vb[k, 1]
            f[10, i], f[11, i], f[12, i] = var_a[k], var_b[k], 1.0 if seen[k] else 0.0
        evaluate(ops, numbers, many, f, until, stack)
        out[lo : lo + many] = stack[0, :many]
