"""One step of the collapsed relational filter: objects by Kalman filters, each pair's relation summed out.

All axes share one covariance (noise is the same along each), kept as (position, cross, velocity). A motion is
(f00, f01, f10, f11, q00, q01, q11): x' = f00 x + f01 v, v' = f10 x + f11 v, and its noise.
"""

import math

import numpy as np

from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.predicates import AT_ONCE, FEATURES, evaluate

FLOOR = 1e-9  # a relation is never surer than this
SURE = 1e-6  # a mode less probable is not asked whether the predicate holds


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


@inner
def _bin(edges, value):
    """The bin of ``value``; the last one for values beyond the edges, the first for values before."""
    i = 0
    while i < len(edges) - 2 and value >= edges[i + 1]:
        i += 1
    return i


@inner
def _log_ratio(ux, uy, wx, wy, ax, ay, bx, by, distances, differences, speeds, table):
    """What the looks of a pair say for its being related, nats per second; arguments as in ``evaluate``."""
    i = _bin(distances, math.sqrt(ux * ux + uy * uy))
    j = _bin(differences, math.sqrt(wx * wx + wy * wy))
    return table[i, j, _bin(speeds, 0.5 * (math.sqrt(ax * ax + ay * ay) + math.sqrt(bx * bx + by * by)))]


@kernel
def log_ratios(u, w, va, vb, distances, differences, speeds, table, out):
    """``_log_ratio`` of n pairs, ``u, w, va, vb`` (n, 2)."""
    for i in range(len(u)):
        out[i] = _log_ratio(
            u[i, 0], u[i, 1], w[i, 0], w[i, 1], va[i, 0], va[i, 1], vb[i, 0], vb[i, 1],
            distances, differences, speeds, table,
        )  # fmt: skip


@inner
def _exchange(x, c, to_off, to_on):
    """Moments of both modes of a pair after a switch, in place.

    Args:
        x, c: (8,), (6,) state and covariance of mode 0, then of mode 1.
        to_off: share of the new mode 0 that was in mode 1 before; to_on: the other way round.
    """
    px, py, vx, vy = x[4] - x[0], x[5] - x[1], x[6] - x[2], x[7] - x[3]
    pp, pv, vv = 0.5 * (px * px + py * py), 0.5 * (px * vx + py * vy), 0.5 * (vx * vx + vy * vy)
    s, t = to_off * (1.0 - to_off), to_on * (1.0 - to_on)
    for j, spread in ((0, pp), (1, pv), (2, vv)):
        off, on = c[j], c[3 + j]
        c[j] = off + to_off * (on - off) + s * spread
        c[3 + j] = on + to_on * (off - on) + t * spread
    for j, away in ((0, px), (1, py), (2, vx), (3, vy)):
        x[j] += to_off * away
        x[4 + j] -= to_on * away


@inner
def _move_and_see(mode, lo, hi, first, second, x, c, z, variance, seen, motions, misfit, precision):
    """Objects move as they are in one mode, and are seen, for the pairs ``lo:hi``, in place.

    Args:
        misfit, precision: (hi - lo,) out: squared innovation over its variance, and one over that variance.
    """
    f00, f01, f10, f11 = motions[mode, 0], motions[mode, 1], motions[mode, 2], motions[mode, 3]
    j, k = 4 * mode, 3 * mode
    for i in range(lo, hi):
        ux, uy, wx, wy = x[i, j], x[i, j + 1], x[i, j + 2], x[i, j + 3]
        ux, wx = f00 * ux + f01 * wx, f10 * ux + f11 * wx
        uy, wy = f00 * uy + f01 * wy, f10 * uy + f11 * wy
        _spread(c[i], k, motions[mode])
        pp, pv, vv = c[i, k], c[i, k + 1], c[i, k + 2]
        a, b = first[i], second[i]
        if seen[a] and seen[b]:
            ex, ey = z[b, 0] - z[a, 0] - ux, z[b, 1] - z[a, 1] - uy
            s = 1.0 / (pp + (variance[a] + variance[b]))
            g0, g1 = pp * s, pv * s
            ux, uy, wx, wy = ux + g0 * ex, uy + g0 * ey, wx + g1 * ex, wy + g1 * ey
            vv -= g1 * pv
            pp *= 1.0 - g0
            pv *= 1.0 - g0
            misfit[i - lo], precision[i - lo] = 0.5 * s * (ex * ex + ey * ey), s
        x[i, j], x[i, j + 1], x[i, j + 2], x[i, j + 3] = ux, uy, wx, wy
        c[i, k], c[i, k + 1], c[i, k + 2] = pp, pv, vv


