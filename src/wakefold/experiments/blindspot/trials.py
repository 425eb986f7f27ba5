"""Three people through a blind spot, with relations and without (Figure 3 of Manfredotti et al. 2011).

Detections carry no identities. "plain" and "relational" are the same Rao-Blackwellised particle filter with the same
motion, sensor, association and number of particles; the plain one knows no relation. "plain, sampled" and
"Algorithm 1" are these two with sampled objects, the paper's own method, and ten times the particles. Settings were
chosen for the first two, on scenes of other seeds (10,000 and up). ``wakefold reproduce blindspot`` runs 100 scenes of
each sort.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wakefold.base.types import Floats
from wakefold.experiments.blindspot.scenes import BLIND, CLUTTER, DT, SD, Walk, visible, walk
from wakefold.relations.detections import Detections
from wakefold.relations.filter import RelationalFilter
from wakefold.relations.model import ConstantVelocity, Relation, RelationalModel, couple_velocity, near, same_velocity
from wakefold.relations.scene import Scene

NAMES = ("plain", "relational")
SAMPLED = ("plain, sampled", "Algorithm 1")
PARTICLES, SAMPLES = 100, 1_000
BIRTH = 1e-5  # new people per square metre and scan: hardly anybody appears while three walk by
SURE = 0.9  # a track that exists with less probability is nobody's: a false detection makes one too
SETTINGS: dict[str, float] = {"q": 0.4, "k": 0.5, "noise": 0.1, "hidden": 0.02, "pull": 0.02}


def model(related: bool, q: float, k: float, noise: float, hidden: float, pull: float) -> RelationalModel:
    """People who may walk together, or who may not."""
    together = Relation(
        "together",
        ("person", "person"),
        on_when=near(2.0) & same_velocity(0.6),
        rate_on=0.5,
        rate_off=0.005,
        rate_hidden=hidden,
        couples=couple_velocity(k, noise, pull),
    )
    return RelationalModel({"person": ConstantVelocity(q, speed=1.0)}, [together] if related else [])


class Outcome(NamedTuple):
    """What a filter made of a scene.

    Attributes:
        estimate: ``(T, 3, 2)`` where it believed each person, by the track that had the person before the blind spot.
        names: ``(3,)`` those tracks.
        swapped: ``(3,)`` whether the person's track ended on somebody or something else.
    """

    estimate: Floats
    names: NDArray[np.int64]
    swapped: NDArray[np.bool_]
    scenes: list[Scene]


def follow(scene: Walk, f: RelationalFilter) -> Outcome:
    """Run a filter over a scene."""
    beliefs, belief = [], f.start()
    for k, z in enumerate(scene.scans):
        scan = Detections(z, sd=SD, detect_prob=visible, clutter=CLUTTER, birth=BIRTH)
        belief = f.step(belief, scan, dt=DT if k else 0.0)
        beliefs.append(belief)
    before = int(np.argmax((scene.truth[:, :, 0] > BLIND[0] - 0.5).any(axis=1)))
    before = max(before, int(np.argmax((scene.truth[:, :, 0] > -3.0).all(axis=1))))
    names = owners(beliefs[before], scene.truth[before])
    estimate = np.empty(scene.truth.shape)
    for k, b in enumerate(beliefs):
        at = {int(i): x for i, x in zip(b.ids, b.mean[:, 0], strict=True)}
        for person, name in enumerate(names):
            estimate[k, person] = at.get(name, estimate[k - 1, person] if k else scene.truth[k, person])
    return Outcome(estimate, names, np.array(owners(beliefs[-1], scene.truth[-1])) != names, beliefs)


def owners(belief: Scene, truth: Floats) -> NDArray[np.int64]:
    """``(3,)`` the track of each person: the assignment with the least sum of squared distances; -1 for none."""
    tracks = belief.tracks(SURE)
    square = ((truth[:, None] - tracks.position) ** 2).sum(axis=2) if len(tracks.ids) else np.zeros((len(truth), 0))
    rows, columns = linear_sum_assignment(square)
    out = np.full(len(truth), -1, dtype=np.int64)
    out[rows] = tracks.ids[columns]
    return out


def tracker(name: str, seed: int, particles: int | None = None, **settings: float) -> RelationalFilter:
    """A filter of ``NAMES`` or ``SAMPLED``, with the particles and settings chosen unless others are given."""
    sampled, related = name in SAMPLED, name in ("relational", "Algorithm 1")
    some = model(related, **{**SETTINGS, **settings})
    count = particles or (SAMPLES if sampled else PARTICLES)
    engine = "bootstrap" if sampled else "rbk"
    return RelationalFilter(some, engine, particles=count, gate=6.0, forget=30.0, hypotheses=40, seed=seed)


def run(spec: Mapping[str, Any]) -> dict[str, Any]:
    """All filters on one scene: identity error and mean squared error of each."""
    scene, out = walk(spec["scene"], spec["seed"]), {}
    for name in spec.get("filters", (*NAMES, *SAMPLED)):
        f = tracker(name, spec["seed"], spec.get("particles"), **spec.get("settings", {}))
        o = follow(scene, f)
        square = ((o.estimate - scene.truth) ** 2).sum(axis=2)
        out[name] = {"error": bool(o.swapped.any()), "share": float(o.swapped.mean()), "mse": float(square.mean())}
    return out
