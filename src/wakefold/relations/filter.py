"""The relational particle filter: several objects and what they are to each other.

Manfredotti, Fleet, Hamilton and Zilles, "Relational Particle Filtering" (2011), and what makes it usable: objects by
Kalman filters given the relations (Rao-Blackwellised), or relations summed out for each pair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from wakefold.base.random import agent_key
from wakefold.base.units import Time, timestamp
from wakefold.relations.activities import begin
from wakefold.relations.detections import Detections
from wakefold.relations.engines import collapsed
from wakefold.relations.engines import sampled as joint
from wakefold.relations.engines.objects import Settings
from wakefold.relations.kernels.histories import MOST, WIDTH
from wakefold.relations.model import RelationalModel, Sampler
from wakefold.relations.pairs import GaussianPairs, ParticlePairs
from wakefold.relations.predicates import number
from wakefold.relations.scene import CollapsedScene, Particles, ParticleScene, Scene, outline

Engine = Literal["bootstrap", "rbk", "collapsed"]
ENGINES = ("bootstrap", "rbk", "collapsed")
LONGEST = 1e10  # seconds of a step


class RelationalFilter:
    """Follows several objects together with the relations between them.

    Engines, all of the same model and with the same answers:

    - "bootstrap": Algorithm 1 of the paper; objects and relations are sampled, then weighed by what is seen.
    - "rbk": relations are sampled, objects follow by Kalman filter.
    - "collapsed": the relation of each pair is summed out; for hundreds of objects. No particles, no chance.

    The first two keep joint hypotheses about sets of objects that may be related (blocks).

    Args:
        model: kinds of objects, relations, activities.
        engine: see above.
        particles: of the first two engines.
        gate: pairs farther apart than this, metres, are taken as unrelated.
        forget: seconds after which an object that is not seen is let go.
        cluster: most objects of a block.
        hypotheses: how many joint assignments are weighed for detections without ids.
        histories: most Gaussians that "collapsed" keeps of a pair unrelated, and of a pair related; up to 16.
        seed: of the random stream.

    Raises:
        ValueError: a setting out of range; the message names it.
    """

    def __init__(
        self,
        model: RelationalModel,
        engine: Engine = "collapsed",
        *,
        particles: int = 100,
        gate: float = 10.0,
        forget: float = 60.0,
        cluster: int = 8,
        hypotheses: int = 10,
        histories: int = 4,
        seed: int = 0,
    ) -> None:
        if not isinstance(model, RelationalModel):
            raise TypeError(f"RelationalFilter takes a RelationalModel, got {model!r}")
        if engine not in ENGINES:
            raise ValueError(f"engine must be one of {', '.join(ENGINES)}, got {engine!r}")
        for name, count in (
            ("particles", particles),
            ("cluster", cluster),
            ("hypotheses", hypotheses),
            ("histories", histories),
        ):
            if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
                raise ValueError(f"{name} must be a whole number of at least 1, got {count}")
        if histories > MOST:
            raise ValueError(f"histories must be {MOST} at most, got {histories}")
        if not 0.0 < number("gate (metres)", gate) < math.inf:
            raise ValueError(f"gate must be a positive number of metres, got {gate}")
        if not number("forget (seconds)", forget) > 0.0:
            raise ValueError(f"forget must be a positive number of seconds, got {forget}")
        if engine != "bootstrap":
            for kind, motion in model.objects.items():
                if isinstance(motion, Sampler):
                    raise ValueError(f"kind {kind!r}: motion by a Sampler needs engine='bootstrap', got {engine!r}")
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise ValueError(f"seed must be a whole number of at least 0, got {seed!r}")
        self.model, self.seed = model, int(seed)
        self.settings = Settings(
            model, engine, int(particles), float(gate), float(forget), int(cluster), int(hypotheses), int(histories)
        )

    def start(self, time: Time = 0.0, *, agent: str | None = None) -> Scene:
        """The belief before anything is seen: no objects.

        Args:
            time: seconds (UTC), a datetime or ISO 8601 text.
            agent: a name; scenes of different names draw different random numbers from the same seed.
        """
        none, whole = np.zeros(0), np.zeros(0, dtype=np.int64)
        unpaired = [
            (whole, whole, none, none, tuple(begin(none) for _ in self.model.activities_of(r)))
            for r in self.model.relations
        ]
        state, spread = np.zeros((0, 2, 2)), np.zeros((0, 3))
        nobody = (self.model, whole, whole, whole, state, spread, none, none)
        key, now = agent_key(self.seed, agent), timestamp(time)
        if self.settings.engine == "collapsed":
            pairs = tuple(GaussianPairs(*p, np.zeros((0, 2), np.int64), np.zeros((0, WIDTH))) for p in unpaired)
            return CollapsedScene(*nobody, pairs, key, time=now, own_mean=state, own_cov=spread)
        count = self.settings.particles
        bits = tuple(ParticlePairs(*p, np.zeros((count, 0), bool)) for p in unpaired)
        particles = Particles(np.zeros((count, 2, 0, 2)), np.zeros((count, 0, 0)), np.zeros((count, 0)), whole)
        return ParticleScene(*nobody, bits, key, time=now, particles=particles, engine=self.settings.engine)

    def step(
        self,
        scene: Scene,
        scans: Detections | Sequence[Detections] = (),
        dt: float | None = None,
        *,
        time: Time | None = None,
    ) -> Scene:
        """The belief after ``dt`` seconds (or at ``time``) and what was seen then.

        Args:
            scans: one scan, or several of one moment. None at all: nobody looked. An empty scan: nobody was seen.

        Raises:
            ValueError, TypeError: scans that do not fit the scene or the model, or a time that runs backwards.
        """
        if (dt is None) == (time is None):
            raise ValueError("step takes either dt or time")
        if not isinstance(scene, Scene):
            raise TypeError(f"step takes a Scene, as start and step return it, got {scene!r}")
        seconds = timestamp(time) - scene.time if time is not None else number("dt (seconds)", dt)
        if not 0.0 <= seconds <= LONGEST:
            raise ValueError(f"time must not run backwards, nor {LONGEST:g} s at once: dt is {seconds}")
        if isinstance(scans, Detections):
            scans = [scans]
        for scan in scans:
            if not isinstance(scan, Detections):
                raise TypeError(f"step takes Detections, got {scan!r}")
        if not scans:
            return self._one(scene, None, seconds)
        for scan in scans:
            scene = self._one(scene, scan.sorted(), seconds)
            seconds = 0.0  # the others are of the same moment
        return scene

    def _one(self, scene: Scene, scan: Detections | None, dt: float) -> Scene:
        if scene.model is not self.model and outline(scene.model) != outline(self.model):
            raise ValueError("the scene was made with another relational model")
        if scan is not None:
            scan.kind_numbers(self.model.kinds)  # whether it knows them all
        engine = self.settings.engine
        if engine == "collapsed" and isinstance(scene, CollapsedScene):
            return collapsed.step(self.settings, scene, scan, dt)
        made = scene.engine if isinstance(scene, ParticleScene) else "collapsed"
        if engine != "collapsed" and isinstance(scene, ParticleScene) and made in (None, engine):
            return joint.step(self.settings, scene, scan, dt)
        by = "an engine with particles" if made is None else f"another engine, {made!r}"
        raise ValueError(f"the scene was made by {by}: start a new one with this {engine!r}")
