"""Joint hypotheses about a block of objects: what a detection says in each particle, and which object it is of.

M particles, n objects of the block, D = 2n: positions before velocities. One covariance (D, D) serves all d axes.
"""

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.base.small import root, transform
from wakefold.relations.kernels.predicates import blend, chance_of, depth_of, evaluate, shift_of


@inner
def _condition(mean, cov, i, z, variance):
    """Kalman update by a position of object ``i``, in place; its log-likelihood. A known position stays as it is."""
    d, size = len(z), len(mean)
    own = max(cov[i, i], 0.0)  # rounding may leave a variance just below 0: the position is known then
    s = own + variance
    square = 0.0
    for k in range(d):
        square += (z[k] - mean[i, k]) ** 2
    gain = np.empty(size)
    for a in range(size):
        gain[a] = cov[a, i] / s if own > 0.0 else 0.0
    for k in range(d):
        away = z[k] - mean[i, k]
        for a in range(size):
            mean[a, k] += gain[a] * away
    for a in range(size):
        for b in range(a, size):
            cov[a, b] -= gain[a] * gain[b] * s
            cov[b, a] = cov[a, b]
    return -0.5 * (square / s + d * math.log(2.0 * math.pi * s))


@kernel
def carry(f, w, at, rows, mean, cov, spread):
    """Move the ``rows`` of particles ``at`` by ``f`` and noise of covariance ``w`` (R, R), in place.

    Args:
        mean, cov: (M, D, d), (M, D, D).
        spread: whether covariances grow, too.
    """
    size, d = len(rows), mean.shape[2]
    x, c, out_x, out_c = np.empty((size, d)), np.zeros((size, size)), np.empty((size, d)), np.empty((size, size))
    work = np.empty((size, size))
    for m in at:
        for i in range(size):
            for k in range(d):
                x[i, k] = mean[m, rows[i], k]
            for j in range(size):
                c[i, j] = cov[m, rows[i], rows[j]]
        transform(x, c, f, w, out_x, out_c, work)
        for i in range(size):
            for k in range(d):
                mean[m, rows[i], k] = out_x[i, k]
            if spread:
                for j in range(size):
                    cov[m, rows[i], rows[j]] = out_c[i, j]


@kernel
def draw(cov, at, rows, noise, mean):
    """Add to the ``rows`` of particles ``at`` Gaussian numbers of covariance ``cov``, in place.

    Args:
        cov: (m, R, R) of each particle, or (1, R, R) of all.
        noise: (M, D, d) standard normal; mean: (M, D, d).
    """
    size = len(rows)
    lower = np.empty((size, size))
    for number in range(len(at)):
        m = at[number]
        if number < len(cov):
            root(cov[number], lower)
        for i in range(size):
            for k in range(mean.shape[2]):
                total = 0.0
                for j in range(i + 1):
                    total += lower[i, j] * noise[m, rows[j], k]
                mean[m, rows[i], k] += total


@kernel
def see(mean, cov, which, z, variance, out):
    """Update M particles by positions ``z`` (m, d) of objects ``which`` (m,); log-likelihoods are added to ``out``."""
    for m in range(len(mean)):
        for j in range(len(which)):
            out[m] += _condition(mean[m], cov[m], which[j], z[j], variance[j])


@kernel
def assign(mean, cov, seen, logs, beam, gate, u, choice, out):
    """Draw for each particle which detection each object has, in proportion to its probability, and update.

    Object after object takes a detection or none; of the joint assignments so far the ``beam`` best are kept, each with
    the objects' joint Gaussian given its detections. (All are kept, and the draw is exact, where there are no more.)

    Args:
        mean, cov: (M, D, d), (M, D, D), in place.
        seen: positions (m, d) and variances (m,) of detections.
        logs: (M, n) log probability that an object is there and detected; (M, n) that it is not detected; log density
            of detections that are of no object.
        gate: detections farther than this many standard deviations are not considered.
        u: (M,) uniforms.
        choice: (M, n) out: detection of each object, -1 for none.
        out: (M,) log-likelihood is added (relative to all detections being of no object).
    """
    (z, variance), (hit, miss, away) = seen, logs
    count, n, many, d, size = len(mean), hit.shape[1], len(z), z.shape[1], mean.shape[1]
    means, covs = np.empty((2, beam, size, d)), np.empty((2, beam, size, size))
    score, picks = np.empty((2, beam)), np.empty((2, beam, n), dtype=np.int64)
    room = beam * (many + 1)
    option, parent, taken = np.empty(room), np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    for m in range(count):
        now = 0
        means[0, 0], covs[0, 0], score[0, 0] = mean[m], cov[m], 0.0
        held = 1
        for i in range(n):
            total = 0
            for h in range(held):
                option[total], parent[total], taken[total] = score[now, h] + miss[m, i], h, -1
                total += 1
                for j in range(many):
                    free = True
                    for before in range(i):
                        free = free and picks[now, h, before] != j
                    if not free:
                        continue
                    s = covs[now, h, i, i] + variance[j]
                    square = 0.0
                    for k in range(d):
                        square += (z[j, k] - means[now, h, i, k]) ** 2
                    if square > gate * gate * s:
                        continue
                    law = -0.5 * (square / s + d * math.log(2.0 * math.pi * s))
                    option[total], parent[total], taken[total] = score[now, h] + hit[m, i] + law - away, h, j
                    total += 1
            new = 1 - now
            kept = min(beam, total)
            for slot in range(kept):
                best = slot
                for o in range(slot + 1, total):
                    if option[o] > option[best]:
                        best = o
                option[slot], option[best] = option[best], option[slot]
                parent[slot], parent[best] = parent[best], parent[slot]
                taken[slot], taken[best] = taken[best], taken[slot]
                h, j = parent[slot], taken[slot]
                score[new, slot] = option[slot]
                means[new, slot], covs[new, slot] = means[now, h], covs[now, h]
                for before in range(i):
                    picks[new, slot, before] = picks[now, h, before]
                picks[new, slot, i] = j
                if j >= 0:
                    _condition(means[new, slot], covs[new, slot], i, z[j], variance[j])
            now, held = new, kept
        peak = score[now, 0]
        total_weight = 0.0
        for h in range(held):
            total_weight += math.exp(score[now, h] - peak)
        reach, drawn = u[m] * total_weight, 0
        while drawn < held - 1 and reach >= math.exp(score[now, drawn] - peak):
            reach -= math.exp(score[now, drawn] - peak)
            drawn += 1
        mean[m], cov[m] = means[now, drawn], covs[now, drawn]
        for i in range(n):
            choice[m, i] = picks[now, drawn, i]
        out[m] += peak + math.log(total_weight)


