"""Algorithm 1 for one pair, many particles, in one kernel: what the engines of the relational filter are held against.

The law is that of the engine "bootstrap" and of nothing else in the library but the exact motion: objects and relation
are sampled, the relation changes as the predicate holds of the sampled objects. Objects are drawn given what is seen
of them and weighed by how likely that was, which gives the same answer with less chance than drawing them blindly.
"""

# ruff: noqa: NPY002  (numba has the old generator alone)

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from wakefold.relations.model import Coupling
from wakefold.relations.motion import moving


class Setting(NamedTuple):
    """A relation of two people, and how they are seen.

    Attributes:
        sd: metres, of a fix; dt: seconds between frames.
        on, off: rates; the relation also ceases at ``on`` where the predicate does not hold, as is the default.
        predicate: a name of ``PREDICATES``.
    """

    sd: float = 0.3
    prior: float = 0.0
    on: float = 0.3
    off: float = 0.2
    couples: Coupling | None = None
    predicate: str = "near & same velocity"
    q: float = 0.35
    speed: float = 0.5
    dt: float = 0.4


# Names, and numbers by which ``_holds`` knows them.
PREDICATES = {
    "near & same velocity": 0,
    "near": 1,
    "same velocity": 2,
    "slow": 3,
    "ahead": 4,
    "closing": 5,
    "near & not slow": 6,
    "near | slow": 7,
    "near & ahead": 8,
}


@njit(cache=True)
def _holds(kind, x):
    """A predicate of points: ``x`` (4, 2), positions of first and second, then velocities."""
    u0, u1, w0, w1 = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1], x[3, 0] - x[2, 0], x[3, 1] - x[2, 1]
    near = u0 * u0 + u1 * u1 <= 4.0
    like = w0 * w0 + w1 * w1 <= 0.25
    a, b = math.hypot(x[2, 0], x[2, 1]), math.hypot(x[3, 0], x[3, 1])
    slow = a <= 0.6 and b <= 0.6
    along = (u0 * x[2, 0] + u1 * x[2, 1]) / max(a, 1e-12)
    beside = abs(u1 * x[2, 0] - u0 * x[2, 1]) / max(a, 1e-12)
    ahead = 0.0 < along <= 3.0 and beside <= 1.0
    if kind == 0:
        return near and like
    if kind == 1:
        return near
    if kind == 2:
        return like
    if kind == 3:
        return slow
    if kind == 4:
        return ahead
    if kind == 5:
        return -(u0 * w0 + u1 * w1) >= 0.3 * math.hypot(u0, u1)
    if kind == 6:
        return near and not slow
    if kind == 7:
        return near or slow
    return near and ahead


@njit(cache=True)
def _seed(seed):
    np.random.seed(seed)


@njit(cache=True)
def _advance(x, bits, weights, law, z, rows):
    """All particles moved, drawn given what is seen and weighed, in place.

    law: of each mode f (4, 4), gain (4, m), inverse of the variance of the innovation (m, m), root (4, 4), log factor.
    """
    f, gain, inverse, root, factor = law
    count, m = len(x), len(rows)
    mu, e = np.empty((4, 2)), np.empty((max(m, 1), 2))
    for n in range(count):
        r = 1 if bits[n] else 0
        for i in range(4):
            for k in range(2):
                total = 0.0
                for j in range(4):
                    total += f[r, i, j] * x[n, j, k]
                mu[i, k] = total
        square = 0.0
        for i in range(m):
            for k in range(2):
                e[i, k] = z[i, k] - mu[rows[i], k]
        for i in range(m):
            for j in range(m):
                square += inverse[r, i, j] * (e[i, 0] * e[j, 0] + e[i, 1] * e[j, 1])
        weights[n] = factor[r] - 0.5 * square
        for k in range(2):
            c0, c1, c2, c3 = np.random.normal(), np.random.normal(), np.random.normal(), np.random.normal()
            for i in range(4):
                total = mu[i, k] + root[r, i, 0] * c0 + root[r, i, 1] * c1 + root[r, i, 2] * c2 + root[r, i, 3] * c3
                for j in range(m):
                    total += gain[r, i, j] * e[j, k]
                x[n, i, k] = total
    top = weights.max()
    for n in range(count):
        weights[n] = math.exp(weights[n] - top)
    weights /= weights.sum()


@njit(cache=True)
def _turn(x, bits, weights, chances, known, kind):
    """The relation changes in all particles, in place; P(related) after it."""
    p, count = 0.0, len(x)
    for n in range(count):
        case = (0 if _holds(kind, x[n]) else 1) if known else 2
        change = chances[case, 1] if bits[n] else chances[case, 0]
        p += weights[n] * ((1.0 - change) if bits[n] else change)
        if np.random.random() < change:
            bits[n] = not bits[n]
    return p


@njit(cache=True)
def _resample(x, bits, weights, new_x, new_bits):
    count, u, total, j = len(x), np.random.random(), weights[0], 0
    for n in range(count):
        reach = (n + u) / count
        while total < reach and j < count - 1:
            j += 1
            total += weights[j]
        new_x[n], new_bits[n] = x[j], bits[j]


@njit(cache=True)
def _share(x, kind):
    """The share of particles of which a predicate holds."""
    held = 0
    for n in range(len(x)):
        held += _holds(kind, x[n])
    return held / len(x)


def chances(s: Setting) -> np.ndarray:
    """``(3, 2)`` of switching on and off in a step: where the predicate holds, where not, where one is not seen."""
    out = np.zeros((3, 2))
    for row, (on, off) in enumerate(((s.on, s.off), (0.0, s.off + s.on), (0.0, s.off))):
        if on + off > 0:
            out[row] = np.array([on, off]) / (on + off) * -np.expm1(-(on + off) * s.dt)
    return out


