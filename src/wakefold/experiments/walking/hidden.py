"""What company tells: where a hidden person is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Bools, Floats, Ints
from wakefold.relations.learning.walkers import Together, Walkers

LAG = 2  # frames: people do what their partner did


class Beside(NamedTuple):
    """Moments from which on somebody is hidden while somebody else stays in sight; one row for each two.

    Attributes:
        person, partner: ``(E,)`` who is hidden, who is seen.
        frame: ``(E,)`` the first hidden frame.
        belief: ``(E,)`` probability that they are together, given what was seen before.
        together: ``(E,)`` whether they are.
        alone: ``(E, H, 2)`` where the person would be at constant velocity.
        shares: ``(E, H, 4, 2)`` what the partner's way may add to that: how far the partner has left *its* constant
            velocity, how far the two velocities would take them apart, where the partner was, how far the partner had
            left its constant velocity two frames before.
        strength: ``(E, 4)`` on which the shares depend: 1, nearness, likeness of the velocities, whether they came at
            the same time side by side; 0 for pairs believed too little, which tell nothing.
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
    least: float = 1e-3,
) -> Beside:
    """All moments at which one of a pair may be hidden: both are there before, and all the while.

    Args:
        belief: ``(R,)`` probability of each pair up to each frame (``TogetherFit.over_time``).
        together: ``(K,)`` whether each pair is together; such pairs are kept however small the belief, so that all
            moments with company are there, but tell nothing below ``least``.
        hidden, before: frames hidden, and seen together before that.
        every: frames between moments.
        least: pairs believed less than this to be together tell nothing.
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
    left = partner - y[:, None] - later * w[:, None]
    earlier = np.concatenate([np.zeros_like(left[:, :LAG]), left[:, :-LAG]], axis=1)
    shares = np.stack([left, later * (w - v)[:, None], apart, earlier], axis=2)
    near = np.exp(-((y - x) ** 2).sum(axis=1) / 1.5**2)
    alike = 1.0 / (1.0 + np.hypot(*(w - v).T) / 0.3)
    strength = np.column_stack([np.ones(len(p)), near, alike, _came(walkers, i, j)]) * (p >= least)[:, None]
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
        taken: ``(H, 16)`` how much of each share to take at each frame.
        lift, power: partners count with (belief + lift x nearness x likeness) ** power.
    """

    taken: Floats
    lift: float
    power: float


def learn_company(scenes: Sequence[Beside], *, lift: float = 1.0, power: float = 4.0, ridge: float = 1e-2) -> Company:
    """Least squares over scenes with known groups, at the moments at which a hidden person has company in sight.

    What several partners say is learned as it is used: averaged. Scenes weigh with the square root of their number of
    moments.

    Args:
        lift, power: see ``Company``.
        ridge: share by which the diagonal of the normal equations is raised.
    """
    kept = [accompanied(scene) for scene in scenes]
    return solve([equations(scene, told(scene, lift, power)) for scene in kept], lift=lift, power=power, ridge=ridge)


def accompanied(scene: Beside, *, others: bool = False) -> Beside:
    """The rows of those people and moments with one of the own group in sight; or of the others."""
    _, which = _moments(scene)
    members = np.bincount(which, scene.together) > 0
    return scene.rows(members[which] != others)


class Told(NamedTuple):
    """What the partners of each hidden person say; made by ``told``.

    Attributes:
        first: ``(n,)`` first row of each person and moment.
        columns: ``(n, H, 16, 2)`` shares times strengths, averaged over the partners.
    """

    first: Ints
    columns: Floats


def equations(scene: Beside, said: Told) -> tuple[Floats, Floats]:
    """The normal equations of ``learn_company`` of one scene, ``(H, 16, 16)`` and ``(H, 16, 1)``."""
    count, frames, width, _ = said.columns.shape
    away = (scene.truth - scene.alone)[said.first]
    columns = said.columns.transpose(1, 2, 0, 3).reshape(frames, width, -1)
    weighed = count**-0.5 * columns
    return weighed @ columns.transpose(0, 2, 1), weighed @ away.transpose(1, 0, 2).reshape(frames, -1, 1)


def solve(parts: Sequence[tuple[Floats, Floats]], *, lift: float, power: float, ridge: float = 1e-2) -> Company:
    """``learn_company``, given the ``equations`` of each scene for this lift and power."""
    normal, right = np.zeros_like(parts[0][0]), np.zeros_like(parts[0][1])
    for own, target in parts:
        normal += own
        right += target
    width = len(normal[0])
    normal = normal * (1.0 + ridge * np.eye(width)) + 1e-9 * np.eye(width)  # nobody is late at first
    return Company(np.asarray(np.linalg.solve(normal, right)[:, :, 0], dtype=np.float64), lift, power)


def beside(scene: Beside, company: Company) -> tuple[Ints, Floats]:
    """Where each hidden person is thought to be: ``(n,)`` first row of each, ``(n, H, 2)`` positions."""
    said = told(scene, company.lift, company.power)
    return said.first, places(scene, said, company)


def places(scene: Beside, said: Told, company: Company) -> Floats:
    """``beside``, given what is ``told`` with the lift and the power of ``company``."""
    return scene.alone[said.first] + np.einsum("nhkd,hk->nhd", said.columns, company.taken)


def _moments(scene: Beside) -> tuple[Ints, Ints]:
    """``(n,)`` first row of each person and moment, ``(E,)`` which of them each row is."""
    if not len(scene.frame):
        return scene.person, scene.person
    start = scene.frame.min()
    name = scene.person * (scene.frame.max() - start + 1) + scene.frame - start
    _, first, which = np.unique(name, return_index=True, return_inverse=True)
    return first, which


def told(scene: Beside, lift: float, power: float) -> Told:
    """What partners say who count with ``lift`` and ``power``."""
    first, which = _moments(scene)
    heard, near, alike, _ = scene.strength.T
    weight = heard * ((scene.belief + lift * near * alike) ** power + 1e-6) + 1e-18
    weight /= np.bincount(which, weight)[which]
    order = np.argsort(which, kind="stable")
    parts = scene.shares[order], (weight[:, None] * scene.strength)[order]
    rows = (parts[0][:, :, :, None, :] * parts[1][:, None, None, :, None]).reshape(*parts[0].shape[:2], -1, 2)
    return Told(first, np.add.reduceat(rows, np.flatnonzero(np.diff(which[order], prepend=-1)), axis=0))
