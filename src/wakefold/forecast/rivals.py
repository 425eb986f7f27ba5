"""Plain rivals: what a user would write in an hour."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from wakefold.base.types import Floats
from wakefold.evidence.fix import Fix
from wakefold.forecast.scores import HEADING, Method, Question
from wakefold.tracks.tracks import Tracks


def particle(filter: Any, sd: float) -> Method:
    """A filter of this package; ``sd`` of the fixes, metres."""

    def answers(name: str, points: Floats, times: Floats, asked: Sequence[Question]) -> Iterator[Floats]:
        belief = filter.start(fix=Fix(points[0], sd=sd), time=times[0], agent=name)
        for ask in asked:
            if ask.row:
                belief = filter.step(belief, [Fix(points[ask.row], sd=sd)], time=times[ask.row])
            later = filter.forecast(belief, ask.ahead.tolist())
            yield np.reshape([b.mean() for b in later], (-1, 2))

    return answers


def constant_velocity(name: str, points: Floats, times: Floats, asked: Sequence[Question]) -> Iterator[Floats]:
    """On from the last fix with the velocity between the last two."""
    before = asked[0]
    for ask in asked:
        span = times[ask.row] - times[before.row]
        velocity = (points[ask.row] - points[before.row]) / (span or 1.0)
        before = ask
        yield points[ask.row] + ask.ahead[:, None] * velocity


def nearest_track(past: Tracks) -> Method:
    """On along the past track that is nearest to the last fix and goes within 45 degrees of the same way."""
    from scipy.spatial import KDTree

    search = KDTree(past.points)
    track = np.repeat(np.arange(len(past)), past.lengths)
    follows = np.append(track[1:] == track[:-1], False)
    step = np.zeros_like(past.points)
    step[:-1] = np.where(follows[:-1, None], np.diff(past.points, axis=0), 0.0)

    def answers(name: str, points: Floats, times: Floats, asked: Sequence[Question]) -> Iterator[Floats]:
        before = asked[0]
        for ask in asked:
            here, way = points[ask.row], points[ask.row] - points[before.row]
            before = ask
            found = np.atleast_1d(search.query(here, k=min(500, len(past.points)))[1])
            along = step[found] @ way
            fits = along > HEADING * np.linalg.norm(step[found], axis=1) * np.linalg.norm(way)
            best = int(found[np.argmax(fits)]) if fits.any() else int(found[0])
            own, clock = past[int(track[best])], past.times_of(int(track[best]))
            then = past.times[best] + ask.ahead  # a track that ends stays where it ended
            there = np.stack([np.interp(then, clock, own[:, axis]) for axis in (0, 1)], axis=1)
            yield here + there - past.points[best]

    return answers
