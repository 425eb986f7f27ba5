"""One step of two objects that go through phases together: Kalman filters of both, jointly, one for each phase.

The state of an axis is (first position, second position, first velocity, second velocity). Axes share one covariance,
as their noise is the same and both are seen or missing together. A phase whose log-probability is below ``FAINT`` is
left out. Beliefs that come together in one phase are merged by their moments before the update, as in interacting
multiple models (Blom and Bar-Shalom 1988).
"""

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.base.small import transform

FAINT = -60.0
# What a turn asks of a state: rows of difference in position, difference in velocity, either velocity.
ASKED = np.array([[-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
POSITION = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])


@inner
def _update(x, c, row, z, variance, gain):
    """Condition on ``row x = z`` seen with ``variance``, in place: squared innovation over its variance, the latter."""
    s = variance
    for i in range(4):
        total = 0.0
        for j in range(4):
            total += c[i, j] * row[j]
        gain[i] = total
        s += row[i] * total
    square = 0.0
    for k in range(x.shape[1]):
        off = z[k]
        for i in range(4):
            off -= row[i] * x[i, k]
        square += off * off
        for i in range(4):
            x[i, k] += gain[i] * off / s
    for i in range(4):
        for j in range(4):
            c[i, j] -= gain[i] * gain[j] / s
    return square / s, s


@inner
def _merge(mean, cov, log_p, j, x, c, log_w):
    """Add a belief of log-weight ``log_w`` to that of phase ``j``, keeping both moments."""
    if log_p[j] == -np.inf:
        mean[j], cov[j], log_p[j] = x, c, log_w
        return
    top = max(log_p[j], log_w)
    total = top + math.log(math.exp(log_p[j] - top) + math.exp(log_w - top))
    share = math.exp(log_w - total)
    d = x.shape[1]
    for i in range(4):
        for k in range(4):
            spread = 0.0
            for axis in range(d):
                spread += (x[i, axis] - mean[j, i, axis]) * (x[k, axis] - mean[j, k, axis])
            cov[j, i, k] += share * (c[i, k] - cov[j, i, k]) + share * (1.0 - share) * spread / d
    for i in range(4):
        for axis in range(d):
            mean[j, i, axis] += share * (x[i, axis] - mean[j, i, axis])
    log_p[j] = total


@kernel
def step(belief, z, variance, speed, motions, turns):
    """Beliefs about P pairs after a step and the positions seen then, in place.

    Args:
        belief: ``PairPhases``; phases that are impossible have -inf.
        z: (P, 2, d) positions, NaN where not seen; variance: of their noise; speed: variance of a new velocity.
        motions: f, q, (K, 4, 4) motion in each phase.
        turns: before, after, log_turn, asked, (J,), (J,), (J,), (J, 3), from phase to phase: log-probability, and
            variances of what the objects must be like for it (``ASKED``; the last for both velocities), inf for no
            matter what. They are made once both objects have been seen.
    """
    mean, cov, log_p, begun = belief.mean, belief.cov, belief.log_p, belief.begun
    (f, q), (before, after, log_turn, asked) = motions, turns
    count, phases, _, d = mean.shape
    moved, moved_c = np.empty((phases, 4, d)), np.empty((phases, 4, 4))
    x, c, stay = np.empty((4, d)), np.empty((4, 4)), np.empty(phases)
    work, gain, zero, old = np.empty((4, 4)), np.empty(4), np.zeros(d), np.empty(phases)
    for p in range(count):
        for k in range(phases):
            old[k], log_p[p, k], stay[k] = log_p[p, k], -np.inf, 1.0
            if old[k] > FAINT:
                transform(mean[p, k], cov[p, k], f[k], q[k], moved[k], moved_c[k], work)
        for j in range(len(before) if begun[p, 0] and begun[p, 1] else 0):
            k, chance = before[j], log_turn[j]
            if old[k] <= FAINT:
                continue
            x[:], c[:] = moved[k], moved_c[k]
            for i in range(4):
                wide = asked[j, min(i, 2)]
                if wide < np.inf:
                    square, s = _update(x, c, ASKED[i], zero, wide, gain)
                    chance += 0.5 * d * math.log(wide / s) - 0.5 * square
            stay[k] -= math.exp(chance)
            if old[k] + chance > FAINT:
                _merge(mean[p], cov[p], log_p[p], after[j], x, c, old[k] + chance)
        for k in range(phases):
            if old[k] > FAINT:
                _merge(mean[p], cov[p], log_p[p], k, moved[k], moved_c[k], old[k] + math.log(max(stay[k], 1e-9)))
        for o in range(2):
            if np.isnan(z[p, o, 0]):
                continue
            for k in range(phases):
                if begun[p, o]:
                    if log_p[p, k] > -np.inf:
                        square, s = _update(mean[p, k], cov[p, k], POSITION[o], z[p, o], variance, gain)
                        log_p[p, k] -= 0.5 * square + 0.5 * d * math.log(2.0 * math.pi * s)
                else:
                    mean[p, k, o], mean[p, k, 2 + o] = z[p, o], 0.0
                    for i in (o, 2 + o):
                        cov[p, k, i, :] = 0.0
                        cov[p, k, :, i] = 0.0
                    cov[p, k, o, o], cov[p, k, 2 + o, 2 + o] = variance, speed
            begun[p, o] = True
        top = log_p[p].max()
        total = top + math.log(np.exp(log_p[p] - top).sum())
        for k in range(phases):
            log_p[p, k] -= total
