"""Those who compete with the relational filter at telling a rendezvous: hidden Markov models, and a rule.

A recogniser gives each scene a score; at which score it says "rendezvous" is chosen on the training part. The hidden
Markov models are given everything they could want: positions as received or after a Kalman filter or smoother, the
phases of the positive scenes or none, and as many states as explain held-out scenes best.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.experiments.rendezvous.scenes import DT, STEPS, TOGETHER, Scenes
from wakefold.filters.hmm import GaussianHMM
from wakefold.relations.smoothing import constant_velocity

TIMES = np.arange(STEPS) * DT
SPEED = 5.0  # m/s per axis, of ships at sea


class Threshold(NamedTuple):
    """The score at which a recogniser says "rendezvous", and its F1 on the scenes it was chosen on."""

    score: float
    f1: float


def threshold(scores: Floats, positive: NDArray[np.bool_]) -> Threshold:
    """The score from which on "rendezvous" is said, for the best F1; the middle of the widest gap of equally good."""
    values = np.unique(scores)
    cuts = np.concatenate([[values[0] - 1], (values[:-1] + values[1:]) / 2])
    width = np.concatenate([[0.0], np.diff(values)])
    order = np.argsort(scores)
    hits = np.concatenate([[0], np.cumsum(positive[order])])
    below = np.searchsorted(scores[order], cuts)
    found = hits[-1] - hits[below]
    quality = 2 * found / np.maximum(len(scores) - below + hits[-1], 1)
    best = np.flatnonzero(quality >= quality.max() - 1e-12)
    at = best[np.argmax(width[best])]
    return Threshold(float(cuts[at]), float(quality[at]))


# What the ships did, by a plain Kalman filter


class Motion(NamedTuple):
    """Positions and velocities of both ships in every scene, ``(n, 2, T, 2)``, metres and m/s; NaN before the first."""

    position: Floats
    velocity: Floats


def kalman(scenes: Scenes, sd: float, q: float, *, smooth: bool) -> Motion:
    """Each ship by itself."""
    seen = scenes.seen
    if np.isfinite(seen).all():  # one covariance serves all ships, side by side as further axes
        n = len(seen)
        state = constant_velocity(
            seen.transpose(2, 0, 1, 3).reshape(STEPS, -1), TIMES, sd, q=q, speed=SPEED, smooth=smooth
        )
        position, velocity = (x.reshape(STEPS, n, 2, 2).transpose(1, 2, 0, 3) for x in (state.position, state.velocity))
        return Motion(np.ascontiguousarray(position), np.ascontiguousarray(velocity))
    out = Motion(np.empty_like(seen), np.empty_like(seen))
    for i, ship in np.ndindex(seen.shape[:2]):
        state = constant_velocity(seen[i, ship], TIMES, sd, q=q, speed=SPEED, smooth=smooth)
        out.position[i, ship], out.velocity[i, ship] = state.position, state.velocity
    return out


def received(scenes: Scenes) -> Motion:
    """The positions as received, in straight lines between them."""
    position = scenes.seen.copy()
    for i, ship in np.argwhere(np.isnan(position[..., 0]).any(axis=2)):
        seen = scenes.seen[i, ship]
        heard = np.isfinite(seen[:, 0])
        for axis in range(2):
            position[i, ship, :, axis] = np.interp(TIMES, TIMES[heard], seen[heard, axis])
    return Motion(position, np.gradient(position, DT, axis=2))


def position_error(position: Floats, scenes: Scenes) -> float:
    """Root mean square error over all scenes, ships and steps, metres."""
    return float(np.sqrt(np.nanmean(((position - scenes.truth) ** 2).sum(axis=-1))))


# The rule


class Nearness(NamedTuple):
    """How far apart two ships are, metres, and how fast the faster one is, m/s: ``(n, T)``."""

    distance: Floats
    speed: Floats

    @classmethod
    def of(cls, view: Motion) -> Nearness:
        apart = view.position[:, 0] - view.position[:, 1]
        return cls(np.linalg.norm(apart, axis=-1), np.linalg.norm(view.velocity, axis=-1).max(axis=1))


class Rule(NamedTuple):
    """Near and slow for a while.

    Attributes:
        near: metres.
        slow: m/s, of the faster ship.
    """

    near: float
    slow: float


def near_and_slow(ships: Nearness, rules: Sequence[Rule]) -> Floats:
    """``(rules, n)`` seconds of the longest time without a break that two ships were near and slow."""
    near, slow = (np.array(limits)[:, None] for limits in zip(*rules, strict=True))
    run, longest = np.zeros((len(rules), len(ships.speed))), np.zeros((len(rules), len(ships.speed)))
    for distance, speed in zip(ships.distance.T, ships.speed.T, strict=True):
        now = (distance < near) & (speed < slow)
        run = (run + 1) * now
        np.maximum(longest, run, out=longest)
    return longest * DT


# Hidden Markov models


def features(view: Motion) -> list[Floats]:
    """Of each scene ``(T, 3)``: logarithms of the distance, of the faster ship's speed, of the relative speed."""
    distance, speed = Nearness.of(view)
    relative = np.linalg.norm(view.velocity[:, 0] - view.velocity[:, 1], axis=-1)
    return list(np.log(np.stack([distance + 10.0, speed + 0.1, relative + 0.1], axis=-1)))


