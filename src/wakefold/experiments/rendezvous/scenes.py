"""Two ships at sea for two and a half hours: do they meet? Scenes for the comparison of recognisers.

The first experiment of Manfredotti et al. 2011 (Section 3) recognises the rendezvous of two ships; its data were never
published. Here a *rendezvous* is: two ships come together, stay within a few hundred metres of each other while they
drift or lie still for 6 to 40 minutes, and part. Ships that do something else are the negatives, easy ones
(crossing, overtaking, following in a lane) and hard ones (a near pass, a slow pass, at anchor apart).

Every ship cruises on a course of its own with slowly wandering speed and course. Where it slows, its velocity is a
mixture of the cruise and of what it does in the middle (drift with the other, lie still, creep past), with a ramp of 8
to 20 minutes on either side.

How hard the scenes are (how briefly ships meet, how slowly they pass, how closely they anchor) was set once, so that
the rule "near and slow for a while" is right about 95 times in 100 at noise of 200 m, before there was any other
recogniser.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from wakefold.base.types import Floats

DT, STEPS = 60.0, 150  # seconds, and how many of them
EASY = ("crossing", "overtaking", "lane following")
HARD = ("near pass", "slow pass", "anchored apart")
KINDS = ("rendezvous", *EASY, *HARD)
APPROACH, TOGETHER, PARTED = range(3)  # phases of a rendezvous
MINUTE, KM = 60.0, 1000.0


class Scenes(NamedTuple):
    """Scenes of two ships.

    Attributes:
        truth: ``(n, 2, T, 2)`` where each ship was, metres, every ``DT`` seconds.
        seen: ``(n, 2, T, 2)`` with noise; NaN where nothing was received.
        kind: ``(n,)`` which of ``KINDS``.
        phase: ``(n, T)`` of a rendezvous: approach, together, parted; -1 in the other scenes.
    """

    truth: Floats
    seen: Floats
    kind: NDArray[np.int64]
    phase: NDArray[np.int64]

    @property
    def positive(self) -> NDArray[np.bool_]:
        """``(n,)`` whether the ships met."""
        return self.kind == 0


def scenes(
    n: int, negatives: tuple[str, ...], sd: float, rng: Generator, *, missing: float = 0.0, share: float = 0.5
) -> Scenes:
    """Scenes in random order, ``share`` of them positive, the negatives evenly of the kinds named.

    Args:
        n: how many.
        negatives: of ``KINDS``, such as ``EASY`` or ``HARD``.
        sd: of the noise in either coordinate, metres.
        rng: draws everything.
        missing: probability that a position is not received.
        share: of the positives.

    Raises:
        ValueError: a kind that is none.
    """
    if unknown := [name for name in negatives if name not in KINDS]:
        raise ValueError(f"no scene is called {unknown[0]!r}: give some of {', '.join(KINDS[1:])}")
    meet = round(n * share)
    names = ["rendezvous"] * meet + [negatives[k % len(negatives)] for k in range(n - meet)]
    kind = rng.permutation([KINDS.index(name) for name in names])
    truth, phase = np.empty((n, 2, STEPS, 2)), np.full((n, STEPS), -1)
    for i in range(n):
        truth[i], together = _scene(KINDS[kind[i]], rng)
        if kind[i] == 0:
            phase[i] = np.where(together, TOGETHER, np.where(np.cumsum(together) > 0, PARTED, APPROACH))
    seen = truth + sd * rng.standard_normal(truth.shape)
    seen[rng.random(seen.shape[:3]) < missing] = np.nan
    return Scenes(truth, seen, kind, phase)


def _scene(kind: str, rng: Generator) -> tuple[Floats, NDArray[np.bool_]]:
    """Paths ``(2, T, 2)`` of one scene and ``(T,)`` when both ships were slow."""
    u = rng.uniform
    middle = u(55, 95) * MINUTE
    course, speed = u(0, 2 * np.pi, 2), u(4, 9, 2)
    bearing = u(0, 2 * np.pi)  # of the second ship from the first, in the middle
    slow = np.zeros((2, 2))  # velocities in the middle, m/s
    span = np.zeros((2, 2))  # seconds before and after the middle for which each ship is slow
    leaving = course + u(-np.pi / 2, np.pi / 2, 2)
    match kind:
        case "rendezvous":
            apart = u(0.05, 0.3) * KM
            slow[:] = _polar(u(0, 1.2), u(0, 2 * np.pi))
            half = u(6, 40) * MINUTE / 2
            span[:] = half
            if rng.random() < 1 / 3:  # one of them waits there for the other
                span[rng.integers(2)] += u(5, 40, 2) * MINUTE
        case "anchored apart":
            apart = u(0.4, 1.2) * KM
            span[:] = u(6, 30, (2, 2)) * MINUTE
        case "slow pass":
            apart = u(0.0, 0.3) * KM
            way = u(0, 2 * np.pi)
            slow[0], slow[1] = _polar(u(0.5, 1.5), way), _polar(u(0.5, 1.5), way + u(np.pi / 3, 5 * np.pi / 3))
            span[:] = u(6, 25, (2, 2)) * MINUTE
        case "near pass":
            apart, course[1] = u(0.0, 0.3) * KM, course[0] + u(np.pi / 6, 11 * np.pi / 6)
        case "crossing":
            apart, course[1] = u(0.5, 4) * KM, course[0] + u(np.pi / 5, 9 * np.pi / 5)
        case "overtaking":
            apart, course[1] = u(0.3, 1.5) * KM, course[0] + u(-0.1, 0.1)
            speed[1] = speed[0] + u(1, 4)
            bearing = course[0] + rng.choice([-1, 1]) * np.pi / 2
        case _:  # lane following
            apart, course[1], speed[1] = u(0.4, 3) * KM, course[0], speed[0] + u(-0.3, 0.3)
            bearing = course[0] + u(-0.1, 0.1)
    leaving = course if not span.any() else leaving
    shared = _wander(rng) * 0.1 if kind == "lane following" else np.zeros(STEPS)  # both follow the bends of the lane
    paths, weights = np.empty((2, STEPS, 2)), np.zeros((2, STEPS))
    time = np.arange(STEPS) * DT
    drift = 0.1 * np.stack([_wander(rng), _wander(rng)], axis=1)  # of the water: the same for both
    for ship in range(2):
        if span.any():
            ramp = u(8, 20, 2) * MINUTE
            begin, end = middle - span[ship, 0], middle + span[ship, 1]
            weights[ship] = np.interp(time, [begin - ramp[0], begin, end, end + ramp[1]], [0, 1, 1, 0])
        heading = np.where(time < middle, course[ship], leaving[ship]) + 0.04 * _wander(rng) + shared
        cruise = _polar(speed[ship] + 0.2 * _wander(rng), heading)
        resting = slow[ship] + drift
        velocity = weights[ship][:, None] * resting + (1 - weights[ship][:, None]) * cruise
        path = np.cumsum(velocity * DT, axis=0)
        at = np.array([np.interp(middle, time, path[:, k]) for k in range(2)])
        paths[ship] = path - at + ship * _polar(apart, bearing)
    return paths, (weights == 1).all(axis=0) & (kind == "rendezvous")


def _polar(length: float | Floats, angle: float | Floats) -> Floats:
    return np.stack(np.broadcast_arrays(length * np.cos(angle), length * np.sin(angle)), axis=-1)


def _wander(rng: Generator, correlation: float = 10 * MINUTE) -> Floats:
    """``(T,)`` an Ornstein-Uhlenbeck process of variance 1."""
    keep = float(np.exp(-DT / correlation))
    steps = rng.standard_normal(STEPS) * np.sqrt(1 - keep**2)
    out = []
    value = rng.standard_normal()
    for step in steps.tolist():  # plain numbers: four times as fast
        value = keep * value + step
        out.append(value)
    return np.array(out)
