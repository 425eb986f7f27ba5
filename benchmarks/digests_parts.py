"""Results of filters as Python calls them, on data made here: what ``benchmarks.digests`` asks beside the commands.

The data are made by additions and multiplications of random numbers, so that they are the same everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import wakefold as wf

Named = tuple[str, tuple[object, ...]]


def tracks(seed: int = 0, count: int = 24) -> wf.Tracks:
    """Wiggly tracks in three bundles."""
    rng = np.random.default_rng(seed)
    starts = 40.0 * (np.arange(count) % 3)[:, None] + rng.normal(size=(count, 2)) * 3.0
    return wf.Tracks.from_arrays([s + np.cumsum(rng.normal(0.8, 0.5, size=(40, 2)), axis=0) for s in starts])


def of_tracks() -> Iterator[Named]:
    """``learn`` and the filters of one agent; the class of the agent is reported now and then."""
    past = tracks()
    model = wf.learn(past, sd=1.5)
    t, v = model.filtration, model.dynamics
    yield "parts learn", (t.order, t.parent, t.birth, v.points, v.velocities, v.epsilon, v.scale)
    deviation = wf.Deviation.learn(model)
    yield "parts deviation", tuple(deviation)
    confusion = wf.Confusion.learn(model, lambda places, rng: rng.integers(0, len(past), len(places)), reports=200)
    yield "parts confusion", (confusion.positions, confusion.named, confusion.width)
    level = float(t.levels(3)[1])
    given: dict[str, Any] = {"particles": 100, "sd": 1.5, "seed": 4}
    for name, f in {
        "mhpf": wf.MHPF(model, **given),
        "mhpf student residual": wf.MHPF(model, likelihood="student", resampling="residual", **given),
        "bl1 multinomial": wf.BL1(model, coarse=True, resampling="multinomial", ess_threshold=0.5, **given),
        "bl2": wf.BL2(model, **given),
        "calibrated": wf.Calibrated(model, **given),
        "calibrated confusion": wf.Calibrated(model, confusion=confusion, reliability=(2.0, 1.0), **given),
    }.items():
        out: list[object] = []
        belief = f.start(fix=wf.Fix(past[5][0]))
        for k, at in enumerate(tracks(1, 6)[5]):
            evidence: list[Any] = [wf.Fix(at)] if k % 4 < 3 else []
            if k % 5 == 4:
                evidence.append(wf.CoarseClass(int(t.alive(level)[k % 2]), level, 0.7))
            belief = f.step(belief, evidence, dt=1.0)
            out += [belief.points, belief.classes, belief.log_weights, belief.weights, belief.mean(), belief.cov()]
            out += [belief.log_evidence, belief.recoveries]
            if name != "bl2":
                out.append(belief.level(level).probability)
        ahead = f.forecast(belief, [2.0, 5.0])
        yield f"parts {name}", (*out, *(x for b in ahead for x in (b.points, b.mean(), b.cov())))


def of_scenes() -> Iterator[Named]:
    """The engines of the relational filter, with ids, without ids, and with a place where nobody is seen."""
    from wakefold.relations.model import couple_velocity, follow_velocity, near, same_velocity

    settings: dict[str, Any] = {"rate_on": 0.3, "rate_off": 0.05, "prior": 0.3}
    looks = wf.PairEvidence([0.0, 1.0, 3.0], [0.0, 0.5, 2.0], [0.0, 1.0], [[[0.4], [0.0]], [[-0.1], [-0.3]]], fade=0.3)
    person = ("person", "person")
    close = wf.Relation(
        "together",
        person,
        near(2.0) & same_velocity(0.5),
        couples=couple_velocity(0.5, 0.1, 0.02),
        evidence=looks,
        **settings,
    )
    leads = wf.Relation("follows", person, near(4.0), couples=follow_velocity(0.4, 0.2), **settings)
    passing = wf.Activity("visit", ("come", "together", "go"), min_time=2.0)
    model = wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35, speed=1.0)}, [close, leads], [passing])
    rng = np.random.default_rng(3)
    time = 0.4 * np.arange(16)[:, None]
    lines = [np.concatenate([1.2 * time, y + s * time], axis=1) for y, s in ((0, 0), (0.8, 0), (1.6, 0.3), (5, -0.2))]
    fixes = np.stack(lines, axis=1) + 0.3 * rng.normal(size=(16, 4, 2))

    def sight(at: np.ndarray) -> np.ndarray:
        return np.where((at[:, 0] > 2.5) & (at[:, 0] < 4.0), 0.0, 0.95)

    for engine in ("bootstrap", "rbk", "collapsed"):
        for case in ("ids", "no ids", "blind"):
            f = wf.RelationalFilter(model, engine, particles=60, gate=20.0, seed=2)
            scene, out = f.start(), []
            for k, at in enumerate(fixes):
                seen = np.arange(4) if case == "ids" else np.flatnonzero((at[:, 0] <= 2.5) | (at[:, 0] >= 4.0))
                ids = None if case == "no ids" else seen
                sensor: dict[str, Any] = {"detect_prob": sight if case == "blind" else 0.9}
                scan = wf.Detections(at[seen], sd=0.3, ids=ids, clutter=1e-3 if ids is None else 0.0, **sensor)
                scene = f.step(scene, scan, dt=0.4 if k else 0.0)
                out += [scene.mean, scene.cov, scene.existence, scene.log_evidence, scene.ids]
                for p in scene.pairs:  # an engine has one of these, and the other is told as empty
                    bits = getattr(p, "bits", np.zeros((0, len(p.p)), bool))
                    out += [p.p, bits, getattr(p, "states", np.zeros((0, 8))), *p.stages]
            yield f"parts {engine}, {case}", tuple(out)


def of_sequences() -> Iterator[Named]:
    """Hidden Markov models, pairs in phases, and the learning of relations."""
    from wakefold.relations.learning.together import crowd, fit
    from wakefold.relations.learning.walkers import follow
    from wakefold.relations.model import couple_velocity
    from wakefold.relations.phases import Phase, PhaseFilter, Turn

    rng = np.random.default_rng(5)
    for features in (2, 6):
        means = 2.0 * rng.normal(size=(3, features))
        x = [means[np.repeat(rng.integers(0, 3, 12), 5)] + rng.normal(size=(60, features)) for _ in range(4)]
        m = wf.GaussianHMM.learn(x, 3, np.random.default_rng(1))
        learned = (m.initial, m.transition, m.mean, m.cov)
        yield f"parts hmm {features}", (*learned, m.posterior(x[0]), *m.viterbi(x[1]), m.log_likelihood(x[2]))
    phases = [Phase("apart", 0.05, starts=1.0), Phase("meet", 0.02, 0.01, couple_velocity(0.02, 0.02, 1e-4), stages=2)]
    f = PhaseFilter(phases, [Turn("apart", "meet", 0.01, near=50.0), Turn("meet", "apart", 0.005)], speed=1.5)
    belief, out = f.start(3), []
    for k in range(20):
        seen = np.array([[[0.5, 0.1], [0.45, 0.1]]]) * 10.0 * k + 2.0 * rng.normal(size=(3, 2, 2))
        seen[k % 3, k % 2] = np.nan
        belief = f.step(belief, seen, 2.0, 10.0 if k else 0.0)
        out += [*belief, f.probabilities(belief), f.position(belief), f.log_odds(belief, ["meet"])]
    yield "parts phases", tuple(out)
    points, times, partners = [], [], set()
    while len(points) < 60:
        begin, length = int(rng.integers(0, 200)), int(rng.integers(15, 40))
        way = rng.uniform(-6, 6, 2) + np.cumsum(rng.normal((0.4, 0.0), 0.05, (length, 2)), axis=0)
        two = rng.random() < 0.5
        if two:
            partners.add((len(points), len(points) + 1))
        for side in (-0.45, 0.45) if two else (0.0,):
            points.append(way + np.array([0.0, side]) + np.cumsum(rng.normal(0.0, 0.03, (length, 2)), axis=0))
            times.append((begin + np.arange(length)) * 0.4)
    people = crowd(follow(wf.Tracks.from_arrays(points, times), 0.4), ghosts=4000)
    pairs = zip(people.pairs.first.tolist(), people.pairs.second.tolist(), strict=True)
    truth = np.array([pair in partners for pair in pairs])
    for online in (False, True):
        learned = fit([people], [truth], online=online)
        constants = learned.settle(people)
        values = (learned.weights, learned.friends, learned.spacing, *constants, learned.posterior(people, constants))
        yield f"parts relation learned{' online' if online else ''}", values


def parts() -> Iterator[Named]:
    """Names and values."""
    yield from of_tracks()
    yield from of_scenes()
    yield from of_sequences()