@inner
def _ask(
    mode, lo, hi, first, second, x, c, known, objects, spread, before, coupled, ops, numbers, rows, f, until, stack,
    holds,
):  # fmt: skip
    """Whether the predicate holds of the pairs ``lo:hi`` that are in ``mode``, into ``holds`` (AT_ONCE,).

    Pairs that are not ``known``, and those all but surely in the other mode, are left out.
    """
    many, j, k = 0, 4 * mode, 3 * mode
    for i in range(lo, hi):
        a, b = first[i], second[i]
        p = before[i]
        if known[a] and known[b] and (p > SURE if mode == 1 else p < 1.0 - SURE or not coupled):
            rows[many] = i - lo
            f[0, many], f[1, many], f[2, many], f[3, many] = x[i, j], x[i, j + 1], x[i, j + 2], x[i, j + 3]
            f[4, many], f[5, many] = c[i, k], c[i, k + 2]
            f[6, many], f[7, many] = objects[a, 1, 0], objects[a, 1, 1]
            f[8, many], f[9, many] = objects[b, 1, 0], objects[b, 1, 1]
            f[10, many], f[11, many], f[12, many] = spread[a, 2], spread[b, 2], 1.0
            many += 1
    evaluate(ops, numbers, many, f, until, stack)
    for m in range(many):
        holds[rows[m]] = stack[0, m]


@kernel
def step(
    first, second, p, mean, cov, z, variance, seen, known, objects, spread,
    motions, coupled, chances, dt, ops, numbers, distances, differences, speeds, table,
    before, on, off,
):  # fmt: skip
    """Beliefs about P pairs after ``dt`` seconds and the detections of both objects, in place.

    A pair is a switching linear system of two modes, unrelated (0) and related (1), over its relative state (second
    minus first), filtered as interacting multiple models (Blom and Bar-Shalom 1988) in the order of Eq. 1: objects move
    as they were related before, are seen, and then the relation changes as they are now. Pairs go through this
    ``AT_ONCE`` at a time: short loops let the processor work on several pairs, and what they read stays near.

    Args:
        first, second: (P,) objects.
        p: (P,) probability of the relation.
        mean, cov: (P, 2, 2, 2), (P, 2, 3) relative state in both modes.
        z, variance, seen: (n, 2), (n,), (n,) detection of each object, its variance, whether there is one.
        known: (n,) whether an object was seen lately.
        objects, spread: (n, 2, 2), (n, 3) the objects' own filters, after the detections.
        motions: (2, 7) of the relative state in both modes.
        coupled: whether the motions differ.
        chances: (3, 2) of switching on and off within ``dt`` where the predicate holds, where not, and where unknown.
        ops, numbers: of the predicate; no operations: it always holds.
        distances, differences, speeds, table: of its evidence; an empty table: none.
        before, on, off: (P,) out: probability before the switch, and of switching on and off.
    """
    rows, until = np.empty(AT_ONCE, dtype=np.int64), np.empty(AT_ONCE, dtype=np.int64)
    f, stack, holds = np.empty((FEATURES, AT_ONCE)), np.empty((max(len(ops), 1), AT_ONCE)), np.ones((2, AT_ONCE))
    x, c = mean.reshape(-1, 8), cov.reshape(-1, 6)
    misfit, precision = np.zeros((2, AT_ONCE)), np.ones((2, AT_ONCE))
    looks = table.size > 0
    for lo in range(0, len(first), AT_ONCE):
        hi = min(lo + AT_ONCE, len(first))
        for mode in range(2 if coupled else 1):
            _move_and_see(mode, lo, hi, first, second, x, c, z, variance, seen, motions, misfit[mode], precision[mode])
        for i in range(lo, hi):
            a, b = first[i], second[i]
            before[i] = p[i]
            if seen[a] and seen[b] and (coupled or looks):
                log_odds, ratio = 0.0, 1.0
                if coupled:
                    log_odds = misfit[0, i - lo] - misfit[1, i - lo]
                    ratio = precision[1, i - lo] / precision[0, i - lo]
                if looks:
                    log_odds += dt * _log_ratio(
                        x[i, 0], x[i, 1], x[i, 2], x[i, 3], objects[a, 1, 0], objects[a, 1, 1], objects[b, 1, 0],
                        objects[b, 1, 1], distances, differences, speeds, table,
                    )  # fmt: skip
                ratio *= math.exp(min(max(log_odds, -50.0), 50.0))
                now = p[i] * ratio / (p[i] * ratio + 1.0 - p[i])
                before[i] = min(max(now, FLOOR), 1.0 - FLOOR)
        if len(ops) > 0:
            for mode in range(2 if coupled else 1):
                _ask(
                    mode, lo, hi, first, second, x, c, known, objects, spread, before, coupled, ops, numbers, rows, f,
                    until, stack, holds[mode],
                )  # fmt: skip
        for i in range(lo, hi):
            prior, turn_on, turn_off = before[i], chances[2, 0], chances[2, 1]
            if known[first[i]] and known[second[i]]:
                # a mode all but excluded switches as the other does
                yes = holds[1 if coupled and prior >= 1.0 - SURE else 0, i - lo]
                turn_on = yes * chances[0, 0] + (1.0 - yes) * chances[1, 0]
                yes = holds[1 if coupled and prior > SURE else 0, i - lo]
                turn_off = yes * chances[0, 1] + (1.0 - yes) * chances[1, 1]
            on[i], off[i] = turn_on, turn_off
            after = prior * (1.0 - turn_off) + (1.0 - prior) * turn_on
            after = min(max(after, FLOOR), 1.0 - FLOOR)
            if coupled:
                to_off, to_on = prior * turn_off / (1.0 - after), (1.0 - prior) * turn_on / after
                if to_off > 1e-9 or to_on > 1e-9:
                    _exchange(x[i], c[i], min(to_off, 1.0), min(to_on, 1.0))
            p[i] = after


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
