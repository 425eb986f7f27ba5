"""Plain rivals: what a user would write in an hour.

Each is made from past tracks and a setting. It answers by an ensemble of k places for each question, and says which
way the agent heads, so that ``dressing`` can add what such answers were wrong by.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints
from wakefold.forecast import kernels
from wakefold.forecast.questions import Questions, back
from wakefold.forecast.samples import normal_samples
from wakefold.tracks.tracks import Tracks

SAME_WAY = np.cos(np.radians(45.0))  # the nearest track must go about the same way
CANDIDATES = 64  # points of past tracks of which the nearest that goes the same way is taken
WINDOW = 5  # places of a window
MORE = 3  # times as many windows are looked up as are wanted: tracks that end too early are left out


class Rival(Protocol):
    """A plain method, made from past tracks and a setting."""

    def ensemble(self, asked: Questions) -> Floats:
        """``(Q, H, k, d)`` where the agent may be."""
        ...

    def heading(self, asked: Questions) -> Floats:
        """``(Q, d)`` velocity, whose direction is that of the agent's own frame."""
        ...


class Past(NamedTuple):
    """The past tracks of a method: those of the model or a part of them.

    Attributes:
        tracks: what is remembered.
        every: seconds between the fixes of the questions.
    """

    tracks: Tracks
    every: float


class ConstantVelocity(NamedTuple):
    """On from the last fix with the mean velocity over a window.

    Attributes:
        window: seconds.
    """

    window: float

    def ensemble(self, asked: Questions) -> Floats:
        velocity = asked.velocity(self.window)
        return (asked.here[:, None] + asked.horizons[:, None] * velocity[:, None])[:, :, None]

    def heading(self, asked: Questions) -> Floats:
        return asked.velocity(self.window)


class Kalman(NamedTuple):
    """Constant velocity with white-noise acceleration.

    Attributes:
        q: strength of the noise, m²/s³.
        r: sd of a fix, metres per axis.
        speed: sd of the velocity of an agent never seen before, m/s per axis.
        spread: whether it answers by samples of its own Gaussian, or by its mean.
    """

    q: float
    r: float
    speed: float
    spread: bool = True

    def _filtered(self, asked: Questions) -> tuple[Floats, Floats]:
        fixes = asked.fixes
        states, covs = np.empty((len(fixes.points), 2, fixes.dim)), np.empty((len(fixes.points), 3))
        kernels.kalman(fixes.points, fixes.times, fixes.offsets, self.q, self.r, self.speed, states, covs)
        return states[asked.row], covs[asked.row]

    def ensemble(self, asked: Questions) -> Floats:
        states, covs = self._filtered(asked)
        h = asked.horizons
        mean = states[:, None, 0] + h[:, None] * states[:, None, 1]
        if not self.spread:
            return mean[:, :, None]
        a, b, c = (covs[:, i, None] for i in range(3))
        sd = np.sqrt(a + 2 * h * b + h**2 * c + self.q * h**3 / 3)
        return mean[:, :, None] + sd[:, :, None, None] * normal_samples()

    def heading(self, asked: Questions) -> Floats:
        return self._filtered(asked)[0][:, 1]


