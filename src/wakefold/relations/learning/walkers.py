"""Pairs of people on a common clock, and what each pair has looked like while both were there."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base import small
from wakefold.base.types import Floats, Ints
from wakefold.relations.smoothing import constant_velocity
from wakefold.tracks.ragged import ragged_rows
from wakefold.tracks.tracks import Tracks

SPACING = small.log([0.4, 0.6, 0.8, 1.1, 1.5, 2.0, 2.8, 4.0, 6.0])  # knots, log metres
DIFFERENCE = small.log([0.05, 0.1, 0.2, 0.4, 0.7, 1.2, 2.0])  # knots of the difference of velocities, log m/s
WALKING = 0.4  # m/s from which on somebody walks
OFFSET = 0.05  # m and m/s, keeps logarithms finite


class Walkers(NamedTuple):
    """People as a Kalman filter follows them, each in consecutive frames.

    Attributes:
        ids: ``(N,)``.
        begin: ``(N,)`` first frame of each.
        offsets: ``(N + 1,)`` rows of each.
        position, velocity: ``(P, 2)`` given what was seen up to then, metres and m/s.
        seen: ``(P, 2)`` where each was seen, NaN in frames without.
        dt: seconds between frames.
    """

    ids: NDArray
    begin: Ints
    offsets: Ints
    position: Floats
    velocity: Floats
    seen: Floats
    dt: float

    @property
    def end(self) -> Ints:
        """``(N,)`` the frame after the last one of each."""
        return self.begin + np.diff(self.offsets)

    def until(self, frame: int) -> Walkers:
        """What was known before ``frame``; people yet to come are left out."""
        there = np.flatnonzero(self.begin < frame)
        lengths = np.minimum(self.end, frame)[there] - self.begin[there]
        rows = ragged_rows(self.offsets[:-1][there], lengths)
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        columns = self.position[rows], self.velocity[rows], self.seen[rows]
        return Walkers(self.ids[there], self.begin[there], offsets, *columns, self.dt)


def follow(tracks: Tracks, dt: float, q: float = 0.15, sd: float = 0.1) -> Walkers:
    """Filter tracks on the clock 0, dt, 2 dt, ...; frames left out inside a track are predicted.

    Args:
        tracks: planar; times are multiples of ``dt``.
        q: diffusion of the velocity, m/s per square root of a second.
        sd: of a position, metres.

    Raises:
        ValueError: times that are not on the clock, or points that are not planar.
    """
    if tracks.points.shape[1] != 2:
        raise ValueError(f"walkers need points in a plane, got {tracks.points.shape[1]} coordinates")
    frames = np.rint(tracks.times / dt).astype(np.int64)
    if (np.abs(tracks.times - frames * dt) > 0.01 * dt).any():
        raise ValueError(f"times must be multiples of dt = {dt} s")
    begin = frames[tracks.offsets[:-1]]
    lengths = frames[tracks.offsets[1:] - 1] - begin + 1
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    position, velocity = np.empty((offsets[-1], 2)), np.empty((offsets[-1], 2))
    everything = np.full((offsets[-1], 2), np.nan)
    for i, (a, b) in enumerate(zip(tracks.offsets[:-1], tracks.offsets[1:], strict=True)):
        seen = everything[offsets[i] : offsets[i + 1]]
        seen[frames[a:b] - begin[i]] = tracks.points[a:b]
        known = constant_velocity(seen, np.arange(lengths[i]) * dt, sd, q=q * q, speed=1.5, smooth=False)
        position[offsets[i] : offsets[i + 1]] = known.position
        velocity[offsets[i] : offsets[i + 1]] = known.velocity
    return Walkers(tracks.ids, begin, offsets, position, velocity, everything, dt)


class Together(NamedTuple):
    """Pairs who are in the scene at the same time; ``shift`` frames are added to the second's clock.

    Attributes:
        first, second: ``(K,)`` people.
        begin, end: ``(K,)`` frames, ``end`` exclusive.
        shift: ``(K,)``.
    """

    first: Ints
    second: Ints
    begin: Ints
    end: Ints
    shift: Ints

    @property
    def offsets(self) -> Ints:
        """``(K + 1,)`` rows of each pair where its frames are laid end to end."""
        return np.concatenate([[0], np.cumsum(self.end - self.begin)])


def pairs_of(walkers: Walkers, least: int = 5) -> Together:
    """All pairs seen together for at least ``least`` frames, in order of people."""
    first, second = np.triu_indices(len(walkers.ids), 1)
    return _meet(walkers, first, second, np.zeros(len(walkers.ids), np.int64), least)


def ghost_pairs(walkers: Walkers, rounds: int, least: int = 5) -> list[Together]:
    """Pairs of people and others who were there at another time: nobody walks with a ghost.

    In each round all clocks are turned by the same time, a part of the scene's length, so a ghost walks where and how
    people of this scene walk, but not because of anybody who is there.
    """
    first, second = np.triu_indices(len(walkers.ids), 1)
    start = int(walkers.begin.min())
    length = int(walkers.end.max()) - start
    turns = (length * (np.arange(rounds) + 1)) // (rounds + 1)
    return [
        _meet(walkers, first, second, (walkers.begin - start + t) % length + start - walkers.begin, least)
        for t in turns
    ]


def _meet(walkers: Walkers, first: Ints, second: Ints, shift: Ints, least: int) -> Together:
    begin = np.maximum(walkers.begin[first], (walkers.begin + shift)[second])
    end = np.minimum(walkers.end[first], (walkers.end + shift)[second])
    keep = np.flatnonzero(end - begin >= least)
    return Together(first[keep], second[keep], begin[keep], end[keep], shift[second[keep]])


class Steps(NamedTuple):
    """Every frame of every pair, laid end to end.

    Attributes:
        spacing: ``(R,)`` distance, metres.
        difference: ``(R,)`` of the velocities, m/s.
        slower, faster: ``(R,)`` speed of the slower and of the faster one, m/s.
        alignment: ``(R,)`` cosine of the angle between the velocities, 0 where one stands.
    """

    spacing: Floats
    difference: Floats
    slower: Floats
    faster: Floats
    alignment: Floats


def steps(walkers: Walkers, pairs: Together) -> Steps:
    """Spacing and velocities of pairs, frame by frame."""
    lengths = pairs.end - pairs.begin
    a = ragged_rows(walkers.offsets[pairs.first] + pairs.begin - walkers.begin[pairs.first], lengths)
    b = ragged_rows(walkers.offsets[pairs.second] + pairs.begin - pairs.shift - walkers.begin[pairs.second], lengths)
    apart = walkers.position[b] - walkers.position[a]
    va, vb = walkers.velocity[a], walkers.velocity[b]
    speeds = np.hypot(va[:, 0], va[:, 1]), np.hypot(vb[:, 0], vb[:, 1])
    alignment = (va * vb).sum(axis=1) / np.maximum(speeds[0] * speeds[1], 1e-3)
    return Steps(
        np.hypot(apart[:, 0], apart[:, 1]), np.hypot(*(vb - va).T), np.minimum(*speeds), np.maximum(*speeds), alignment
    )


class Looks(NamedTuple):
    """What pairs have looked like, averaged over the frames they were seen together.

    Attributes:
        frames: ``(K,)`` how many.
        shape: ``(K, 16)`` average of the hat functions of log spacing on ``SPACING``, then of the log difference of the
            velocities on ``DIFFERENCE``.
        log_spacing: ``(K,)`` mean of the log of the spacing (metres).
        strolled: ``(K,)`` both have walked at the same time.
        closest: ``(K,)`` least spacing, metres.
    """

    frames: Floats
    shape: Floats
    log_spacing: Floats
    strolled: NDArray[np.bool_]
    closest: Floats


def looks(walkers: Walkers, pairs: Together) -> Looks:
    """What each pair has looked like."""
    if not len(pairs.first):
        none = np.zeros(0)
        return Looks(none, np.zeros((0, len(SPACING) + len(DIFFERENCE))), none, np.zeros(0, bool), none)
    s, at = steps(walkers, pairs), pairs.offsets
    frames = np.diff(at).astype(np.float64)
    shape = np.concatenate([_hats(small.log(x), k, at) for x, k in _scales(s)], axis=1) / frames[:, None]
    log_spacing = np.add.reduceat(small.log(s.spacing + OFFSET), at[:-1]) / frames
    strolled = np.maximum.reduceat(s.slower, at[:-1]) >= WALKING
    return Looks(frames, shape, log_spacing, strolled, np.minimum.reduceat(s.spacing, at[:-1]))


def join(parts: list[Looks]) -> Looks:
    """Looks of several sets of pairs as one."""
    return Looks(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def running(walkers: Walkers, pairs: Together, weights: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """The same looks up to each frame: ``(R,)`` frames so far, ``weights @ shape``, log spacing, strolled."""
    s, at = steps(walkers, pairs), pairs.offsets
    frames = (np.arange(at[-1]) - np.repeat(at[:-1], np.diff(at)) + 1).astype(np.float64)
    told, taken = np.zeros(at[-1]), 0
    for x, knots in _scales(s):
        place, part = _place(small.log(x), knots)
        w = weights[taken : taken + len(knots)]
        told += (1.0 - part) * w[place] + part * w[place + 1]
        taken += len(knots)
    both = (s.slower >= WALKING).astype(np.float64)
    return (
        frames,
        _so_far(told, at) / frames,
        _so_far(small.log(s.spacing + OFFSET), at) / frames,
        _so_far(both, at) > 0.5,
    )


def _scales(s: Steps) -> list[tuple[Floats, Floats]]:
    return [(s.spacing + 1e-3, SPACING), (s.difference + 1e-3, DIFFERENCE)]


def _place(x: Floats, knots: Floats) -> tuple[Ints, Floats]:
    inside = np.clip(x, knots[0], knots[-1])
    place = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
    return place, (inside - knots[place]) / (knots[place + 1] - knots[place])


def _hats(x: Floats, knots: Floats, at: Ints) -> Floats:
    """Sums of hat functions over the rows of each pair, ``(K, knots)``."""
    place, part = _place(x, knots)
    cell = np.repeat(np.arange(len(at) - 1), np.diff(at)) * len(knots) + place
    size = (len(at) - 1) * len(knots)
    total: Any = np.bincount(cell, 1.0 - part, size) + np.bincount(cell + 1, part, size)
    return total.reshape(-1, len(knots))


def _so_far(x: Floats, at: Ints) -> Floats:
    """Running sums that begin anew with each pair."""
    total = np.cumsum(x)
    before = np.concatenate([[0.0], total])[at[:-1]]
    return total - np.repeat(before, np.diff(at))
