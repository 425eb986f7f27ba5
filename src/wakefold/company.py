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
        strength: ``(E, 5)`` on which the shares depend: 1, belief, nearness, likeness of the velocities, whether they
            came at the same time side by side.
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
    strength = np.column_stack([np.ones(len(p)), p, near, alike, _came(walkers, i, j)])
    return Beside(i, j, frame, p, together[q], x[:, None] + later * v[:, None], shares, strength, truth).rows(seen)


def _came(walkers: Walkers, i: Ints, j: Ints) -> Floats:
    """``(E,)`` near 1 for two who came at the same time side by side, 0 where one was there from the beginning."""
    first = np.maximum(walkers.begin[i], walkers.begin[j])
    a, b = (walkers.position[walkers.offsets[x] + first - walkers.begin[x]] for x in (i, j))
    gap = np.abs(walkers.begin[i] - walkers.begin[j]) * walkers.dt
    before = np.minimum(walkers.begin[i], walkers.begin[j]) <= walkers.begin.min() + 2
    return np.where(before, 0.0, np.exp(-gap - ((a - b) ** 2).sum(axis=1) / 1.5**2))


class Company(NamedTuple):
    """What company tells of a hidden person; made by ``learn_company``.

    Attributes:
        taken: ``(H, 15)`` how much of each share to take at each frame.
        lift, power: partners count with (belief + lift x nearness x likeness) ** power.
    """

    taken: Floats
    lift: float
    power: float


def learn_company(scenes: Sequence[Beside], *, lift: float = 1.0, power: float = 2.0, ridge: float = 1e-3) -> Company:
    """Least squares over scenes with known groups, at the moments at which a hidden person has company in sight.

    What several partners say is learned as it is used: averaged. Scenes weigh with the square root of their number of
    moments.

    Args:
        lift, power: see ``Company``.
        ridge: share by which the diagonal of the normal equations is raised.
    """
    width, frames = 3 * scenes[0].strength.shape[1], scenes[0].truth.shape[1]
    normal, right = np.zeros((frames, width, width)), np.zeros((frames, width, 1))
    for scene in scenes:
        _, which = _moments(scene)
        accompanied = np.bincount(which, scene.together) > 0
        first, columns = _told(scene.rows(accompanied[which]), lift, power)
        away = (scene.truth - scene.alone)[accompanied[which]][first]
        weight = len(first) ** -0.5
        normal += weight * np.einsum("nhkd,nhld->hkl", columns, columns)
        right += weight * np.einsum("nhkd,nhd->hk", columns, away)[:, :, None]
    normal *= 1.0 + ridge * np.eye(width)
    return Company(np.asarray(np.linalg.solve(normal, right)[:, :, 0], dtype=np.float64), lift, power)


def beside(scene: Beside, company: Company) -> tuple[Ints, Floats]:
    """Where each hidden person is thought to be: ``(n,)`` first row of each, ``(n, H, 2)`` positions."""
    first, columns = _told(scene, company.lift, company.power)
    return first, scene.alone[first] + np.einsum("nhkd,hk->nhd", columns, company.taken)


def _moments(scene: Beside) -> tuple[Ints, Ints]:
    """``(n,)`` first row of each person and moment, ``(E,)`` which of them each row is."""
    _, first, which = np.unique(
        np.column_stack([scene.person, scene.frame]), axis=0, return_index=True, return_inverse=True
    )
    return first, which.ravel()


def _told(scene: Beside, lift: float, power: float) -> tuple[Ints, Floats]:
    """First rows as in ``_moments``; shares times strengths, averaged over the partners, ``(n, H, 15, 2)``."""
    first, which = _moments(scene)
    _, belief, near, alike, _ = scene.strength.T
    weight = (belief + lift * near * alike) ** power + 1e-6
    weight /= np.bincount(which, weight)[which]
    rows = (scene.shares[:, :, :, None, :] * (weight[:, None] * scene.strength)[:, None, None, :, None]).reshape(
        *scene.shares.shape[:2], -1, 2
    )
    out = np.zeros((len(first), *rows.shape[1:]))
    np.add.at(out, which, rows)
    return first, out


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