def settled(s: Setting) -> np.ndarray:
    """Covariance ``(4, 4)`` of an axis of two who start related: their velocities differ as those of long related."""
    cov = np.diag([s.sd**2] * 2 + [s.speed**2] * 2)
    if s.couples is not None and s.couples.k > 0:
        apart = np.array([0.0, 0.0, -1.0, 1.0])
        gain = cov @ apart / (apart @ cov @ apart + s.couples.noise**2 / (2 * s.couples.k))
        cov = cov - np.outer(gain, apart @ cov)
    return cov


def begun(s: Setting, z: np.ndarray, count: int, rng: np.random.Generator) -> float:
    """P(related) of two at their first fix ``z (2, 2)``: the prior, if the predicate holds."""
    x = np.empty((count, 4, 2))
    x[:, :2] = z + s.sd * rng.standard_normal((count, 2, 2))
    x[:, 2:] = s.speed * rng.standard_normal((count, 2, 2))
    return s.prior * _share(x, PREDICATES[s.predicate]) if s.prior > 0.0 else 0.0


def motions(s: Setting) -> list[tuple[np.ndarray, np.ndarray]]:
    """Transition and noise ``(4, 4)`` unrelated and related."""
    return [moving(np.full(2, s.q), ties, s.dt) for ties in ([], [(0, 1, s.couples)] if s.couples else [])]


def seen(cov: np.ndarray, rows: np.ndarray, sd: float) -> tuple[np.ndarray, ...]:
    """Gain, inverse of the variance of the innovation, covariance that is left, and log factor of a fix of ``rows``."""
    variance = cov[np.ix_(rows, rows)] + sd**2 * np.eye(len(rows))
    over = np.linalg.inv(variance)
    gain = cov[:, rows] @ over
    left = cov - gain @ cov[rows]
    return gain, over, 0.5 * (left + left.T), -np.log(np.linalg.det(variance))


def belief(s: Setting, fixes: np.ndarray, particles: int, seed: int) -> np.ndarray:
    """P(related) at each frame ``(T,)``; ``fixes (T, 2, 2)``, NaN where one is not seen; both are at the first."""
    _seed(seed)
    rng = np.random.default_rng(seed)
    moves, switch, kind = motions(s), chances(s), PREDICATES[s.predicate]
    weights, p = np.full(particles, 1.0 / particles), begun(s, fixes[0], 200_000, rng)
    out = [p]
    x, bits = np.empty((particles, 4, 2)), np.zeros(particles, dtype=bool)
    spare_x, spare_bits = np.empty_like(x), np.empty_like(bits)
    for t, z in enumerate(fixes[1:]):
        rows = np.flatnonzero(np.isfinite(z[:, 0]))
        at, known = np.ascontiguousarray(z[rows]), len(rows) == 2
        if t == 0:  # exactly: a velocity drawn from all there may be would seldom fit
            modes = []
            for share, (move, noise), cov in zip(
                (1 - p, p), moves, (settled(s._replace(couples=None)), settled(s)), strict=True
            ):
                mean = move @ np.concatenate([fixes[0], np.zeros((2, 2))])
                gain, over, left, factor = seen(move @ cov @ move.T + noise, rows, s.sd)
                off = at - mean[rows]
                fits = np.exp(0.5 * 2 * factor - 0.5 * np.einsum("ik,ij,jk", off, over, off)) if share > 0 else 0.0
                modes.append((share * fits, mean + gain @ off, np.linalg.cholesky(left + 1e-14 * np.eye(4))))
            bits[:] = rng.random(particles) < modes[1][0] / (modes[0][0] + modes[1][0])
            for mode, (_, mean, root) in enumerate(modes):
                which = bits == bool(mode)
                x[which] = mean + np.einsum("ij,njk->nik", root, rng.standard_normal((int(which.sum()), 4, 2)))
            out.append(_turn(x, bits, weights, switch, known, kind))
            continue
        parts = [seen(noise, rows, s.sd) for _, noise in moves]
        roots = [np.linalg.cholesky(left + 1e-14 * np.eye(4)) for _, _, left, _ in parts]
        law = [[move for move, _ in moves], [y[0] for y in parts], [y[1] for y in parts], roots, [y[3] for y in parts]]
        _advance(x, bits, weights, tuple(np.ascontiguousarray(np.array(y)) for y in law), at, rows)
        out.append(_turn(x, bits, weights, switch, known, kind))
        _resample(x, bits, weights, spare_x, spare_bits)
        x, spare_x, bits, spare_bits = spare_x, x, spare_bits, bits
        weights[:] = 1.0 / particles
    return np.array(out)


def drawn(s: Setting, frames: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A scene drawn from the model: where the two are ``(T, 2, 2)``, and whether they are related ``(T,)``."""
    here = np.array([[0.0, 0.0], rng.uniform(-1.5, 1.5, 2)])
    bits = rng.random(1) < begun(s, here, 20_000, rng)
    root = np.linalg.cholesky(settled(s if bits[0] else s._replace(couples=None)))
    x = np.concatenate([here, (root @ rng.standard_normal((4, 2)))[2:]])[None]
    moves, switch, kind = motions(s), chances(s), PREDICATES[s.predicate]
    places, related = [x[0, :2].copy()], [bool(bits[0])]
    for _ in range(frames - 1):
        f, noise = moves[int(bits[0])]
        x[0] = f @ x[0] + np.linalg.cholesky(noise + 1e-14 * np.eye(4)) @ rng.standard_normal((4, 2))
        change = switch[0 if _holds(kind, x[0]) else 1, int(bits[0])]
        bits = bits != (rng.random(1) < change)
        places.append(x[0, :2].copy())
        related.append(bool(bits[0]))
    return np.array(places), np.array(related)
