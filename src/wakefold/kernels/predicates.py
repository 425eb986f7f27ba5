"""Predicates about two objects, as small postfix programs over what is believed of the two.

A predicate is the probability, under the Gaussian belief about the objects, that a statement holds. With no variance
(sampled objects) it is 0 or 1.
"""

import math

import numpy as np

from wakefold.kernels.codes import AHEAD, AND, CLOSING, NEAR, NOT, OR, SAME_VELOCITY, SLOW, UNLESS
from wakefold.kernels.compile import inner, kernel


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
def evaluate(ops, numbers, ux, uy, wx, wy, var, var_v, ax, ay, bx, by, var_a, var_b, seen, stack):
    """Probability that a program's statement holds; conjuncts are taken as independent.

    Args:
        ops: (n,) operations in postfix order.
        numbers: (n, 2) their constants.
        ux, uy, wx, wy: relative position and velocity, second minus first; var, var_v: their variances per axis.
        ax, ay, bx, by: velocities of the first and the second; var_a, var_b: their variances per axis.
        seen: whether both are seen.
        stack: (n,) to work on.
    """
    top, i = -1, 0
    while i < len(ops):
        op, number = ops[i], numbers[i, 0]
        i += 1
        if op == UNLESS:  # what follows cannot change this value: leave it out
            if stack[top] == numbers[i - 1, 1]:
                i += int(number)
            continue
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
            stack[top] = ball(ux * ux + uy * uy, var, number)
        elif op == SAME_VELOCITY:
            stack[top] = ball(wx * wx + wy * wy, var_v, number)
        elif op == SLOW:
            stack[top] = ball(ax * ax + ay * ay, var_a, number) * ball(bx * bx + by * by, var_b, number)
        elif op == AHEAD:
            speed = math.sqrt(ax * ax + ay * ay)
            along = (ux * ax + uy * ay) / speed if speed > 0.0 else 0.0
            beside = math.sqrt(max(ux * ux + uy * uy - along * along, 0.0))
            stack[top] = 1.0 if 0.0 < along <= number and beside <= numbers[i - 1, 1] else 0.0
        elif op == CLOSING:
            distance = math.sqrt(ux * ux + uy * uy)
            stack[top] = 1.0 if distance > 0.0 and -(ux * wx + uy * wy) >= number * distance else 0.0
        else:
            stack[top] = 1.0 if seen else 0.0
    return stack[0]


@kernel
def truth(ops, numbers, u, w, var, var_v, va, vb, var_a, var_b, seen, out):
    """``evaluate`` for n pairs, into ``out``: ``u, w, va, vb`` (n, 2), the others (n,)."""
    stack = np.empty(max(len(ops), 1))
    for i in range(len(u)):
        out[i] = 1.0
        if len(ops) > 0:
            out[i] = evaluate(
                ops, numbers, u[i, 0], u[i, 1], w[i, 0], w[i, 1], var[i], var_v[i], va[i, 0], va[i, 1], vb[i, 0],
                vb[i, 1], var_a[i], var_b[i], seen[i], stack,
            )  # fmt: skip