class NearestTrack(Remembers):
    """On along the past track that is nearest to the last fix and goes within 45 degrees of the same way.

    Args:
        past: what is remembered.
        window: seconds over which the velocity is taken.
    """

    def __init__(self, past: Past, window: float) -> None:
        self.past, self.window = past.tracks, window

    @cached_property
    def _search(self) -> tuple[Any, Ints, Floats]:
        from scipy.spatial import KDTree

        past = self.past
        track = np.repeat(np.arange(len(past)), past.lengths)
        step = np.zeros_like(past.points)
        step[:-1] = np.where((track[1:] == track[:-1])[:, None], np.diff(past.points, axis=0), 0.0)
        return KDTree(past.points), track, step

    def nearest(self, asked: Questions) -> Ints:
        """``(Q,)`` the point of the past tracks."""
        return self.points_near(asked.here, asked.velocity(self.window))

    def points_near(self, here: Floats, way: Floats) -> Ints:
        """``(Q,)`` the point of the past tracks nearest to each place and going the same way."""
        search, _, step = self._search
        found = search.query(here, k=min(CANDIDATES, len(self.past.points)))[1].reshape(len(here), -1)
        steps = step[found]
        along = np.einsum("qkd,qd->qk", steps, way)
        fits = along > SAME_WAY * np.linalg.norm(steps, axis=2) * np.linalg.norm(way, axis=1)[:, None]
        return found[np.arange(len(found)), np.argmax(fits, axis=1)]  # the nearest of all where none fits

    def tracks_at(self, asked: Questions, count: int) -> Ints:
        """``(Q, 1)`` the past track, however many are asked for."""
        return self._search[1][self.nearest(asked)][:, None]

    def ensemble(self, asked: Questions) -> Floats:
        past, best = self.past, self.nearest(asked)
        when = past.times[best][:, None] + asked.horizons  # a track that ends stays where it ended
        there = np.empty((*when.shape, past.dim))
        kernels.places(past.points, past.times, past.offsets, self._search[1][best], when, there)
        return (asked.here[:, None] + there - past.points[best][:, None])[:, :, None]

    def heading(self, asked: Questions) -> Floats:
        return asked.velocity(self.window)


class Windows(Remembers):
    """Where those went that came here as the agent did: the past windows of five places nearest to its own.

    A window is the place now and at four moments before, one time between fixes apart. Each neighbour adds its own
    displacement to where the agent is. Neighbours that ended before a horizon have nothing to say of it.

    Args:
        past: what is remembered.
        number: of neighbours, k.
    """

    def __init__(self, past: Past, number: int) -> None:
        self.past, self.number = past, number
        self.lags: Floats = past.every * np.arange(WINDOW, dtype=np.float64)

    @cached_property
    def _search(self) -> tuple[Any, Tracks]:
        from scipy.spatial import KDTree

        states = self.past.tracks.resample(period=self.past.every / 2)
        windows = back(states, np.arange(len(states.points)), self.lags)
        return KDTree(windows.reshape(len(windows), -1)), states

    def nearest(self, asked: Questions, count: int) -> Ints:
        """``(Q, k)`` past states, the nearest first."""
        search, states = self._search
        windows = asked.back(self.lags).reshape(len(asked), WINDOW * states.dim)
        return search.query(windows, k=min(count, len(states.points)))[1].reshape(len(asked), -1)

    def tracks_at(self, asked: Questions, count: int) -> Ints:
        """``(Q, count)`` the past tracks of the nearest windows."""
        states = self._search[1]
        return np.searchsorted(states.offsets, self.nearest(asked, count), side="right") - 1

    def ensemble(self, asked: Questions) -> Floats:
        _, states = self._search
        found = self.nearest(asked, MORE * self.number)
        owner = np.searchsorted(states.offsets, found, side="right") - 1
        when = states.times[found][:, :, None] + asked.horizons
        lasts = when <= states.times[states.offsets[owner + 1] - 1][:, :, None]
        there = np.empty((found.size, len(asked.horizons), states.dim))
        flat = when.reshape(found.size, -1)
        kernels.places(states.points, states.times, states.offsets, owner.ravel(), flat, there)
        gone = there.reshape(*found.shape, *there.shape[1:]) - states.points[found][:, :, None]
        chosen = _first(lasts.transpose(0, 2, 1), min(self.number, found.shape[1]))
        gone = np.take_along_axis(gone.transpose(0, 2, 1, 3), chosen[..., None], axis=2)
        return asked.here[:, None, None] + gone

    def heading(self, asked: Questions) -> Floats:
        return asked.velocity(self.past.every)


def _first(good: np.ndarray, count: int) -> Ints:
    """``(..., count)`` places of the first so many good ones of ``(..., n)``; of fewer again and again, of none all."""
    good = good | ~good.any(axis=-1, keepdims=True)
    order = np.argsort(~good, axis=-1, kind="stable")
    number = np.minimum(good.sum(axis=-1), count)[..., None]
    return np.take_along_axis(order, np.arange(count) % number, axis=-1)
