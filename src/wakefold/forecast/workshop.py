"""Methods made from a model, each tuned on past tracks that are held back from its memory meanwhile."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from wakefold.base.parallel import Progress
from wakefold.base.remember import Remembers
from wakefold.base.types import Floats
from wakefold.forecast.classes import TRUE, Ledger, nearest_past
from wakefold.forecast.dressing import Dressed, fitted, held_back, mean_log, means
from wakefold.forecast.followed import follow
from wakefold.forecast.methods import (
    CONSTANT_VELOCITY,
    FILTERS,
    KALMAN,
    NEAREST,
    SLOW,
    TUNED,
    Method,
    answered,
    of_filter,
)
from wakefold.forecast.questions import Questions, Which, ask, thinning
from wakefold.forecast.rivals import ConstantVelocity, Kalman, NearestTrack, Past, Rival, Windows
from wakefold.forecast.samples import judged
from wakefold.model.model import Model, learn

VELOCITIES = (1.0, 1.5, 2.5, 5.0)  # times between fixes: windows over which a velocity is taken
NEIGHBOURS = (5, 10, 20, 40)
AMOUNTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of residuals added to neighbours
FORGETFUL = (CONSTANT_VELOCITY, KALMAN)  # they remember no tracks: all of them are held back from their memory
NOISES = 6  # of the Kalman filter that are tried
FIX_SD = (0.1, 0.3, 1.0)  # of the model's sd: that of the Kalman filter's fixes
SCALES, SDS = (0.25, 0.5, 1.0, 2.0), (0.5, 0.25, 1.0, 2.0)  # of the model's noise and sd: those of the filters
FOLLOWED = 100  # moments after which the settings of a filter are judged
NAMED, PRIORS = (10, 40, 160), (0.01, 0.05, 0.2, 0.5)  # neighbours that tell classes, and the share of the prior
CLASSED = 100  # tracks on which these are judged
MOST_TRACKS = 2000  # of the model that is learned from what is not held back
TOO_FEW = "too few past tracks to hold any back: rivals are tuned on what they remember"


class Workshop(Remembers):
    """Makes methods, from a model and the terms of the questions.

    Args:
        model: learned.
        terms: horizons, time between fixes and age from which on is asked, seconds, and which moments; see ``ask``.
        levels: of the classes that are asked for, metres.
        seed: of the filters.

    Attributes:
        notes: what should be known of how the methods were tuned.
    """

    def __init__(
        self, model: Model, terms: tuple[Sequence[float], float, float, Which], levels: list[float], seed: int = 0
    ) -> None:
        self.model, self.every, self.levels, self.seed = model, terms[1], levels, seed
        back = held_back(model.tracks)
        few = back.all() or not back.any()  # what the tracks themselves do is all there is to learn from
        self.memory, kept = (model.tracks, model.tracks) if few else (model.tracks.select(w) for w in (~back, back))
        self.held = ask(kept, *terms)
        self._terms = terms
        self.notes = [TOO_FEW] if few else []

    def make(self, names: Sequence[str], progress: Progress) -> list[Method]:
        """The methods of these names, tuned."""
        out = []
        for done, name in enumerate(names):
            out.append(self._filter(name) if name in FILTERS else self._rival(name))
            progress((done + 1) / len(names))
        return out

    # Plain rivals

    def _rival(self, name: str) -> Method:
        windows: list[dict[str, Any]] = [{"window": self.every * k} for k in VELOCITIES]
        if name == CONSTANT_VELOCITY:
            return self._dressed(name, windows, lambda _, setting: ConstantVelocity(**setting), (1.0,))
        if name == KALMAN:
            return self._dressed(name, self._kalmans(), lambda _, setting: Kalman(**setting), None)
        if name == NEAREST:
            return self._dressed(name, windows, lambda past, setting: NearestTrack(past, **setting), (1.0,))
        number = [{"number": k} for k in NEIGHBOURS]
        return self._dressed(name, number, lambda past, setting: Windows(past, **setting), AMOUNTS)

    def _dressed(
        self,
        name: str,
        settings: Sequence[dict[str, Any]],
        make: Callable[[Past, dict[str, Any]], Rival],
        amounts: Sequence[float] | None,
    ) -> Method:
        """A rival with the best settings; without amounts one that has a spread of its own, or else all residuals."""
        past, whole = (Past(tracks, self.every) for tracks in (self.memory, self.model.tracks))
        tried = [(partial(make, past, s), amounts or ((0.0,) if s["spread"] else (1.0,))) for s in settings]
        held = self._all if name in FORGETFUL else self.held
        dressed = fitted(tried, lambda k: make(whole, settings[k]), held)
        chosen = {
            f"{h:g}": settings[c.number] | {"residuals": c.amount}
            for h, c in zip(self.held.horizons, dressed.choices, strict=True)
        }
        tells = make(whole, settings[0])
        if not (self.levels and isinstance(tells, NearestTrack | Windows)):
            return Method(name, lambda asked, _: dressed.answer(asked), chosen)
        smaller: Any = make(Past(self._smaller.tracks, self.every), settings[0])
        number, prior = self._named(smaller)
        chosen["classes"] = {"number": number, "prior": prior}
        return Method(name, partial(_telling, dressed, tells, number, prior), chosen)

    def _kalmans(self) -> list[dict[str, Any]]:
        """Noises that span what constant velocity is wrong by, sd of fixes, and either kind of answer."""
        held, h = self._all, self._all.horizons
        speed = float(np.sqrt(np.square(held.velocity(self.every)).sum() / max(2 * len(held), 1))) or 1.0
        off = np.square(held.truth - ConstantVelocity(self.every).ensemble(held)[:, :, 0])
        known = np.isfinite(off[:, :, 0]).any(axis=0)
        strength = np.append(3.0 * np.nanmedian(off[:, known], axis=(0, 2)) / h[known] ** 3, speed**2 / h[-1])
        strength = strength[strength > 0]
        noises = np.geomspace(strength.min() / 4, strength.max() * 4, NOISES)
        return [
            {"q": float(q), "r": self.model.sd * share, "speed": speed, "spread": spread}
            for q, share, spread in itertools.product(noises, FIX_SD, (True, False))
        ]

    def _named(self, rival: NearestTrack | Windows) -> tuple[int, float]:
        """How many neighbours tell the class, and the share of the prior: by -log p on tracks held back.

        Args:
            rival: of the memory of the smaller model.
        """
        some, tree = self.held.of(thinning(len(self.held.fixes), CLASSED)), self._smaller.filtration
        truth = nearest_past(self._smaller, some.fixes)
        best = (np.inf, NAMED[0], PRIORS[-1])
        for number in NAMED if isinstance(rival, Windows) else (1,):
            named = rival.tracks_at(replace(some, row=some.class_row.ravel()), number)
            for prior in PRIORS:
                ledger = Ledger(tree, truth, self.levels)
                ledger.tracks(named, prior)
                best = min(best, (float(-np.log(ledger.found[..., TRUE]).mean()), number, prior))
        return best[1:]

    # Filters

    def _filter(self, name: str) -> Method:
        if name not in TUNED:
            return of_filter(name, FILTERS[name](self.model, seed=self.seed))
        scale, sd = self._tuned(name)
        made = FILTERS[name](_noisy(self.model, scale), sd=sd, seed=self.seed)
        return of_filter(name, made, {"scale": scale, "sd": sd})

    def _tuned(self, name: str) -> tuple[float, float]:
        """Noise of motion and sd of a fix: one after the other, on some of the tracks held back."""
        scale, sd = self.model.dynamics.scale, self.model.sd
        most = FOLLOWED // 4 if name in SLOW else FOLLOWED
        each = max(1, round(len(self.held) / most / 2))
        asked = self.held.of(np.arange(0, len(self.held.fixes), each)).thinned(most)
        if not len(asked):
            return scale, sd

        def worth(scale: float, sd: float) -> float:
            filter = FILTERS[name](_noisy(self._smaller, scale), sd=sd, seed=self.seed)
            samples, _ = answered(follow(filter, asked), asked, lambda: ConstantVelocity(self.every).ensemble(asked))
            return mean_log(means([judged(samples, asked.truth).energy], len(asked.horizons)))

        best = min((worth(scale * k, sd * SDS[0]), scale * k, sd * SDS[0]) for k in SCALES)
        best = min(best, *((worth(best[1], sd * k), best[1], sd * k) for k in SDS[1:]))
        return best[1:]

    @cached_property
    def _all(self) -> Questions:
        """Questions about all past tracks, for what remembers none."""
        return ask(self.model.tracks, *self._terms)

    @cached_property
    def _smaller(self) -> Model:
        """A model of what is not held back, or the last part of it."""
        m, first = self.model, max(0, len(self.memory) - MOST_TRACKS)
        tracks = self.memory.select(np.arange(first, len(self.memory)))
        d, linkage = m.dynamics, m.filtration.linkage
        return learn(tracks, linkage=linkage, epsilon=d.epsilon, noise=d.noise, scale=d.scale, sd=m.sd)


def _telling(
    dressed: Dressed, rival: NearestTrack | Windows, number: int, prior: float, asked: Questions, ledger: Ledger | None
) -> Floats:
    if ledger is not None:
        ledger.tracks(rival.tracks_at(replace(asked, row=asked.class_row.ravel()), number), prior)
    return dressed.answer(asked)


def _noisy(model: Model, scale: float) -> Model:
    """The model with other noise of motion."""
    return replace(model, dynamics=replace(model.dynamics, scale=scale))
