"""Predicates about two objects, as small programs over what is believed of the two.

A program runs over a Gaussian of a pair, a row as in ``regions``. What a statement asks for, one part after the other,
narrows the Gaussian, and the next part is asked of that; ``BEGIN`` keeps the Gaussian as it is, and at ``NOT`` it
becomes that in which what was asked since does not hold. "a or b" is "not (not a and not b)".
"""

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.relations.kernels.codes import AHEAD, BEGIN, CLOSING, NEAR, NOT, SAME_VELOCITY, SLOW
from wakefold.relations.kernels.regions import LEAST, both_slow, in_front, nearing, within

NEVER = 1e-12  # what is less probable is taken to be impossible


@inner
def blend(g, inside, t, to):
    """The Gaussian ``g`` with a share ``t`` of what it is ``inside`` a region, into ``to``; with t < 0 that outside.

    ``to`` may be one of the two. With T = g_o + (g_i - g_o) P the chance of an outcome that is g_i inside and g_o
    outside, t = (g_i - g_o) P / T gives the mean and the covariance, averaged over the axes, given the outcome.
    """
    if t == 0.0:
        for k in range(7):
            to[k] = g[k]
        return
    d0, d1, d2, d3 = inside[0] - g[0], inside[1] - g[1], inside[2] - g[2], inside[3] - g[3]
    s = 0.5 * t * (1.0 - t)
    pp = max(g[4] + t * (inside[4] - g[4]) + s * (d0 * d0 + d1 * d1), LEAST * g[4])
    vv = max(g[6] + t * (inside[6] - g[6]) + s * (d2 * d2 + d3 * d3), LEAST * g[6])
    most = 0.999 * math.sqrt(max(pp * vv, 0.0))
    pv = min(max(g[5] + t * (inside[5] - g[5]) + s * (d0 * d2 + d1 * d3), -most), most)
    to[0], to[1], to[2], to[3] = g[0] + t * d0, g[1] + t * d1, g[2] + t * d2, g[3] + t * d3
    to[4], to[5], to[6] = pp, pv, vv


@inner
def evaluate(ops, numbers, g, own, seen, kept):
    """Probability that a program's statement holds; ``g`` given that it does, in place (if that is possible).

    Args:
        ops: (n,) operations; numbers: (n, 2) their constants.
        g, own: a Gaussian of a pair, and of the two: see ``regions``.
        seen: whether both were seen lately.
        kept: (depth, 8) to work on: Gaussians as they were at ``BEGIN``, and probabilities up to there.
    """
    depth, p, at = 0, 1.0, 0
    while at < len(ops):
        op, number = ops[at], numbers[at, 0]
        if op == BEGIN:
            for k in range(7):
                kept[depth, k] = g[k]
            kept[depth, 7] = p
            depth += 1
            p = 1.0
        elif op == NOT:
            depth -= 1
            before = kept[depth]
            if p < 1.0:
                blend(before, g, -p / (1.0 - p), g)
            p = before[7] * (1.0 - p)
        elif op == NEAR:
            p *= within(g, 0, number)
        elif op == SAME_VELOCITY:
            p *= within(g, 2, number)
        elif op == SLOW:
            p *= both_slow(g, own, number)
        elif op == AHEAD:
            p *= in_front(g, own, number, numbers[at, 1])
        elif op == CLOSING:
            p *= nearing(g, number)
        elif not seen:
            p = 0.0
        at += 1
        if p <= NEVER:  # the rest does not matter, up to the next ``NOT`` that belongs to it
            p, deeper = 0.0, 0
            while at < len(ops) and (deeper > 0 or ops[at] != NOT):
                deeper += (ops[at] == BEGIN) - (ops[at] == NOT)
                at += 1
    return p


@inner
def chance_of(way, yes, known, chances):
    """Of a switch on (``way`` 0) or off (1) where the predicate holds with probability ``yes``.

    Args:
        known: whether both objects were seen lately.
        chances: (3, 2) of switching on and off where the predicate holds, where not, and where unknown.
    """
    return yes * chances[0, way] + (1.0 - yes) * chances[1, way] if known else chances[2, way]


@inner
def shift_of(way, turned, yes, known, chances):
    """Share ``t`` of ``blend`` of an outcome: that a Gaussian has ``turned``, or has not."""
    if not known:
        return 0.0
    inside, outside = chances[0, way], chances[1, way]
    if not turned:
        inside, outside = 1.0 - inside, 1.0 - outside
    total = outside + (inside - outside) * yes
    return (inside - outside) * yes / total if total > 0.0 else 0.0


@inner
def own_of(a, b, mean, cov, own):
    """What ``regions`` asks of objects ``a`` and ``b`` themselves, from (n, 2, 2), (n, 3), into ``own`` (8,)."""
    own[0], own[1], own[2], own[3] = mean[a, 1, 0], mean[a, 1, 1], mean[b, 1, 0], mean[b, 1, 1]
    own[4], own[5], own[6], own[7] = cov[a, 1], cov[a, 2], cov[b, 1], cov[b, 2]


@inner
def asks_own(ops):
    """Whether a program asks for velocities of the objects themselves."""
    asked = False
    for op in ops:
        asked = asked or op in (SLOW, AHEAD)
    return asked


@inner
def reach_of(ops, numbers):
    """How far apart two may be of whom a program's first statement holds; 0 where it does not say."""
    if len(ops) > 0 and ops[0] == NEAR:
        return numbers[0, 0]
    if len(ops) > 0 and ops[0] == AHEAD:
        return math.sqrt(numbers[0, 0] ** 2 + numbers[0, 1] ** 2)
    return 0.0


@inner
def depth_of(ops):
    """How many Gaussians a program keeps at most; at least 1."""
    deep = most = 0
    for op in ops:
        deep += (op == BEGIN) - (op == NOT)
        most = max(most, deep)
    return max(most, 1)


@kernel
def truth(program, pairs, relative, objects, known, out):
    """Probability that a program's statement holds of P pairs, into ``out``; 1 where the program is empty.

    Args:
        program: operations and their constants.
        pairs: (P,), (P,) objects; relative: (P, 2, 2), (P, 3) their relative states.
        objects: (n, 2, 2), (n, 3) the objects' own; known: (n,) whether they were seen lately.
    """
    (ops, numbers), (first, second), (u, spread), (mean, cov) = program, pairs, relative, objects
    g, own, kept = np.empty(7), np.empty(8), np.empty((depth_of(ops), 8))
    for i in range(len(first)):
        a, b = first[i], second[i]
        g[0], g[1], g[2], g[3] = u[i, 0, 0], u[i, 0, 1], u[i, 1, 0], u[i, 1, 1]
        g[4], g[5], g[6] = spread[i, 0], spread[i, 1], spread[i, 2]
        own_of(a, b, mean, cov, own)
        out[i] = evaluate(ops, numbers, g, own, known[a] and known[b], kept)
