"""One step of the collapsed relational filter: objects by Kalman filters, each pair's relation summed out.

All axes share one covariance (noise is the same along each), kept as (position, cross, velocity). A motion is
(f01, f11, q00, q01, q11): x' = x + f01 v, v' = f11 v, and its noise.
"""

import math

import numpy as np

from wakefold.kernels.codes import FEATURES
from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.predicates import evaluate, features, switch

FLOOR = 1e-9  # a relation is never surer than this


@inner
def _predict(mean, cov, motion):
    f01, f11, q00, q01, q11 = motion[0], motion[1], motion[2], motion[3], motion[4]
    for k in range(mean.shape[1]):
        mean[0, k] += f01 * mean[1, k]
        mean[1, k] *= f11
    pp, pv, vv = cov[0], cov[1], cov[2]
    cov[0] = pp + 2.0 * f01 * pv + f01 * f01 * vv + q00
    cov[1] = f11 * (pv + f01 * vv) + q01
    cov[2] = f11 * f11 * vv + q11


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
    """Move n objects: ``mean`` (n, 2, d), ``cov`` (n, 3), in place, by ``motion`` (n, 5)."""
    for i in range(len(mean)):
        _predict(mean[i], cov[i], motion[i])


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


@inner
def _bin(edges, value):
    """The bin of ``value``; the last one for values beyond the edges, the first for values before."""
    i = 0
    while i < len(edges) - 2 and value >= edges[i + 1]:
        i += 1
    return i


@inner
def _log_ratio(u, w, va, vb, distances, differences, speeds, table):
    """What the looks of a pair say for its being related, nats per second."""
    d2 = w2 = a2 = b2 = 0.0
    for k in range(len(u)):
        d2 += u[k] * u[k]
        w2 += w[k] * w[k]
        a2 += va[k] * va[k]
        b2 += vb[k] * vb[k]
    i, j = _bin(distances, math.sqrt(d2)), _bin(differences, math.sqrt(w2))
    return table[i, j, _bin(speeds, 0.5 * (math.sqrt(a2) + math.sqrt(b2)))]


@kernel
def log_ratios(u, w, va, vb, distances, differences, speeds, table, out):
    """``_log_ratio`` of n pairs, ``u, w, va, vb`` (n, d)."""
    for i in range(len(u)):
        out[i] = _log_ratio(u[i], w[i], va[i], vb[i], distances, differences, speeds, table)


@inner
def _mix(mean, cov, to, other, share):
    """Moments of (1 - share) of mode ``to`` and ``share`` of ``other``, into ``new_mean``, ``new_cov``."""
    keep, spread_pp, spread_pv, spread_vv = 1.0 - share, 0.0, 0.0, 0.0
    d = mean.shape[2]
    for k in range(d):
        x, v = mean[other, 0, k] - mean[to, 0, k], mean[other, 1, k] - mean[to, 1, k]
        spread_pp += x * x
        spread_pv += x * v
        spread_vv += v * v
    scale = share * keep / d
    return (
        keep * cov[to, 0] + share * cov[other, 0] + scale * spread_pp,
        keep * cov[to, 1] + share * cov[other, 1] + scale * spread_pv,
        keep * cov[to, 2] + share * cov[other, 2] + scale * spread_vv,
    )


@inner
def _exchange(mean, cov, to_off, to_on):
    """Modes after a switch: ``to_off``, share of the new mode 0 that was in mode 1 before, ``to_on`` the other way."""
    off = _mix(mean, cov, 0, 1, to_off)
    on = _mix(mean, cov, 1, 0, to_on)
    for i in range(mean.shape[1]):
        for k in range(mean.shape[2]):
            a, b = mean[0, i, k], mean[1, i, k]
            mean[0, i, k] = a + to_off * (b - a)
            mean[1, i, k] = b + to_on * (a - b)
    for j in range(3):
        cov[0, j], cov[1, j] = off[j], on[j]


