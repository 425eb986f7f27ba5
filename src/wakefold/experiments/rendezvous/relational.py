"""How the relational filter tells a rendezvous: in phases, both ships at once; or by the engine "collapsed".

Constants were learned on tuning scenes with a seed of their own (docs/rendezvous.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wakefold.base.types import Floats
from wakefold.experiments.rendezvous.rivals import SPEED, received
from wakefold.experiments.rendezvous.scenes import DT, STEPS, Scenes
from wakefold.relations.detections import Detections
from wakefold.relations.filter import RelationalFilter
from wakefold.relations.model import (
    ConstantVelocity,
    Relation,
    RelationalModel,
    couple_velocity,
    near,
    same_velocity,
    slow,
)
from wakefold.relations.phases import Phase, PhaseFilter, Turn

MET = ("together", "leaving", "gone")
FAR = 300_000.0  # metres between scenes that one filter follows side by side
FAINT = 0.1  # two ships are not together where it is less probable


class Constants(NamedTuple):
    """Of the filter in phases, as learned; q and noise in m/s per square root of a second, rates per second."""

    steady: float = 0.0112  # q under way
    turning: float = 0.18  # q while manoeuvring
    resting: float = 0.00224  # q at rest
    fading: float = 0.000853  # drag at rest
    drifting: float = 0.00165  # q of the two together
    k: float = 0.0908  # how soon they take on one velocity
    noise: float = 0.00425  # of the difference of their velocities, together
    turn: float = 2.25e-05  # rate of beginning to manoeuvre
    settle: float = 0.00251  # rate of ending it
    rest: float = 0.00594  # rate of coming to rest
    slow_alone: float = 0.136  # speed at which ships come to rest
    wake: float = 0.000426  # rate of leaving it
    meet: float = 0.0107  # rate of coming together
    near: float = 85.4
    slow: float = 1.74
    part: float = 0.000659  # rate of parting
    turning_first: float = 0.4  # share of scenes that begin with a manoeuvre
    resting_first: float = 0.00165


LEARNED = Constants()
STAGES = 5  # of "together"


def meeting(c: Constants = LEARNED) -> PhaseFilter:
    """Two ships under way, manoeuvring, at rest each by itself; or together, after which they manoeuvre and go."""
    phases = [
        Phase("under way", c.steady, starts=1.0 - c.turning_first - c.resting_first),
        Phase("manoeuvring", c.turning, starts=c.turning_first),
        Phase("at rest", c.resting, c.fading, starts=c.resting_first),
        Phase("together", c.drifting, couples=couple_velocity(c.k, c.noise), stages=STAGES),
        Phase("leaving", c.turning),
        Phase("gone", c.steady),
    ]
    turns = [
        Turn("under way", "manoeuvring", c.turn),
        Turn("manoeuvring", "under way", c.settle),
        Turn("manoeuvring", "at rest", c.rest, slow=c.slow_alone),
        Turn("at rest", "manoeuvring", c.wake),
        Turn("manoeuvring", "together", c.meet, near=c.near, slow=c.slow),
        Turn("together", "leaving", c.part),
        Turn("leaving", "gone", c.settle),
        Turn("gone", "leaving", c.turn),
    ]
    return PhaseFilter(phases, turns, speed=SPEED)


def phases(some: Scenes, sd: float, f: PhaseFilter | None = None) -> tuple[Floats, Floats, Floats]:
    """``(n, T, phases)`` their probabilities, ``(n,)`` log-odds that the ships have met, positions ``(n, 2, T, 2)``."""
    f = f or meeting()
    belief = f.start(len(some.seen))
    p, place = np.empty((len(some.seen), STEPS, len(f.phases))), np.empty_like(some.seen)
    for t in range(STEPS):
        belief = f.step(belief, some.seen[:, :, t], sd, DT if t else 0.0)
        p[:, t], place[:, :, t] = f.probabilities(belief), f.position(belief)
    return p, f.log_odds(belief, MET), place


def model() -> RelationalModel:
    """Two ships that may be together: near, slow, at one velocity."""
    together = Relation(
        "together",
        ("ship", "ship"),
        on_when=near(360.0) & slow(2.5) & same_velocity(0.75),
        rate_on=1 / 600,
        rate_off=1 / 1800,
        rate_break=1 / 60,
        couples=couple_velocity(k=0.1, noise=0.005),
        seen_within=1200.0,
    )
    return RelationalModel(objects={"ship": ConstantVelocity(q=0.0005**0.5, speed=SPEED)}, relations=[together])


def belief(some: Scenes, sd: float, missing: float) -> Floats:
    """Probability of "together" ``(n, T)`` in one pass of the engine "collapsed".

    The scenes lie far apart in one plane, so that one filter follows them all. A position that was not received is put
    on the straight line between its neighbours, and the noise of all is taken as larger by as much as there are more of
    them: the engine "collapsed" learns of a pair only when it sees both.
    """
    seen = received(some).position if missing else some.seen
    n = len(seen)
    f = RelationalFilter(model(), "collapsed", gate=3000.0, forget=1e9)
    scene = f.start()
    shift = np.column_stack([np.arange(n) * FAR, np.zeros(n)])[:, None]
    ids = np.arange(2 * n)
    p = np.zeros((n, STEPS))
    for t in range(STEPS):
        places = (seen[:, :, t] + shift).reshape(-1, 2)
        scene = f.step(scene, Detections(places, sd / np.sqrt(1 - missing), ids), dt=DT if t else 0.0)
        pairs = scene.pairs[0]
        p[scene.ids[pairs.first] // 2, t] = pairs.p
    return p


def together(some: Scenes, sd: float, missing: float) -> Floats:
    """Scores ``(n,)`` by the engine "collapsed": the longest time that two ships were probably together, weighed by how
    probably.

    The filter goes through a scene from either end, as its beginning is known best by what follows; each moment counts
    by the surer of the two.
    """
    ahead = belief(some, sd, missing)
    back = belief(some._replace(seen=np.ascontiguousarray(some.seen[:, :, ::-1])), sd, missing)
    p = np.maximum(ahead, back[:, ::-1])
    run, longest = np.zeros(len(p)), np.zeros(len(p))
    for t in range(STEPS):
        run = (run + p[:, t]) * (p[:, t] > FAINT)
        np.maximum(longest, run, out=longest)
    return longest * DT
