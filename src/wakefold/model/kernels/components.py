"""Gaussian components: motion beside a track, weight and correction by a fix; notation as in the filters."""

# pyright: reportCallIssue=false
# (numba gives an intrinsic its typing context: it is called with one argument less than it is defined with)

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.model.kernels.boxes import WIDTH, bare, hold, nearest, pointer, scratch
from wakefold.model.kernels.motion import drifts

TINY = 1e-300  # square metres


@inner
def _heading(v, along, dims):
    """Projection ``along`` (d, d) onto the direction of a velocity; zero for none."""
    speed2 = 0.0
    for k in range(len(dims)):
        speed2 += v[k] * v[k]
    for j in range(len(dims)):
        for k in range(len(dims)):
            along[j, k] = v[j] * v[k] / speed2 if speed2 > 0.0 else 0.0


@inner
def _sound(cov, dims):
    """Take out of a covariance (d, d) what rounding has put in: variances below 0, correlations beyond 1."""
    for j in range(len(dims)):
        cov[j, j] = max(cov[j, j], 0.0)
        for k in range(j):
            most = math.sqrt(cov[j, j]) * math.sqrt(cov[k, k])
            cov[j, k] = min(max(cov[j, k], -most), most)
            cov[k, j] = min(max(cov[k, j], -most), most)


@kernel
def advance(points, covs, classes, parts, h, keep, across2, along2, ground):
    """Move Gaussians (n, d), (n, d, d) beside their tracks for ``parts`` sub-steps of ``h`` seconds, in place.

    Across the heading an offset from the nearest point of the track shrinks to the share ``keep``, and the variance
    grows by ``across2`` (n,); along it the variance grows by ``along2`` (n,).
    """
    lo, hi, dims, data, leaf_at = ground.lo, ground.hi, ground.dims, ground.field.data, ground.field.leaf_at
    d, field, room = len(dims), bare(ground.field), scratch(leaf_at)
    alone = np.empty(0, dtype=np.int64)
    drift, along, moved = np.empty_like(points), np.empty((d, d)), np.empty((d, d))
    shrink, offset = np.empty((d, d)), np.empty(d)
    for _ in range(parts):
        drifts(points, classes, alone, drift, ground)
        for i in range(len(points)):
            first, last, q = leaf_at[lo[classes[i]]], leaf_at[hi[classes[i]]], pointer(points, i * d)
            _, place = nearest(q, first, last, field, np.inf, first * 2 * d * WIDTH, pointer(room, 0), dims)
            for k in range(d):
                offset[k] = data[place + k * WIDTH] - points[i, k]
            _heading(drift[i], along, dims)
            for j in range(d):
                for k in range(d):
                    shrink[j, k] = (keep if j == k else 0.0) + (1.0 - keep) * along[j, k]
            for j in range(d):
                pull = 0.0
                for k in range(d):
                    pull += ((1.0 if j == k else 0.0) - shrink[j, k]) * offset[k]
                points[i, j] += h * drift[i, j] + pull
            for j in range(d):
                for k in range(d):
                    moved[j, k] = 0.0
                    for m in range(d):
                        moved[j, k] += shrink[j, m] * covs[i, m, k]
            for j in range(d):
                for k in range(d):
                    total = (across2[i] if j == k else 0.0) + (along2[i] - across2[i]) * along[j, k]
                    for m in range(d):
                        total += moved[j, m] * shrink[m, k]  # ``shrink`` is symmetric
                    covs[i, j, k] = total
            _sound(covs[i], dims)
    hold(room)


