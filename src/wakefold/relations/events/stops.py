"""Where agents stand still, and which of those places are berths. What events of ships are found from.

All agents are brought to one clock: a moment every ``period`` seconds at which an agent has a position if it was heard
before and after, at most ``gap`` seconds apart.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from wakefold.base.types import Floats, Ints
from wakefold.base.units import HOUR
from wakefold.relations.smoothing import constant_velocity
from wakefold.tracks.tracks import Tracks

FIX_SD, Q = 15.0, 0.005  # metres of a position by satellite, as received; m²/s³ of a ship under way
STILL = 0.5  # m/s: who is slower lies still
STOP = 1200.0  # seconds of a stop at least
HOLE = 600.0  # seconds that a stop, or an event, may be interrupted
TIED = 20.0  # metres: who lies still for hours within so small a circle is tied up; a ship at anchor swings
LONG = 3 * HOUR  # seconds
TOUCH = 150.0  # metres between stops at one place
EMPTY = 1800.0  # seconds without anybody between two uses of one place


class Moments(NamedTuple):
    """Where agents were, on one clock; rows in order of agent, then time.

    Attributes:
        names: ``(A,)`` agents.
        agent: ``(R,)`` which of them.
        frame: ``(R,)`` moments, counted from 0.
        begin, period: seconds UTC of moment 0, and from one to the next.
        position: ``(R, 2)`` metres, in straight lines between what was heard.
        velocity: ``(R, 2)`` m/s, by the Kalman smoother.
        spread: ``(R,)`` standard deviation of the velocity per axis, m/s.
    """

    names: NDArray[np.str_]
    agent: Ints
    frame: Ints
    begin: float
    period: float
    position: Floats
    velocity: Floats
    spread: Floats

    def time(self, frame: int | Ints) -> Any:
        """Seconds UTC of a moment."""
        return self.begin + self.period * frame


def moments(tracks: Tracks, period: float, gap: float) -> Moments:
    """All agents on one clock.

    Args:
        tracks: in two dimensions or more; the attribute ``agent``, where there is one, says which belong together.
        period: seconds.
        gap: seconds; who is silent for longer is nowhere.

    Raises:
        ValueError: tracks in one dimension, or no tracks.
    """
    if not len(tracks) or tracks.dim < 2:
        raise ValueError("events need tracks in two dimensions")
    names, of_track = np.unique(tracks.attributes.get("agent", tracks.ids).astype(np.str_), return_inverse=True)
    who = np.repeat(of_track, tracks.lengths)
    order = np.lexsort((tracks.times, who))
    begin = float(np.floor(tracks.times.min() / period) * period)
    parts = []
    for a, rows in enumerate(np.split(order, np.searchsorted(who[order], np.arange(1, len(names))))):
        times, keep = np.unique(tracks.times[rows], return_index=True)
        points = tracks.points[rows][keep, :2]
        first, last = np.ceil((times[0] - begin) / period), np.floor((times[-1] - begin) / period)
        frames = np.arange(int(first), int(last) + 1)
        clock = begin + period * frames
        after = np.searchsorted(times, clock)
        exact = times[np.minimum(after, len(times) - 1)] == clock
        before = np.where(exact, after, after - 1)
        near = exact | (times[np.minimum(after, len(times) - 1)] - times[np.maximum(before, 0)] <= gap)
        frames, clock = frames[near], clock[near]
        if not len(frames):
            continue
        position = np.column_stack([np.interp(clock, times, points[:, k]) for k in (0, 1)])
        every = np.concatenate([times, clock])
        rank = np.argsort(every, kind="stable")
        seen = np.concatenate([points, np.full((len(clock), 2), np.nan)])
        state = constant_velocity(seen[rank], every[rank], FIX_SD, q=Q)
        at = np.empty(len(rank), dtype=np.int64)
        at[rank] = np.arange(len(rank))
        at = at[len(times) :]
        parts.append((np.full(len(frames), a), frames, position, state.velocity[at], np.sqrt(state.cov[at, 1, 1])))
    if not parts:
        raise ValueError(f"no agent is heard at least every {gap:g} s")
    agent, frame, position, velocity, spread = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Moments(names, agent, frame, begin, period, position, velocity, spread)


class Stop(NamedTuple):
    """An agent that lies still.

    Attributes:
        agent: which.
        first, last: moments.
        place: ``(2,)`` median position, metres.
        radius: within which it stayed for nine tenths of the time, metres.
    """

    agent: int
    first: int
    last: int
    place: Floats
    radius: float


def stops(m: Moments) -> list[Stop]:
    """Every stretch of ``STOP`` seconds and more at which an agent was slower than ``STILL``."""
    still = np.linalg.norm(m.velocity, axis=1) < STILL
    out = []
    for lo, hi in runs(m.agent, m.frame, still, longest_hole=round(HOLE / m.period)):
        if (m.frame[hi - 1] - m.frame[lo]) * m.period >= STOP:
            rows = np.arange(lo, hi)[still[lo:hi]]
            place = np.median(m.position[rows], axis=0)
            radius = float(np.quantile(np.linalg.norm(m.position[rows] - place, axis=1), 0.9))
            out.append(Stop(int(m.agent[lo]), int(m.frame[lo]), int(m.frame[hi - 1]), place, radius))
    return out


def runs(agent: Ints, frame: Ints, holds: NDArray[np.bool_], longest_hole: int) -> list[tuple[int, int]]:
    """Rows ``lo:hi`` of stretches of one agent where something holds, bridging holes of a few moments."""
    rows = np.flatnonzero(holds)
    if not len(rows):
        return []
    new = (np.diff(agent[rows]) != 0) | (np.diff(frame[rows]) > longest_hole + 1)
    edges = np.concatenate([[0], np.flatnonzero(new) + 1, [len(rows)]])
    return [(int(rows[a]), int(rows[b - 1]) + 1) for a, b in pairwise(edges)]


def berths(found: list[Stop], period: float) -> Floats:
    """``(B, 2)`` stops that are at berths, metres: where somebody was tied up, or where agents lay at different times.

    Stops closer than ``TOUCH`` are at one place. A place is a berth if a stop of ``LONG`` seconds there kept within
    ``TIED`` metres (at anchor a ship swings), or if it was used, left by all for ``EMPTY`` seconds, and used again.
    """
    if not found:
        return np.empty((0, 2))
    places = np.array([stop.place for stop in found])
    pairs = KDTree(places).query_pairs(TOUCH, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(found), len(found)))
    _, place = connected_components(graph, directed=False)
    chosen = np.zeros(len(found), dtype=bool)
    for k in range(place.max() + 1):
        members = [found[i] for i in np.flatnonzero(place == k)]
        tied = any((s.last - s.first) * period >= LONG and s.radius < TIED for s in members)
        members.sort(key=lambda s: s.first)
        until, again = members[0].last, False
        for s in members[1:]:
            again |= (s.first - until) * period > EMPTY
            until = max(until, s.last)
        chosen[place == k] = tied or again
    return places[chosen]
