"""Plain answers made into samples: what a method was wrong by on tracks held back from its memory is added to them.

What it was wrong by is kept in the agent's own frame, along and across the way it heads. How much of it is added, and
the settings of a rival, are chosen on the tracks held back: residuals of every other track, scored on the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from wakefold.base.types import Floats
from wakefold.forecast.questions import Questions
from wakefold.forecast.rivals import Rival
from wakefold.forecast.samples import SAMPLES, evenly, judged, middles
from wakefold.tracks.tracks import Tracks

HELD_BACK = 0.2  # of the past tracks
EACH = 5  # where tracks have no order in time, every so many is held back
FEWEST = 10  # residuals that stand for a horizon; fewer are left for those of the next one
MOST = 400  # moments on which a setting is scored
TURN = 37  # so many residuals on from one sample to the next; it shares no factor with the number of samples


class Choice(NamedTuple):
    """A setting of a rival for one horizon.

    Attributes:
        number: of the setting.
        residuals: ``(S, d)`` along and across the way the agent heads.
        amount: what part of them is added.
    """

    number: int
    residuals: Floats
    amount: float


class Dressed(NamedTuple):
    """A rival with residuals: for each horizon the setting that did best on the tracks held back.

    Attributes:
        rivals: by the number of their setting, with all their memory.
        choices: one for each horizon.
    """

    rivals: dict[int, Rival]
    choices: list[Choice]

    def answer(self, asked: Questions) -> Floats:
        """``(Q, H, S, d)`` samples."""
        out = np.empty((len(asked), len(self.choices), SAMPLES, asked.fixes.dim))
        for number, rival in self.rivals.items():
            chosen = [h for h, choice in enumerate(self.choices) if choice.number == number]
            some = replace(asked, horizons=asked.horizons[chosen], truth=asked.truth[:, chosen])
            ensemble, frame = rival.ensemble(some), frames(rival.heading(some))
            for k, h in enumerate(chosen):
                out[:, h] = worn(ensemble[:, k], frame, self.choices[h].residuals, self.choices[h].amount)
        return out


def worn(ensemble: Floats, frame: Floats, residuals: Floats, amount: float) -> Floats:
    """``(Q, S, d)`` samples from an ensemble ``(Q, k, d)`` and a part of residuals ``(S, d)`` in the frames."""
    chosen = ensemble[:, evenly(ensemble.shape[1])]
    if not amount:
        return chosen
    turn = 1 if ensemble.shape[1] == 1 else TURN
    return chosen + np.einsum("qaf,sf->qsa", frame, amount * residuals[turn * np.arange(SAMPLES) % SAMPLES])


def frames(velocity: Floats) -> Floats:
    """``(Q, d, d)`` the axes of each agent's own frame as columns: along its velocity, and across it to the left.

    Of an agent that stands still, and beyond the plane, they are those of the map.
    """
    count, dim = velocity.shape
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    out = np.tile(np.eye(dim), (count, 1, 1))
    if dim < 2:
        return out
    moving = speed > 0
    along = velocity[moving, :2] / speed[moving, None]
    out[moving, :2, 0] = along
    out[moving, :2, 1] = along[:, ::-1] * (-1.0, 1.0)
    return out


def residuals(truth: Floats, middle: Floats, frame: Floats, horizons: Floats) -> Floats:
    """``(H, S, d)`` an even choice of what answers were wrong by, in the frames of the agents.

    In the order of what they are along the way. A horizon that too few tracks last for takes those of the nearest one
    that has enough, in proportion to the horizons; none at all are 0.
    """
    off = np.einsum("qaf,qha->qhf", frame, truth - middle)
    known = np.isfinite(off[:, :, 0])
    out = np.zeros((len(horizons), SAMPLES, truth.shape[2]))
    good = np.flatnonzero(known.sum(axis=0) >= FEWEST)
    if not len(good):
        return out
    for h in range(len(horizons)):
        at = good[np.argmin(np.abs(good - h))]
        own = off[known[:, at], at]
        own = own[np.argsort(own[:, 0], kind="stable")]
        out[h] = own[evenly(len(own))] * horizons[h] / horizons[at]
    return out


def held_back(tracks: Tracks) -> np.ndarray:
    """``(M,)`` which of the past tracks are held back: the last fifth by time; every fifth where time tells nothing."""
    begin = tracks.times[tracks.offsets[:-1]]
    out = np.zeros(len(tracks), dtype=np.bool_)
    if np.ptp(begin) > 2 * np.median(tracks.duration) and len(np.unique(begin)) > EACH:
        out[begin >= np.quantile(begin, 1.0 - HELD_BACK)] = True
    else:
        out[EACH - 1 :: EACH] = True
    return out


def fitted(
    settings: Sequence[tuple[Callable[[], Rival], Sequence[float]]], whole: Callable[[int], Rival], held: Questions
) -> Dressed:
    """A rival with the settings and residuals that do best for each horizon.

    Args:
        settings: for each, how a rival whose memory lacks the tracks held back is made, and the amounts of residuals to
            try.
        whole: the rival with all its memory, by the number of a setting.
        held: questions about the tracks held back.
    """
    tracks, horizons = np.arange(len(held.fixes)), held.horizons
    if not len(held):
        return Dressed({0: whole(0)}, [Choice(0, np.empty((0, held.fixes.dim)), 0.0)] * len(horizons))
    halves = [half for k in (0, 1) if len(half := held.of(tracks[k::2]).thinned(MOST))]
    tried, scores = [], []
    for number, (make, amounts) in enumerate(settings):
        rival = make()
        ensembles = [rival.ensemble(half) for half in halves]
        turned = [frames(rival.heading(half)) for half in halves]
        own = [
            _off(*three, horizons) if any(amounts) else np.zeros((len(horizons), SAMPLES, held.fixes.dim))
            for three in zip(halves, ensembles, turned, strict=True)
        ]
        for amount in amounts:
            energy = []
            for k, half in enumerate(halves):
                other = own[(k + 1) % len(halves)]
                answers = [worn(ensembles[k][:, h], turned[k], other[h], amount) for h in range(len(horizons))]
                energy.append(judged(np.stack(answers, axis=1), half.truth).energy)
            tried.append((number, amount))
            scores.append(means(energy, len(horizons)))
    table = np.reshape(scores, (-1, len(horizons)))
    total = np.array([mean_log(row) for row in table])
    # A horizon that no track held back lasts for takes what is best for the others.
    best = [int(np.argmin(table[:, h] if np.isfinite(table[:, h]).any() else total)) for h in range(len(horizons))]
    thin, choices = held.thinned(4 * MOST), []
    for number in dict.fromkeys(tried[k][0] for k in best):
        rival = settings[number][0]()
        own = _off(thin, rival.ensemble(thin), frames(rival.heading(thin)), horizons)
        choices += [(h, Choice(number, own[h], tried[k][1])) for h, k in enumerate(best) if tried[k][0] == number]
    ordered = [choice for _, choice in sorted(choices, key=lambda each: each[0])]
    return Dressed({number: whole(number) for number in {c.number for c in ordered}}, ordered)


def _off(asked: Questions, ensemble: Floats, frame: Floats, horizons: Floats) -> Floats:
    middle = ensemble[:, :, 0] if ensemble.shape[2] == 1 else middles(ensemble)
    return residuals(asked.truth, middle, frame, horizons)


def means(energy: Sequence[Floats], horizons: int) -> Floats:
    """``(H,)`` mean energy score of some parts of the questions; inf for a horizon that nothing was asked of."""
    every = np.concatenate([np.empty((0, horizons)), *energy])
    number = np.isfinite(every).sum(axis=0)
    return np.divide(np.nansum(every, axis=0), number, out=np.full(horizons, np.inf), where=number > 0)


def mean_log(energy: Floats) -> float:
    """Mean of the logarithm of mean energy scores over the horizons that were asked of; inf without any."""
    asked = np.isfinite(energy)
    return float(np.log(np.maximum(energy[asked], 1e-300)).mean()) if asked.any() else np.inf