class States(NamedTuple):
    """Numbers of states of the hidden Markov models of positive and of negative scenes."""

    positive: int
    negative: int


def _of(x: Sequence[Floats], which: NDArray[np.bool_]) -> list[Floats]:
    return [part for part, chosen in zip(x, which, strict=True) if chosen]


def _ratio(yes: GaussianHMM, no: GaussianHMM, x: Sequence[Floats]) -> Floats:
    return np.array([yes.log_likelihood(part) - no.log_likelihood(part) for part in x])


def two_class(
    x: Sequence[Floats], scenes: Scenes, asked: Sequence[Floats], states: States, rng: Generator
) -> tuple[Floats, Floats]:
    """Scores of the training and of the asked scenes: log-likelihood ratio of two models learned without phases."""
    yes = GaussianHMM.learn(_of(x, scenes.positive), states.positive, rng, rounds=20)
    no = GaussianHMM.learn(_of(x, ~scenes.positive), states.negative, rng, rounds=20)
    return _ratio(yes, no, x), _ratio(yes, no, asked)


def phased(
    x: Sequence[Floats], scenes: Scenes, asked: Sequence[Floats], states: States, rng: Generator
) -> tuple[Floats, Floats]:
    """The same, but the states of the positive model are the phases of a rendezvous, as labelled."""
    yes = GaussianHMM.learn_labelled(_of(x, scenes.positive), list(scenes.phase[scenes.positive]), 3)
    no = GaussianHMM.learn(_of(x, ~scenes.positive), states.negative, rng, rounds=20)
    return _ratio(yes, no, x), _ratio(yes, no, asked)


def decoded(
    x: Sequence[Floats], scenes: Scenes, asked: Sequence[Floats], states: States, rng: Generator
) -> tuple[Floats, Floats]:
    """Scores: expected number of steps in the phase "together" of one model, phases and states of the negatives side
    by side."""
    no = GaussianHMM.learn(_of(x, ~scenes.positive), states.negative, rng, rounds=20)
    labels = [
        phase if positive else 3 + no.viterbi(part)[0]
        for part, phase, positive in zip(x, scenes.phase, scenes.positive, strict=True)
    ]
    used = np.unique(np.concatenate(labels))
    labels = [np.searchsorted(used, label) for label in labels]
    both = GaussianHMM.learn_labelled(x, labels, len(used))

    def scores(sequences: Sequence[Floats]) -> Floats:
        return np.array([both.posterior(part)[:, TOGETHER].sum() for part in sequences])

    return scores(x), scores(asked)
