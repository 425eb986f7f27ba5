"""What company tells: where a hidden person is, and who is who after nobody was seen for a while."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.walkers import Together, Walkers

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Beside(NamedTuple):
    """Moments from which on somebody is hidden while somebody else stays in sight; one row for each two.

    Attributes:
        person, partner: ``(E,)`` who is hidden, who is seen.
        frame: ``(E,)`` the first hidden frame.
        belief: ``(E,)`` probability that they are together, given what was seen before.
        together: ``(E,)`` whether they are.
        alone: ``(E, H, 2)`` where the person would be at constant velocity.
        shares: ``(E, H, 3, 2)`` what the partner's way may add to that: how far the partner has left *its* constant
            velocity, how far the two velocities would take them apart, where the partner was.
        strength: ``(E, 4)`` on which the shares depend: 1, belief, nearness, likeness of the velocities.
        truth: ``(E, H, 2)`` where the person was.
    """

    person: Ints
    partner: Ints
    frame: Ints
    belief: Floats
    together: Bools
    alone: Floats
    shares: Floats
    strength: Floats
    truth: Floats

    def rows(self, keep: NDArray) -> Beside:
        """Some of them."""
        columns: list[Any] = [column[keep] for column in self]
        return Beside(*columns)


def hide(
    walkers: Walkers,
    pairs: Together,
    belief: Floats,
    together: Bools,
    *,
    hidden: int = 12,
    before: int = 5,
    every: int = 6,
    least: float = 0.05,
) -> Beside:
    """All moments at which one of a pair may be hidden: both are there before, and all the while.

    Args:
        belief: ``(R,)`` probability of each pair up to each frame (``TogetherFit.over_time``).
        together: ``(K,)`` whether each pair is together; such pairs are kept however small the belief.
        hidden, before: frames hidden, and seen together before that.
        every: frames between moments.
        least: pairs believed less than this to be together are left out.
    """
    at = pairs.offsets
    q = np.repeat(np.arange(len(pairs.first)), np.diff(at))
    frame = np.arange(at[-1]) - at[q] + pairs.begin[q]
    row = np.flatnonzero((frame - pairs.begin[q] >= before) & (frame + hidden <= pairs.end[q]) & (frame % every == 0))
    p = belief[row - 1]
    row, p = row[(p >= least) | together[q[row]]], p[(p >= least) | together[q[row]]]
    q, frame = q[row], frame[row]
    i, j = np.concatenate([pairs.first[q], pairs.second[q]]), np.concatenate([pairs.second[q], pairs.first[q]])
    frame, p, q = np.tile(frame, 2), np.tile(p, 2), np.tile(q, 2)
    a, b = (walkers.offsets[x] + frame - walkers.begin[x] for x in (i, j))
    ahead = np.arange(hidden)
    truth, partner = walkers.seen[a[:, None] + ahead], walkers.seen[b[:, None] + ahead]
    seen = np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)) & np.isfinite(partner).all(axis=(1, 2)))
    x, v, y, w = walkers.position[a - 1], walkers.velocity[a - 1], walkers.position[b - 1], walkers.velocity[b - 1]
    later = ((ahead + 1) * walkers.dt)[None, :, None]
    apart = np.broadcast_to((y - x)[:, None], truth.shape)
    shares = np.stack([partner - y[:, None] - later * w[:, None], later * (w - v)[:, None], apart], axis=2)
    near = np.exp(-((y - x) ** 2).sum(axis=1) / 1.5**2)
    alike = 1.0 / (1.0 + np.hypot(*(w - v).T) / 0.3)
    strength = np.column_stack([np.ones(len(p)), p, near, alike])
    return Beside(i, j, frame, p, together[q], x[:, None] + later * v[:, None], shares, strength, truth).rows(seen)


def learn_company(scenes: Sequence[Beside], ridge: float = 1e-3) -> Floats:
    """``(H, 12)`` how much of each share to take at each frame: least squares over scenes with known groups.

    Scenes weigh with the square root of their number of rows.
    """
    weights = [len(s.person) ** -0.25 for s in scenes]
    out: list[NDArray] = []
    for h in range(scenes[0].truth.shape[1]):
        x = np.concatenate([_columns(s, h) * w for s, w in zip(scenes, weights, strict=True)])
        y = np.concatenate([(s.truth - s.alone)[:, h].ravel() * w for s, w in zip(scenes, weights, strict=True)])
        normal = x.T @ x
        out.append(np.linalg.solve(normal + ridge * np.diag(np.diag(normal)), x.T @ y))
    return np.array(out)


def beside(scene: Beside, taken: Floats) -> tuple[Ints, Floats]:
    """Where each hidden person is thought to be: ``(n,)`` first row of each person and moment, ``(n, H, 2)`` positions.

    Partners count with the square of the belief.
    """
    moves = np.stack([(_columns(scene, h) @ taken[h]).reshape(-1, 2) for h in range(scene.truth.shape[1])], axis=1)
    _, first, which = np.unique(
        np.column_stack([scene.person, scene.frame]), axis=0, return_index=True, return_inverse=True
    )
    which = which.ravel()
    weight = scene.belief**2 + 1e-6
    total = np.zeros((len(first), *moves.shape[1:]))
    np.add.at(total, which, moves * weight[:, None, None])
    return first, scene.alone[first] + total / np.bincount(which, weight)[:, None, None]


def _columns(scene: Beside, h: int) -> Floats:
    """``(2 E, 12)`` shares times strengths, the two coordinates in turn."""
    both = scene.shares[:, h, :, None, :] * scene.strength[:, None, :, None]
    return both.reshape(len(both), -1, 2).transpose(0, 2, 1).reshape(2 * len(both), -1)


class Reunion(NamedTuple):
    """Settings of ``reunite``.

    Attributes:
        q: diffusion of the velocity, m/s per square root of a second.
        slack: sd of how the offset between two who are together changes, metres.
        least: pairs believed less than this to be together are passed over.
    """

    q: float = 0.2
    slack: float = 1.0
    least: float = 0.05


def reunite(
    position: Floats, velocity: Floats, found: Floats, seconds: float, belief: Floats | None, settings: Reunion
) -> Ints:
    """Who is who when everybody comes back at once, without names: ``(n,)`` row of ``found`` for each person.

    Without ``belief``: the likeliest assignment at constant velocity. With it, people who were together come back
    together: each person's likelihoods are multiplied by those of the partners (loopy belief propagation over
    one-to-one assignments, balanced by rows and columns), and the likeliest assignment is taken in the end.

    Args:
        position, velocity: ``(n, 2)`` last known.
        found: ``(n, 2)`` where somebody is now.
        seconds: in between.
        belief: ``(n, n)`` probability of each two of being together.
    """
    from scipy.optimize import linear_sum_assignment

    away = ((position + seconds * velocity)[:, None] - found[None]) ** 2
    own = -0.5 * away.sum(axis=2) / (0.15**2 + settings.q**2 * seconds**3 / 3.0)
    score = own
    if belief is not None:
        tied = _tied(position, found, belief, settings)
        for _ in range(10):
            likely, told = _balanced(score), own.copy()
            for i, j, p, both in tied:
                told[i] += np.log(1.0 - p + p * (both @ likely[j]) + 1e-3)
                told[j] += np.log(1.0 - p + p * (both.T @ likely[i]) + 1e-3)
            score = 0.6 * told + 0.4 * score
    return linear_sum_assignment(-score)[1].astype(np.int64)


def _tied(position: Floats, found: Floats, belief: Floats, settings: Reunion) -> list[tuple[int, int, float, Floats]]:
    """For pairs that may be together: how much likelier each two finds are if they are than if they are not."""
    apart = found[:, None] - found[None]
    spacing = np.hypot(apart[..., 0], apart[..., 1]) + 0.1
    area = np.maximum(np.ptp(found[:, 0]), 1.0) * np.maximum(np.ptp(found[:, 1]), 1.0)
    out: list[tuple[int, int, float, Floats]] = []
    for i, j in zip(*np.nonzero(np.tril(belief, -1) > settings.least), strict=True):
        offset = position[i] - position[j]
        kept = np.exp(-0.5 * ((apart - offset) ** 2).sum(axis=2) / settings.slack**2) / (2 * np.pi * settings.slack**2)
        off = np.log(spacing / (np.hypot(*offset) + 0.1)) / 0.4  # or turned about each other, as far apart as before
        turned = np.exp(-0.5 * off**2) / (np.sqrt(2 * np.pi) * 0.4 * 2 * np.pi * spacing**2)
        both = np.minimum(0.5 * (kept + turned) * area, 40.0) + 0.05
        np.fill_diagonal(both, 0.0)
        out.append((int(i), int(j), float(belief[i, j]), both))
    return out


def _balanced(score: Floats) -> Floats:
    """Probabilities of a one-to-one assignment, rows and columns summing to one (Sinkhorn)."""
    from scipy.special import logsumexp

    for _ in range(20):
        score = score - logsumexp(score, axis=1, keepdims=True)
        score = score - logsumexp(score, axis=0, keepdims=True)
    return np.exp(score - logsumexp(score, axis=1, keepdims=True))