@kernel
def switch(mean, cov, pair, rows, law, known, u, bits, on, off):
    """Draw in each of M particles whether a relation of a pair changes; its block is then known to be so, in place.

    Args:
        mean, cov: (M, D, d), (M, D, D): positions before velocities; ``pair``: the two objects; ``rows``: of the block.
        law: operations and constants of the predicate, and chances as in ``pairs.Law``.
        known: whether both objects were seen lately.
        u: (M,) uniforms; bits: (M,) the relation, in place.
        on, off: (M,) out: the chance of each particle to switch.
    """
    (ops, numbers, chances), (a, b) = law, pair
    n = mean.shape[1] // 2
    g, inside, own, kept = np.empty(8), np.empty(8), np.empty(8), np.empty((depth_of(ops), 8))
    ku, kw = np.empty(len(rows)), np.empty(len(rows))
    for m in range(len(mean)):
        x, c = mean[m], cov[m]
        g[0], g[1], g[2], g[3] = (
            x[b, 0] - x[a, 0],
            x[b, 1] - x[a, 1],
            x[n + b, 0] - x[n + a, 0],
            x[n + b, 1] - x[n + a, 1],
        )
        g[4] = max(c[a, a] + c[b, b] - 2.0 * c[a, b], 0.0)
        g[5] = c[a, n + a] + c[b, n + b] - c[a, n + b] - c[b, n + a]
        g[6] = max(c[n + a, n + a] + c[n + b, n + b] - 2.0 * c[n + a, n + b], 0.0)
        own[0], own[1], own[2], own[3] = x[n + a, 0], x[n + a, 1], x[n + b, 0], x[n + b, 1]
        own[4], own[5], own[6], own[7] = c[a, n + a], max(c[n + a, n + a], 0.0), c[b, n + b], max(c[n + b, n + b], 0.0)
        inside[:] = g
        yes = evaluate(ops, numbers, inside, own, known, kept) if len(ops) else 1.0
        on[m], off[m] = chance_of(0, yes, known, chances), chance_of(1, yes, known, chances)
        way = 1 if bits[m] else 0
        turned = u[m] < (off[m] if way else on[m])
        bits[m] = bits[m] != turned
        det = g[4] * g[6] - g[5] * g[5]
        if yes <= 0.0 or yes >= 1.0 or not det > 1e-6 * g[4] * g[6]:
            continue
        blend(g, inside, shift_of(way, turned, yes, known, chances), inside)
        pp, pv, vv = (inside[4] - g[4]), (inside[5] - g[5]), (inside[6] - g[6])
        for i in range(len(rows)):
            r = rows[i]
            cu, cw = c[r, b] - c[r, a], c[r, n + b] - c[r, n + a]
            ku[i], kw[i] = (cu * g[6] - cw * g[5]) / det, (cw * g[4] - cu * g[5]) / det
            for k in range(2):
                x[r, k] += ku[i] * (inside[k] - g[k]) + kw[i] * (inside[2 + k] - g[2 + k])
        for i in range(len(rows)):
            for j in range(i + 1):
                more = ku[i] * ku[j] * pp + (ku[i] * kw[j] + kw[i] * ku[j]) * pv + kw[i] * kw[j] * vv
                c[rows[i], rows[j]] += more
                if i != j:
                    c[rows[j], rows[i]] += more