@kernel
def step(
    first, second, p, mean, cov, z, variance, seen, known, objects, spread,
    motions, coupled, rates, dt, ops, numbers, distances, differences, speeds, table,
    before, on, off,
):  # fmt: skip
    """Beliefs about P pairs after ``dt`` seconds and the detections of both objects, in place.

    A pair is a switching linear system of two modes, unrelated (0) and related (1), over its relative state (second
    minus first), filtered as interacting multiple models (Blom and Bar-Shalom 1988) in the order of Eq. 1: objects move
    as they were related before, are seen, and then the relation changes as they are now.

    Args:
        first, second: (P,) objects.
        p: (P,) probability of the relation.
        mean, cov: (P, 2, 2, d), (P, 2, 3) relative state in both modes.
        z, variance, seen: (n, d), (n,), (n,) detection of each object, its variance, whether there is one.
        known: (n,) whether an object was seen lately.
        objects, spread: (n, 2, d), (n, 3) the objects' own filters, after the detections.
        motions: (2, 5) of the relative state in both modes.
        coupled: whether the motions differ.
        rates, ops, numbers: of the relation; no operations: the predicate always holds.
        distances, differences, speeds, table: of its evidence; an empty table: none.
        before, on, off: (P,) out: probability before the switch, and of switching on and off.
    """
    d = z.shape[1]
    away, f, stack = np.empty(d), np.empty(FEATURES), np.empty(max(len(ops), 1))
    holds = np.ones(2)
    for i in range(len(first)):
        a, b = first[i], second[i]
        m, c = mean[i], cov[i]
        _predict(m[0], c[0], motions[0])
        if coupled:
            _predict(m[1], c[1], motions[1])
        log_odds = 0.0
        if seen[a] and seen[b]:
            for k in range(d):
                away[k] = z[b, k] - z[a, k]
            square, s = _innovation(m[0], c[0], away, variance[a] + variance[b])
            _update(m[0], c[0], away, s)
            if coupled:
                square_on, s_on = _innovation(m[1], c[1], away, variance[a] + variance[b])
                _update(m[1], c[1], away, s_on)
                log_odds = 0.5 * (square - square_on + d * math.log(s / s_on))
            if table.size > 0:
                log_odds += dt * _log_ratio(
                    m[0, 0], m[0, 1], objects[a, 1], objects[b, 1], distances, differences, speeds, table
                )
        prior = p[i]
        if log_odds != 0.0:
            ratio = math.exp(min(max(log_odds, -50.0), 50.0))
            prior = prior * ratio / (prior * ratio + 1.0 - prior)
            prior = min(max(prior, FLOOR), 1.0 - FLOOR)
        both = known[a] and known[b]
        if len(ops) > 0 and both:
            for mode in range(2 if coupled else 1):
                # a mode that is all but excluded switches as the other does
                if coupled and (prior if mode == 1 else 1.0 - prior) < 1e-6:
                    continue
                features(
                    m[mode, 0], m[mode, 1], c[mode, 0], c[mode, 2], objects[a, 1], objects[b, 1],
                    spread[a, 2], spread[b, 2], 1.0, f,
                )  # fmt: skip
                holds[mode] = evaluate(ops, numbers, f, d, stack)
            if not coupled or prior < 1e-6:
                holds[1] = holds[0]
            elif 1.0 - prior < 1e-6:
                holds[0] = holds[1]
        turn_on, _ = switch(holds[0], both, rates, dt)
        _, turn_off = switch(holds[1], both, rates, dt)
        after = prior * (1.0 - turn_off) + (1.0 - prior) * turn_on
        after = min(max(after, FLOOR), 1.0 - FLOOR)
        if coupled:
            to_off, to_on = prior * turn_off / (1.0 - after), (1.0 - prior) * turn_on / after
            if to_off > 1e-9 or to_on > 1e-9:
                _exchange(m, c, min(to_off, 1.0), min(to_on, 1.0))
        p[i] = after
        before[i], on[i], off[i] = prior, turn_on, turn_off


@kernel
def hidden(first, second, p, mean, cov, unseen, objects, spread, weight, out_mean, out_cov):
    """Where related objects that are seen put a hidden one: weighted sums over its pairs, into the outputs.

    Args:
        p, mean, cov: (P,), (P, 2, 2, d), (P, 2, 3) as in ``step``.
        unseen: (n,) whether an object is hidden.
        objects, spread: (n, 2, d), (n, 3) the objects' own filters.
        weight: (n, 2) out: sum of the probabilities of relations to seen objects; log probability that none holds.
        out_mean, out_cov: (n, 2, d), (n, 2, 2) out: sums of mean, and of second moments averaged over the axes.
    """
    d = mean.shape[3]
    for i in range(len(first)):
        a, b = first[i], second[i]
        if unseen[a] == unseen[b]:
            continue
        h, o, sign = (b, a, 1.0) if unseen[b] else (a, b, -1.0)
        w = p[i]
        weight[h, 0] += w
        weight[h, 1] += math.log1p(-w)
        pp = pv = vv = 0.0
        for k in range(d):
            x = objects[o, 0, k] + sign * mean[i, 1, 0, k]
            v = objects[o, 1, k] + sign * mean[i, 1, 1, k]
            out_mean[h, 0, k] += w * x
            out_mean[h, 1, k] += w * v
            # about the hidden object's own estimate, so that large coordinates cost no digits
            x -= objects[h, 0, k]
            v -= objects[h, 1, k]
            pp += x * x
            pv += x * v
            vv += v * v
        out_cov[h, 0, 0] += w * (pp / d + spread[o, 0] + cov[i, 1, 0])
        out_cov[h, 0, 1] += w * (pv / d + spread[o, 1] + cov[i, 1, 1])
        out_cov[h, 1, 1] += w * (vv / d + spread[o, 2] + cov[i, 1, 2])
