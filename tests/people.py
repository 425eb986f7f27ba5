"""Scenes of people, some of whom walk in pairs: for tests of what is learned of them."""

import numpy as np

from wakefold.relations.learning.together import crowd
from wakefold.relations.learning.walkers import follow
from wakefold.tracks.tracks import Tracks

DT = 0.4


def scene(seed, people=70, spacing=0.9, lone=0.5):
    """People who cross a square alone or in twos ``spacing`` apart, with the true pairs."""
    rng = np.random.default_rng(seed)
    points, times, partners = [], [], []
    while len(points) < people:
        begin, length = int(rng.integers(0, 300)), int(rng.integers(15, 40))
        heading, speed = rng.choice([0.0, np.pi]) + rng.normal(0, 0.15), rng.normal(1.2, 0.2)
        step = np.array([np.cos(heading), np.sin(heading)]) * speed * DT
        wander = np.cumsum(np.cumsum(rng.normal(0, 0.02, (length, 2)), axis=0), axis=0)
        middle = rng.uniform(-6, 6, 2) + np.arange(length)[:, None] * step + wander
        side = np.array([-np.sin(heading), np.cos(heading)]) * spacing * np.exp(rng.normal(0, 0.15))
        two = rng.random() > lone
        if two:
            partners.append((len(points), len(points) + 1))
        for k in range(2 if two else 1):
            own = np.cumsum(rng.normal(0, 0.03, (length, 2)), axis=0) + rng.normal(0, 0.03, (length, 2))
            points.append(middle + (k - 0.5) * side + own)
            times.append((begin + np.arange(length)) * DT)
    return Tracks.from_arrays(points, times), set(partners)


def ready(seed, **kinds):
    tracks, partners = scene(seed, **kinds)
    walkers = follow(tracks, DT)
    people = crowd(walkers)
    pairs = zip(people.pairs.first.tolist(), people.pairs.second.tolist(), strict=True)
    return walkers, people, np.array([pair in partners for pair in pairs])
