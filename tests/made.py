"""Tracks made up, for tests of several packages."""

import numpy as np

from wakefold.tracks.tracks import Tracks


def bundles(seed=0, count=9, dim=2):
    """Wiggly tracks in a few bundles, of 1 to 9 points; two are equal when there are several."""
    rng = np.random.default_rng(seed)
    tracks = []
    for i in range(count):
        n = 1 if i == 3 else int(rng.integers(2, 10))
        start = rng.normal(size=dim) * 3 + 10 * (i % 3)
        tracks.append(start + np.cumsum(rng.normal(0.8, 0.5, size=(n, dim)), axis=0))
    if count > 1:
        tracks[1] = tracks[0].copy()
    return Tracks.from_arrays(tracks)


def walks(rng, count, dim=2, longest=39):
    """Random walks from places of their own."""
    return [
        rng.normal(0, 20, dim) + np.cumsum(rng.normal(0, 1, (n, dim)), axis=0)
        for n in rng.integers(1, longest + 1, count)
    ]


def two_hubs(rng, count, dim):
    """All begin at one place and end at another: end points tell nothing."""
    at = np.linspace(0, 1, 15)[:, None]
    bends = [np.sin(k * np.pi * at) * rng.normal(0, 40, (count, 1, dim)) for k in (1, 2)]
    return list(at * 1000 + bends[0] + bends[1])


def on_a_grid(rng, count, dim):
    return [rng.integers(0, 5, (n, dim)).astype(float) for n in rng.integers(1, 5, count)]


def same_place(rng, count, dim):
    return [np.full((n, dim), 7.25) for n in rng.integers(1, 4, count)]


def routes(seed, count, noise=3.0, points=30):
    """Noisy tracks of three routes, which part half-way, one of them from the start; a point a second."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, points)[:, None]
    ways = [
        np.concatenate([300.0 * s, bend * np.maximum(s - 0.5, 0.0) * 400.0 + side], axis=1)
        for bend, side in ((1.0, 0.0), (-1.0, 0.0), (0.0, 200.0))
    ]
    out, chosen = [], rng.integers(0, 3, count)
    for k in chosen:
        off = rng.normal(0.0, noise, (1, 2)) + np.cumsum(rng.normal(0.0, 0.2 * noise, (points, 2)), axis=0)
        out.append(ways[k] + off)
    return Tracks.from_arrays(out), chosen


def straight(*ways, seconds=20):
    """Straight tracks, of (begin, velocity) each, a point a second."""
    at = np.arange(seconds + 1.0)[:, None]
    return Tracks.from_arrays([np.asarray(begin, float) + at * np.asarray(velocity, float) for begin, velocity in ways])