@kernel
def correct(points, covs, fix, sd2, out, dims):
    """Kalman update of Gaussians (n, d), (n, d, d) by a fix (d,) of variance ``sd2`` per axis, in place.

    The log-likelihoods go into ``out`` (n,); returns the least distance of the fix from a Gaussian, in sd of what that
    Gaussian predicts of it. A Gaussian for which the arithmetic overflows is left as it is, with likelihood 0.
    """
    d = len(dims)
    root, solved, away = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    closest = np.inf
    for i in range(len(points)):
        logs, distance2 = -0.5 * d * math.log(2.0 * math.pi), 0.0
        for j in range(d):  # Cholesky factor of the covariance of the fix; solve for the gap and for the covariance
            for k in range(j + 1):
                total = covs[i, j, k] + (sd2 if j == k else 0.0)
                for m in range(k):
                    total -= root[j, m] * root[k, m]
                # No pivot is below the least eigenvalue, which is ``sd2`` at least; rounding may take it below 0.
                root[j, k] = math.sqrt(max(total, sd2, TINY)) if j == k else total / root[k, k]
            logs -= math.log(root[j, j])
            gap = fix[j] - points[i, j]
            for m in range(j):
                gap -= root[j, m] * away[m]
            away[j] = gap / root[j, j]
            distance2 += away[j] * away[j]
            for k in range(d):
                total = covs[i, j, k]
                for m in range(j):
                    total -= root[j, m] * solved[m, k]
                solved[j, k] = total / root[j, j]
        if not distance2 < np.inf:
            out[i] = -np.inf
            continue
        closest = min(closest, distance2)
        out[i] = logs - 0.5 * distance2
        for j in range(d):
            for m in range(d):
                points[i, j] += solved[m, j] * away[m]
        for j in range(d):
            for k in range(d):
                total = covs[i, j, k]
                for m in range(d):
                    total -= solved[m, j] * solved[m, k]
                covs[i, j, k] = total
        _sound(covs[i], dims)
    return math.sqrt(closest)


@kernel
def mix_classes(log_weights, classes, share, leaves):
    """Take a share of all mass and spread it evenly over the tracks that have components, in place.

    Weights inside a track keep their proportions; where they are all zero they become even.
    """
    mass, count = np.zeros(leaves), np.zeros(leaves, dtype=np.int64)
    for i in range(len(classes)):
        mass[classes[i]] += math.exp(log_weights[i])
        count[classes[i]] += 1
    held = 0
    for c in range(leaves):
        held += count[c] > 0
    for i in range(len(classes)):
        c = classes[i]
        if mass[c] > 1e-300:
            log_weights[i] += math.log((1.0 - share) + share / held / mass[c])
        else:  # what there was counts for nothing beside the share
            log_weights[i] = math.log(share / held / count[c])


@kernel
def temper(log_weights, before, classes, power, leaves):
    """Raise to a power what evidence has just told tracks apart by, in place; nothing is normalised.

    The factor by which the mass of a track has changed, from log-weights ``before`` (n,) to ``log_weights`` (n,), is
    raised to ``power``. Weights inside a track keep their proportions. Classes (n,) are below ``leaves``.
    """
    peaks, sums = np.full((2, leaves), -np.inf), np.zeros((2, leaves))
    for i in range(len(classes)):
        peaks[0, classes[i]] = max(peaks[0, classes[i]], before[i])
        peaks[1, classes[i]] = max(peaks[1, classes[i]], log_weights[i])
    for i in range(len(classes)):
        c = classes[i]
        if peaks[1, c] > -np.inf:  # so there was some mass before, too
            sums[0, c] += math.exp(before[i] - peaks[0, c])
            sums[1, c] += math.exp(log_weights[i] - peaks[1, c])
    for i in range(len(classes)):
        c = classes[i]
        if peaks[1, c] > -np.inf:
            gain = peaks[1, c] - peaks[0, c] + math.log(sums[1, c] / sums[0, c])
            log_weights[i] -= (1.0 - power) * gain


@kernel
def weigh_report(log_weights, genuine, chance, power, trust, nodes):
    """Multiply weights by the probability of a report, and learn how far such reports can be trusted.

    Args:
        log_weights: (n,), changed in place, not normalised.
        genuine: (n,) probability of the report if it is genuine.
        chance: its probability if it is not.
        power: to which the probability of the report is raised.
        trust: (n, G) log-weights of the share of genuine reports at ``nodes`` (G,); changed in place, normalised.
    """
    terms = np.empty(len(nodes))
    for i in range(len(log_weights)):
        peak = -np.inf
        for g in range(len(nodes)):
            p = nodes[g] * genuine[i] + (1.0 - nodes[g]) * chance
            terms[g] = trust[i, g] + (power * math.log(p) if p > 0.0 else -np.inf)
            peak = max(peak, terms[g])
        if peak == -np.inf:
            log_weights[i] = peak
            continue
        total = 0.0
        for g in range(len(nodes)):
            total += math.exp(terms[g] - peak)
        total = peak + math.log(total)
        for g in range(len(nodes)):
            trust[i, g] = terms[g] - total
        log_weights[i] += total
