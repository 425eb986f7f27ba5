"""Who is who when everybody comes back at once, without names, after nobody was seen for a while."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats, Ints

NOISE, OFFSET_NOISE = 0.15, 0.1  # metres: of a return, and of the offset of two
SPREAD = 0.4  # sd of the log spacing of two who have changed sides
WORST, BEST = -4.0, 30.0  # least and most that a tie says
CHAINS, SWEEPS, COOLING, HOT = 16, 3000, 2000, 0.2  # of the exchanges; a sweep is one for each person


class Reunion(NamedTuple):
    """How people come back; made by ``learn_reunion``.

    Attributes:
        q: diffusion of the velocity, m/s per square root of a second.
        slack, by_speed, by_spacing: scale of how the offset of two who are together changes: metres, more for each m/s
            of their speed and for each metre between them.
        tail: degrees of freedom of that change (Student).
        mixed: share of twos who keep their spacing but not their sides.
        least: pairs believed less than this to be together are passed over.
    """

    q: float = 0.2
    slack: float = 0.02
    by_speed: float = 0.15
    by_spacing: float = 0.1
    tail: float = 2.0
    mixed: float = 0.05
    least: float = 0.02


class Window(NamedTuple):
    """People last seen at one moment, and where they, or some people, were found later.

    Attributes:
        position, velocity: ``(n, 2)`` last known, metres and m/s.
        found: ``(n, 2)`` where somebody was found.
        seconds: in between.
    """

    position: Floats
    velocity: Floats
    found: Floats
    seconds: float


def learn_reunion(scenes: Sequence[Sequence[tuple[Window, Floats]]], q: float = 0.2) -> Reunion:
    """How the offset of two who are together changes: maximum likelihood over scenes with known groups and names.

    Scenes weigh with the square root of their number of pairs.

    Args:
        scenes: for each, its windows, ``found`` in the order of the people, with ``(n, n)`` who is together.
        q: see ``Reunion``.

    Raises:
        ValueError: no pair together in any window.
    """
    from scipy.optimize import minimize

    seen: list[_Change] = []
    for windows in scenes:
        parts = [_change(w, i, j, i, j) for w, pairs in windows for i, j in [np.nonzero(np.tril(pairs, -1) > 0)]]
        seen.append(_Change(*(np.concatenate(column) for column in zip(*parts, strict=True))))
    weights = np.sqrt([len(s.speed) for s in seen])
    if not weights.sum():
        raise ValueError("learn_reunion needs people who are together in some window")

    def settings(x: Floats) -> Reunion:
        a, b, c, d, e = np.exp(x).tolist()
        return Reunion(q, a, b, c, 1.0 + d, 1.0 / (1.0 + e))

    def loss(x: Floats) -> float:
        told = [_offset(s, settings(x)).mean() * w for s, w in zip(seen, weights, strict=True) if w]
        return float(-np.sum(told) / weights.sum() + 1e-3 * (x**2).sum())

    start = np.array([-1.0, -1.0, -2.0, 1.0, 2.0])
    best = minimize(loss, start, method="Nelder-Mead", options={"maxiter": 4000, "xatol": 1e-3, "fatol": 1e-5})
    return settings(best.x)


def reunite(window: Window, belief: Floats | None, settings: Reunion, seed: int = 0) -> Ints:
    """Who is who: ``(n,)`` row of ``found`` for each person.

    Without ``belief``: the likeliest assignment at constant velocity. With it, each pair adds the log of how much
    likelier its two finds are if they are together, times the belief; of one person's pairs no more counts than one.
    Names are then exchanged at random (Metropolis), and each person is given the place so that most names are
    expected to be right.

    Args:
        belief: ``(n, n)`` probability of each two of being together.
        seed: of the exchanges.
    """
    from scipy.optimize import linear_sum_assignment

    from wakefold.experiments.walking import kernels as kernel

    x, v, found, seconds = window
    n, variance = len(x), NOISE**2 + settings.q**2 * seconds**3 / 3.0
    away = ((x + seconds * v)[:, None] - found[None]) ** 2
    own = -0.5 * away.sum(axis=2) / variance - np.log(2.0 * np.pi * variance)
    names = linear_sum_assignment(-own)[1].astype(np.int64)
    if belief is None:
        return names
    first, second = (side.astype(np.int64) for side in np.nonzero(np.tril(belief, -1) > settings.least))
    if not len(first):
        return names
    p, company = belief[first, second], np.maximum(belief.sum(axis=1), 1.0)
    shape = len(first), n, n
    place = np.broadcast_to(np.arange(n)[:, None], shape), np.broadcast_to(np.arange(n)[None], shape)
    change = _change(window, first[:, None, None], second[:, None, None], *place)
    both = -0.5 * change.middle / variance - np.log(2.0 * np.pi * variance) + _offset(change, settings)
    tie = np.clip(both - own[first][:, :, None] - own[second][:, None, :], WORST, BEST)
    tie *= (p / np.maximum(company[first], company[second]))[:, None, None]
    ends = np.concatenate([first, second])
    member = (np.argsort(ends, kind="stable") % len(first)).astype(np.int64)
    begin = np.concatenate([[0], np.cumsum(np.bincount(ends, minlength=n))]).astype(np.int64)
    ties = kernel.Ties(tie, first, second, begin, member)
    count, rng = np.zeros((n, n)), np.random.default_rng(seed)
    for _ in range(CHAINS):
        draws = rng.random((SWEEPS * n, 5))
        kernel.exchange(own, ties, names.copy(), draws, COOLING * n, HOT, count)
    return linear_sum_assignment(-count)[1].astype(np.int64)


class _Change(NamedTuple):
    """What has become of twos: squares of how far their middle is off constant velocity, and how far their offset is
    off the one before, as it was and turned as they have turned; speed before, spacing before and after.
    """

    speed: Floats
    middle: Floats
    kept: Floats
    turned: Floats
    before: Floats
    after: Floats


def _change(window: Window, i: NDArray, j: NDArray, a: NDArray, b: NDArray) -> _Change:
    """People ``i`` and ``j`` found at places ``a`` and ``b``; the arrays are broadcast."""
    x, v, found, seconds = window
    offset, mean = x[i] - x[j], 0.5 * (v[i] + v[j])
    way, now = 0.5 * (found[a] + found[b] - x[i] - x[j]), found[a] - found[b]
    speed, far = np.hypot(*np.moveaxis(mean, -1, 0)), np.hypot(*np.moveaxis(way, -1, 0))
    # nobody who stands or has not moved is said to have turned
    scale = np.where((far > 1.5) & (speed > 0.3), 1.0 / np.maximum(speed * far, 1e-9), 0.0)
    cos = np.where(scale > 0, (mean * way).sum(axis=-1) * scale, 1.0)
    sin = (mean[..., 0] * way[..., 1] - mean[..., 1] * way[..., 0]) * scale
    turned = np.stack(
        [cos * offset[..., 0] - sin * offset[..., 1], sin * offset[..., 0] + cos * offset[..., 1]], axis=-1
    )
    return _Change(
        *np.broadcast_arrays(
            speed,
            ((way - seconds * mean) ** 2).sum(axis=-1),
            ((now - offset) ** 2).sum(axis=-1),
            ((now - turned) ** 2).sum(axis=-1),
            np.hypot(offset[..., 0], offset[..., 1]),
            np.hypot(now[..., 0], now[..., 1]),
        )
    )


def _offset(change: _Change, settings: Reunion) -> Floats:
    """Log-density of the offset of two who are together, given the one before and where their middle went."""
    scale = settings.slack + settings.by_speed * change.speed + settings.by_spacing * change.before
    variance = OFFSET_NOISE**2 + scale**2
    tail = settings.tail

    def student(square: Floats) -> Floats:
        return -np.log(2.0 * np.pi * variance) - (0.5 * tail + 1.0) * np.log1p(square / (tail * variance))

    sides = np.logaddexp(student(change.kept), student(change.turned)) - np.log(2.0)
    wide = np.log((change.after + 0.1) / (change.before + 0.1)) / SPREAD
    ring = -0.5 * wide**2 - np.log(np.sqrt(2.0 * np.pi) * SPREAD * 2.0 * np.pi * (change.after + 0.1) ** 2)
    return np.logaddexp(sides + np.log1p(-settings.mixed), ring + np.log(settings.mixed))
