"""One step of the collapsed relational filter: objects by Kalman filters, each pair's relation summed out.

All axes share one covariance (noise is the same along each), kept as (position, cross, velocity). A motion is
(f00, f01, f10, f11, q00, q01, q11): x' = f00 x + f01 v, v' = f10 x + f11 v, and its noise.
"""

import math

import numpy as np

from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.predicates import evaluate

FLOOR = 1e-9  # a relation is never surer than this


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


@kernel
def step(
    first, second, p, mean, cov, z, variance, seen, known, objects, spread,
    motions, coupled, chances, dt, ops, numbers, distances, differences, speeds, table,
    before, on, off,
):  # fmt: skip
    """Beliefs about P pairs after ``dt`` seconds and the detections of both objects, in place.

    A pair is a switching linear system of two modes, unrelated (0) and related (1), over its relative state (second
    minus first), filtered as interacting multiple models (Blom and Bar-Shalom 1988) in the order of Eq. 1: objects move
    as they were related before, are seen, and then the relation changes as they are now.

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
    stack = np.empty(max(len(ops), 1))
    states, spreads = mean.reshape(-1, 8), cov.reshape(-1, 6)
    asked, looks = len(ops) > 0, table.size > 0
    for i in range(len(first)):
        a, b = first[i], second[i]
        x, c = states[i], spreads[i]
        for mode in range(2 if coupled else 1):
            f00, f01, f10, f11 = motions[mode, 0], motions[mode, 1], motions[mode, 2], motions[mode, 3]
            j = 4 * mode
            for axis in range(2):
                u, w = x[j + axis], x[j + 2 + axis]
                x[j + axis] = f00 * u + f01 * w
                x[j + 2 + axis] = f10 * u + f11 * w
            _spread(c, 3 * mode, motions[mode])
        prior = p[i]
        ax, ay, bx, by = objects[a, 1, 0], objects[a, 1, 1], objects[b, 1, 0], objects[b, 1, 1]
        if seen[a] and seen[b]:
            zx, zy, r = z[b, 0] - z[a, 0], z[b, 1] - z[a, 1], variance[a] + variance[b]
            log_odds, ratio, last = 0.0, 1.0, 1.0
            for mode in range(2 if coupled else 1):
                j, k = 4 * mode, 3 * mode
                ex, ey, s = zx - x[j], zy - x[j + 1], 1.0 / (c[k] + r)
                g0, g1 = c[k] * s, c[k + 1] * s
                x[j] += g0 * ex
                x[j + 1] += g0 * ey
                x[j + 2] += g1 * ex
                x[j + 3] += g1 * ey
                c[k + 2] -= g1 * c[k + 1]
                c[k] *= 1.0 - g0
                c[k + 1] *= 1.0 - g0
                log_odds = -log_odds - 0.5 * s * (ex * ex + ey * ey)  # of mode 1 less of mode 0, after both
                ratio, last = s / last, s
            if coupled:
                if looks:
                    log_odds += dt * _log_ratio(
                        x[0], x[1], x[2], x[3], ax, ay, bx, by, distances, differences, speeds, table
                    )
                ratio *= math.exp(min(max(log_odds, -50.0), 50.0))
            elif looks:
                log_odds = dt * _log_ratio(
                    x[0], x[1], x[2], x[3], ax, ay, bx, by, distances, differences, speeds, table
                )
                ratio = math.exp(min(max(log_odds, -50.0), 50.0))
            else:
                ratio = 1.0
            prior = prior * ratio / (prior * ratio + 1.0 - prior)
            prior = min(max(prior, FLOOR), 1.0 - FLOOR)
        if known[a] and known[b]:
            yes = holds = 1.0  # whether the predicate holds, if unrelated and if related
            if asked:
                # a mode that is all but excluded switches as the other does
                if prior < 1.0 - 1e-6 or not coupled:
                    yes = evaluate(
                        ops, numbers, x[0], x[1], x[2], x[3], c[0], c[2], ax, ay, bx, by, spread[a, 2], spread[b, 2],
                        True, stack,
                    )  # fmt: skip
                if coupled and prior > 1e-6:
                    holds = evaluate(
                        ops, numbers, x[4], x[5], x[6], x[7], c[3], c[5], ax, ay, bx, by, spread[a, 2], spread[b, 2],
                        True, stack,
                    )  # fmt: skip
                    if prior >= 1.0 - 1e-6:
                        yes = holds
                else:
                    holds = yes
            turn_on = yes * chances[0, 0] + (1.0 - yes) * chances[1, 0]
            turn_off = holds * chances[0, 1] + (1.0 - holds) * chances[1, 1]
        else:
            turn_on, turn_off = chances[2, 0], chances[2, 1]
        after = prior * (1.0 - turn_off) + (1.0 - prior) * turn_on
        after = min(max(after, FLOOR), 1.0 - FLOOR)
        if coupled:
            to_off, to_on = prior * turn_off / (1.0 - after), (1.0 - prior) * turn_on / after
            if to_off > 1e-9 or to_on > 1e-9:
                _exchange(x, c, min(to_off, 1.0), min(to_on, 1.0))
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
