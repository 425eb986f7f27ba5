"""What ships do together and alone: encounters, rendezvous, convoys, loitering, port visits.

The words are those of Global Fishing Watch (Miller et al. 2018, "Identifying global patterns of transshipment
behavior", Frontiers in Marine Science 5:240: an encounter is two vessels within 500 m at under 2 knots for 2 hours).
The relations of pairs come from the relational filter, engine "collapsed"; an event is where a relation is probable for
long enough.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree
from scipy.special import ndtr

from wakefold.base.types import Floats, Ints
from wakefold.base.units import HOUR, KNOT
from wakefold.relations.activities import taken_place
from wakefold.relations.detections import Detections
from wakefold.relations.events.stops import HOLE, Moments, berths, moments, runs, stops
from wakefold.relations.filter import RelationalFilter
from wakefold.relations.model import (
    Activity,
    ConstantVelocity,
    Relation,
    RelationalModel,
    couple_velocity,
    near,
    same_velocity,
    slow,
)
from wakefold.tracks.tracks import Tracks

KINDS = ("rendezvous", "encounter", "convoy", "loitering", "port visit")
BETWEEN_SD = 20.0  # metres, of places in straight lines between fixes; more than the fixes' own, ``stops.FIX_SD``
WANDER = 0.07  # m/s per square root of a second: a ship under way
SPEED = 5.0  # m/s per axis, of a ship nothing is known of
MIDDLE = 0.5  # from this probability on, a relation holds
FAINT = 0.05  # relations less probable are not kept
GATE = 3000.0  # metres


class Settings(NamedTuple):
    """What counts as an event.

    Attributes:
        near: metres between two ships that are together.
        slow: m/s of ships that are together or loiter.
        together: seconds of an encounter at least.
        convoy_near: metres between two ships of a convoy.
        convoy_difference: m/s between their velocities.
        convoy: seconds of a convoy at least.
        loiter: seconds of loitering at least.
        visit: seconds of a port visit at least.
        berth: metres around a berth within which nothing but a port visit is told.
        gap: seconds; who is silent for longer is nowhere.
        period: seconds between the moments looked at.
    """

    near: float = 500.0
    slow: float = 2 * KNOT
    together: float = 1800.0
    convoy_near: float = 1000.0
    convoy_difference: float = 0.75
    convoy: float = 1200.0
    loiter: float = 3600.0
    visit: float = 1200.0
    berth: float = 250.0
    gap: float = 900.0
    period: float = 60.0


class Event(NamedTuple):
    """Something that one ship did, or two.

    Attributes:
        kind: one of ``KINDS``.
        agents: one name, or two.
        begin, end: seconds UTC.
        probability: that it lasted as long as its kind must.
        place: ``(2,)`` mean position, metres.
        distance: median distance of the two, metres; NaN of one.
        speed: median speed, m/s.
        times, chance: ``(T,)`` moments of it, and how probable it was then that it was going on.
    """

    kind: str
    agents: tuple[str, ...]
    begin: float
    end: float
    probability: float
    place: Floats
    distance: float
    speed: float
    times: Floats
    chance: Floats


class Found(NamedTuple):
    """Events in order of their begin, and what they were found from.

    Attributes:
        events: all of them.
        moments: of all ships.
        berths: ``(B, 2)`` metres: those found from the tracks, then those told.
        at_berths: pairs of ships left out, as they lay at berths.
    """

    events: list[Event]
    moments: Moments
    berths: Floats
    at_berths: int


def model(s: Settings) -> RelationalModel:
    """Ships that are together (near and slow), and ships that go in convoy (near, of one velocity, not slow)."""
    apart = s.near / 10  # metres: what a pair that is together may wander within
    return RelationalModel(
        objects={"ship": ConstantVelocity(q=WANDER, speed=SPEED)},
        relations=[
            Relation(
                "together",
                ("ship", "ship"),
                on_when=near(s.near) & slow(s.slow),
                rate_on=1 / 120,
                rate_off=1 / 7200,
                rate_break=1 / 120,
                couples=couple_velocity(k=0.01, noise=apart * 0.01**1.5),
                seen_within=s.gap,
            ),
            Relation(
                "convoy",
                ("ship", "ship"),
                on_when=near(s.convoy_near) & same_velocity(s.convoy_difference) & ~slow(s.slow),
                rate_on=1 / 180,
                rate_off=1 / 7200,
                rate_break=1 / 120,
                couples=couple_velocity(k=0.01, noise=0.03),
                seen_within=s.gap,
            ),
        ],
        activities=[
            Activity("encounter", ["approach", "together", "parted"], min_time=s.together),
            Activity("convoy", ["convoy"], min_time=s.convoy),
        ],
    )


class _Pairs(NamedTuple):
    """What the filter said of pairs at moments: rows in order of pair, then time."""

    first: Ints
    second: Ints
    frame: Ints
    p: Floats
    lasted: Floats


def find(
    tracks: Tracks,
    settings: Settings | None = None,
    *,
    known: ArrayLike = (),
    progress: Callable[[float], None] | None = None,
) -> Found:
    """All events of ships.

    Args:
        tracks: geodetic, or planar in metres; cut into pieces or not.
        settings: what counts as an event.
        known: ``(B, 2)`` places that are berths, besides those found from the tracks: longitude and latitude, or
            metres where the tracks are planar.
        progress: told the share done.

    Raises:
        ValueError: no tracks, tracks of one dimension, nobody heard often enough, or berths that are no places.
    """
    s = settings or Settings()
    told = np.asarray(known, dtype=np.float64).reshape(-1, 2) if np.size(known) else np.zeros((0, 2))
    if not np.isfinite(told).all():
        raise ValueError("berths must be finite places")
    if tracks.projection is not None and len(told):
        wrong = np.flatnonzero((np.abs(told[:, 0]) > 360.0) | (np.abs(told[:, 1]) > 90.0))
        if len(wrong):
            raise ValueError(f"berth {wrong[0] + 1} is no longitude and latitude: {told[wrong[0]].tolist()}")
        told = tracks.projection.to_plane(told[:, 0], told[:, 1])
    m = moments(tracks, s.period, s.gap)
    lying = stops(m)
    at = np.concatenate([berths(lying, s.period), told])
    berth = KDTree(at) if len(at) else None
    found, at_berths = [], 0
    relations = _relations(m, s, progress)
    for name, least, rows in (("together", s.together, relations[0]), ("convoy", s.convoy, relations[1])):
        for event in _of_pairs(m, name, least, rows, s):
            if name == "together" and _at_berth(event.place, berth, s.berth):
                at_berths += 1
            else:
                found.append(event)
    found += _alone(m, found, berth, s)
    found.sort(key=lambda e: (e.begin, e.kind, e.agents))
    return Found(found, m, at, at_berths)


def _relations(m: Moments, s: Settings, progress: Callable[[float], None] | None) -> list[_Pairs]:
    """Both relations of every pair, moment by moment."""
    f = RelationalFilter(model(s), "collapsed", gate=GATE, forget=s.gap)
    scene = f.start(m.begin)
    order = np.lexsort((m.agent, m.frame))
    frames = np.arange(m.frame.min(), m.frame.max() + 1)
    edges = np.searchsorted(m.frame[order], np.append(frames, frames[-1] + 1))
    kept: list[list[tuple]] = [[], []]
    for count, frame in enumerate(frames.tolist()):
        rows = order[edges[count] : edges[count + 1]]
        if len(rows):
            seen = Detections(m.position[rows], BETWEEN_SD, m.agent[rows], detect_prob=0.5)
            scene = f.step(scene, seen, time=m.time(frame))
        else:
            scene = f.step(scene, time=m.time(frame))
        for into, pairs in zip(kept, scene.pairs, strict=True):
            k = np.flatnonzero(pairs.p > FAINT)
            if len(k):
                ends = scene.ids[pairs.first[k]], scene.ids[pairs.second[k]]
                lasted = taken_place(pairs.stages[0][k])
                into.append((*ends, np.full(len(k), frame), pairs.p[k], lasted))
        if progress is not None and count % 32 == 0:
            progress(count / len(frames))
    out = []
    for parts in kept:
        columns = [np.concatenate(c) for c in zip(*parts, strict=True)] if parts else [np.zeros(0)] * 5
        a, b, frame, p, lasted = columns
        first, second = np.minimum(a, b).astype(np.int64), np.maximum(a, b).astype(np.int64)
        rank = np.lexsort((frame, second, first))
        out.append(_Pairs(first[rank], second[rank], frame[rank].astype(np.int64), p[rank], lasted[rank]))
    return out


def _of_pairs(m: Moments, name: str, least: float, r: _Pairs, s: Settings) -> list[Event]:
    """Events where a relation was probable for long enough."""
    out = []
    pair = r.first * len(m.names) + r.second
    for lo, hi in runs(pair, r.frame, r.p >= MIDDLE, round(HOLE / s.period)):
        begin, end = m.time(int(r.frame[lo])), m.time(int(r.frame[hi - 1]))
        if end - begin < least or r.lasted[lo:hi].max() < MIDDLE:
            continue
        a, b = int(r.first[lo]), int(r.second[lo])
        frames = r.frame[lo:hi]
        here, there = _rows(m, a, frames), _rows(m, b, frames)
        both = (here >= 0) & (there >= 0)
        here, there = here[both], there[both]
        if not len(here):
            continue
        away = np.linalg.norm(m.position[here] - m.position[there], axis=1)
        speed = np.linalg.norm(np.concatenate([m.velocity[here], m.velocity[there]]), axis=1)
        if name == "convoy" and np.median(speed) < s.slow:  # ships that drift together do not sail
            continue
        kind = name
        if name == "together":
            kind = "rendezvous" if _came_and_went(m, a, b, int(frames[0]), int(frames[-1]), s) else "encounter"
        out.append(
            Event(
                kind=kind,
                agents=(str(m.names[a]), str(m.names[b])),
                begin=float(begin),
                end=float(end),
                probability=float(r.lasted[lo:hi].max()),
                place=(m.position[here].mean(axis=0) + m.position[there].mean(axis=0)) / 2,
                distance=float(np.median(away)),
                speed=float(np.median(speed)),
                times=np.asarray(m.time(frames)),
                chance=r.p[lo:hi],
            )
        )
    return out


def _rows(m: Moments, agent: int, frames: Ints) -> Ints:
    """Rows of an agent at moments; -1 where it was nowhere."""
    lo, hi = np.searchsorted(m.agent, [agent, agent + 1])
    at = np.minimum(np.searchsorted(m.frame[lo:hi], frames), hi - lo - 1)
    return np.where(m.frame[lo:hi][at] == frames, lo + at, -1)


def _came_and_went(m: Moments, a: int, b: int, first: int, last: int, s: Settings) -> bool:
    """Whether two ships were seen well apart, both before and after, within half a day."""
    window = round(12 * HOUR / s.period)
    sides = []
    for frames in (np.arange(first - window, first), np.arange(last + 1, last + 1 + window)):
        here, there = _rows(m, a, frames), _rows(m, b, frames)
        both = (here >= 0) & (there >= 0)
        away = np.linalg.norm(m.position[here[both]] - m.position[there[both]], axis=1)
        sides.append(bool((away > 3 * s.near).any()))
    return all(sides)


def _at_berth(place: Floats, berth: KDTree | None, radius: float) -> bool:
    return berth is not None and bool(np.isfinite(berth.query(place, distance_upper_bound=radius)[0]))


def _alone(m: Moments, pairs: list[Event], berth: KDTree | None, s: Settings) -> list[Event]:
    """Loitering and port visits: ships that are slow for long, by themselves or at a berth.

    The probability of being slow is that of the smoothed velocity, whose error is Gaussian and alike on both axes; the
    radius of the velocity is then about normal where it is not near 0, and a bound where it is.
    """
    speed = np.linalg.norm(m.velocity, axis=1)
    chance = ndtr((s.slow - speed) / m.spread)
    moored = np.zeros(len(speed), dtype=bool)
    if berth is not None:
        moored = np.isfinite(berth.query(m.position, distance_upper_bound=s.berth)[0])
    busy: dict[str, list[tuple[float, float]]] = {}
    for e in pairs:
        if e.kind in ("rendezvous", "encounter"):
            for name in e.agents:
                busy.setdefault(name, []).append((e.begin, e.end))
    out = []
    for kind, least, where in (("port visit", s.visit, moored), ("loitering", s.loiter, ~moored)):
        for lo, hi in runs(m.agent, m.frame, (chance >= MIDDLE) & where, round(HOLE / s.period)):
            begin, end = float(m.time(int(m.frame[lo]))), float(m.time(int(m.frame[hi - 1])))
            name = str(m.names[m.agent[lo]])
            accompanied = any(b < end and e > begin for b, e in busy.get(name, []))
            if end - begin < least or (kind == "loitering" and accompanied):
                continue
            times = np.asarray(m.time(m.frame[lo:hi]))
            out.append(
                Event(
                    kind=kind,
                    agents=(name,),
                    begin=begin,
                    end=end,
                    probability=float(chance[lo:hi].mean()),
                    place=m.position[lo:hi].mean(axis=0),
                    distance=float("nan"),
                    speed=float(np.median(speed[lo:hi])),
                    times=times,
                    chance=chance[lo:hi],
                )
            )
    return out
