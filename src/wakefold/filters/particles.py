"""What the particle filters share: prior, resampling, motion, the weight of a fix, recovery and forecast.

Every random number is a function of (the agent's key, step, purpose, index), see ``base/random.py``: the base set of
MHPF and BL1 draw the same numbers, and no agent's numbers depend on another's.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from wakefold.base import checks, random, small
from wakefold.base.random import agent_key
from wakefold.base.types import Floats, Ints
from wakefold.base.units import LOST, Time, timestamp
from wakefold.evidence.coarse import CoarseClass, Family, coarse_log_g
from wakefold.evidence.evidence import Evidence, in_order
from wakefold.evidence.fix import Fix
from wakefold.filters.belief import Belief
from wakefold.filters.kernels import particles as kernel
from wakefold.filters.resampling import SCHEMES, Resampling, pick_strata, resample
from wakefold.model.kernels import motion
from wakefold.tracks.shaping import along

if TYPE_CHECKING:
    from wakefold.model.model import Model

Items = Sequence[tuple[float, Evidence]]
Kind = TypeVar("Kind", bound=Belief)

START, OPEN, NOISE, COPIES, RECOVER, FORECAST = range(6)  # purposes of random streams
FAMILIES: dict[str, int] = {"log": kernel.LOG, "gaussian": kernel.GAUSSIAN, "student": kernel.STUDENT}
NOISES = {"gaussian": motion.GAUSSIAN, "uniform": motion.UNIFORM}
NONE = np.empty(0, dtype=np.int64)
MOST_PARTICLES = 100_000_000  # of an agent: a gigabyte and more
BELIEF = "a filter takes a Belief, as start and step return it"


def check_start(fix: object, at: object, agent: object) -> None:
    """Refuse what no belief can start from.

    Raises:
        TypeError, ValueError: there is something.
    """
    if fix is not None:
        checks.instance(fix, Fix, "fix must be a Fix")
    if agent is not None:
        checks.instance(agent, str, "agent must be a name, a text")
    if at not in ("any", "begin"):
        raise ValueError(f"at must be 'any' or 'begin', got {checks.shown(at)}")


def elapsed(belief: Belief, dt: float | None, time: Time | None) -> tuple[float, float | None]:
    """Length of a step (s) and the time at its end, from ``dt`` or the time of the evidence.

    Raises:
        ValueError: both or neither given, or a time before the belief's.
    """
    checks.instance(belief, Belief, BELIEF)
    if (dt is None) == (time is None):
        raise ValueError("step takes either dt or time")
    if time is None:
        seconds = checks.real(dt, "dt")
        return seconds, None if belief.time is None else belief.time + seconds
    now = timestamp(time)
    if belief.time is None:
        return 0.0, now
    if now < belief.time:
        raise ValueError(f"time runs backwards: evidence of {now:.3f} after the belief of {belief.time:.3f}")
    return now - belief.time, now


def _draw(fill, key: NDArray[np.uint64], step: int, purpose: int, shape: tuple[int, ...]) -> Floats:
    out = np.empty(shape)
    fill(key, step, purpose, out.reshape(-1))
    return out


class ParticleFilter(ABC, Generic[Kind]):
    """Settings, prior, motion, the weight of a fix, recovery and forecast: all but what a step does.

    Args:
        model: what ``wakefold.learn`` made.
        particles: N.
        likelihood: "gaussian" or "student" density of a fix, with proper coarse evidence; "log" for the papers' weight.
        sd: of a fix that does not tell its own, metres; the model's by default.
        dof: degrees of freedom of "student".
        depletion: share v of the particles whose class is redrawn whenever the set is resampled: ``redrawn`` =
            round(v N) of them. Where that is none, v only lets an agent that was lost be found on any track.
        resampling: "systematic", "stratified", "multinomial" or "residual".
        ess_threshold: resample when the effective sample size falls below this share of N; None: every step.
        seed: of all agents' random streams.

    Raises:
        ValueError: a setting out of range; the message names it.
    """

    single = True  # particles follow single tracks (BL2: the field of all tracks)
    kind: ClassVar[type[Belief]]  # of its beliefs: what it makes and takes

    def __init__(
        self,
        model: Model,
        particles: int = 100,
        *,
        likelihood: Family = "gaussian",
        sd: float | None = None,
        dof: float = 4.0,
        depletion: float = 0.01,
        resampling: Resampling = "systematic",
        ess_threshold: float | None = None,
        seed: int = 0,
    ) -> None:
        from wakefold.model.model import Model

        checks.instance(model, Model, "a filter takes a Model, as learn and load return it")
        sd = model.sd if sd is None else checks.real(sd, "sd")
        dof, depletion = checks.real(dof, "dof"), checks.real(depletion, "depletion")
        particles = checks.whole(particles, "particles", most=MOST_PARTICLES)
        if likelihood not in FAMILIES:
            raise ValueError(f"likelihood must be one of {', '.join(FAMILIES)}, got {likelihood!r}")
        if not 0.0 < sd < math.inf:
            raise ValueError(f"sd must be a positive number of metres, got {sd}")
        if not 0.0 < dof < math.inf:
            raise ValueError(f"dof must be a positive number, got {dof}")
        if not 0.0 <= depletion <= 1.0:
            raise ValueError(f"depletion must be a share within [0, 1], got {depletion}")
        if resampling not in SCHEMES:
            raise ValueError(f"resampling must be one of {', '.join(SCHEMES)}, got {resampling!r}")
        if ess_threshold is not None and not 0.0 < ess_threshold <= 1.0:
            raise ValueError(f"ess_threshold must be a share of the particles within (0, 1], got {ess_threshold}")
        self.model = model
        self.particles = particles
        self.likelihood: Family = likelihood
        self.sd = float(sd)
        self.dof = float(dof)
        self.depletion = float(depletion)
        self.resampling: Resampling = resampling
        self.ess_threshold = ess_threshold
        self.seed = checks.whole(seed, "seed", least=-(1 << 127), most=1 << 128)
        self._noise = NOISES[model.dynamics.noise], model.dynamics.scale
        self.redrawn = round(self.depletion * self.particles) if self.single else 0
        self._even = np.full(self.particles, -math.log(self.particles))  # log-weights of an unweighted set
        self._remember()

    def _remember(self) -> None:
        """What steps look up again and again: no values, so neither copied nor pickled."""
        self._coarse = lru_cache(maxsize=64)(self._coarse_log_g)
        self._rows = lru_cache(maxsize=1)(self._rows_of_tracks)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if not hasattr(value, "cache_info")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._remember()

    @property
    def marginal(self) -> bool:
        """Whether ``log_evidence`` is the log marginal likelihood of the evidence taken; if not, it is None."""
        return self.likelihood != "log"

    # Prior, step and forecast

    def start(
        self,
        *,
        fix: Fix | None = None,
        at: Literal["any", "begin"] = "any",
        time: Time | None = None,
        agent: str | None = None,
    ) -> Kind:
        """The prior belief about an agent: class uniform over the tracks, time uniform along the track.

        Args:
            fix: draw from the points of all tracks instead, in proportion to the likelihood of this fix.
            at: "any" time along the tracks, or their "begin" (as in the papers).
            time: of the belief, seconds UTC, a date, datetime or datetime64, or ISO 8601 text.
            agent: a name; agents of different names draw different random numbers from the same seed.
        """
        check_start(fix, at, agent)
        tree, tracks = self.model.filtration, self.model.tracks
        key = agent_key(self.seed, agent)
        u = _draw(random.uniforms, key, 0, START, (2, self.particles))
        if fix is not None:
            points, classes = self._points_near(fix, np.zeros(len(tracks)), u[0, :1])
        else:
            classes = (u[0] * len(tracks)).astype(np.int64)
            share = u[1] if at == "any" else np.zeros(self.particles)
            points = along(tracks, classes, share)
        if not self.single:
            classes = np.full(self.particles, tree.root)
        evidence = 0.0 if self.marginal else None
        now = None if time is None else timestamp(time)
        started: Any = self.kind(
            tree, points, classes, self._even, key, time=now, log_evidence=evidence, log_evidence_since=evidence
        )
        return started

    def step(
        self,
        belief: Belief,
        evidence: Sequence[Evidence] = (),
        dt: float | None = None,
        *,
        time: Time | None = None,
    ) -> Kind:
        """The belief after ``dt`` seconds (or at ``time``) and the evidence; no evidence is a missing observation.

        Raises:
            ValueError, TypeError: evidence that does not fit the model, or a time that runs backwards.
        """
        items = in_order(evidence, self.model.filtration)
        dt, now = elapsed(belief, dt, time)
        return self._step(belief, items, dt, now)

    @abstractmethod
    def _step(self, belief: Belief, items: Items, dt: float, now: float | None) -> Kind:
        """``step`` by evidence in order and its levels, over ``dt`` seconds up to ``now``."""

    @overload
    def forecast(self, belief: Belief, horizon: float) -> Kind: ...
    @overload
    def forecast(self, belief: Belief, horizon: Sequence[float]) -> list[Kind]: ...
    def forecast(self, belief: Belief, horizon: float | Sequence[float]) -> Kind | list[Kind]:
        """The base particles moved ahead without evidence: a belief about ``horizon`` seconds from now.

        Several horizons, in rising order, give a list of beliefs along the same sampled paths. The belief it starts
        from, and its random stream, stay as they are.
        """
        one = isinstance(horizon, (int, float))
        if not one and (isinstance(horizon, str) or not isinstance(horizon, Iterable)):
            raise TypeError(f"horizon must be a number of seconds, or several of them, got {checks.shown(horizon)}")
        horizons = [checks.real(h, "horizon") for h in ([horizon] if one else horizon)]
        now, done, out = self._bare(self._own(belief)), 0.0, []
        for leg, h in enumerate(horizons):
            if not h >= done:
                raise ValueError(f"horizons must be seconds >= 0 in rising order, got {h} after {done}")
            now = self._ahead(now, leg, h - done)
            done = h
            out.append(replace(now, time=None if belief.time is None else belief.time + h))
        return out[0] if one else out

    def _ahead(self, belief: Kind, leg: int, dt: float) -> Kind:
        """One leg of a forecast."""
        points = belief.points.copy()
        self._roll(belief, FORECAST + leg, points, belief.classes, dt)
        return replace(belief, points=points)

    def _own(self, belief: Belief) -> Kind:
        """Refuse a belief of another kind of filter, or about other classes, whose numbers mean nothing here.

        Raises:
            TypeError: it is no belief.
            ValueError: another kind of filter made it, or it is of another filtration.
        """
        if not isinstance(belief, self.kind):
            if not isinstance(belief, Belief):
                raise TypeError(f"{BELIEF}, got {checks.shown(belief)}")
            made, mine = belief.filter, self.kind.filter
            raise ValueError(f"the belief was made by another filter, {made}: start a new one with this {mine}")
        if belief.tree is not self.model.filtration and not belief.tree.same_as(self.model.filtration):
            raise ValueError("the belief is about the classes of another filtration: start a new one with this filter")
        own: Any = belief
        return own

    def _bare(self, belief: Kind) -> Kind:
        """The belief without what a forecast does not take along."""
        return belief

    def _after(
        self,
        belief: Belief,
        points: Floats,
        classes: Ints,
        log_weights: Floats,
        time: float | None,
        told: Sequence[tuple[float, bool]],
        **more: Any,
    ) -> Kind:
        """The belief after a step.

        Args:
            told: of each item of evidence its log-likelihood, and whether the agent was lost at it and found again.
            more: what else has changed.
        """
        total, since, recoveries = belief.log_evidence, belief.log_evidence_since, belief.recoveries
        for gain, lost in told:
            recoveries += lost
            if total is not None and since is not None:
                total, since = total + gain, 0.0 if lost else since + gain
        made: Any = self.kind(
            belief.tree, points, classes, log_weights, belief.key, belief.step + 1, time, total, since, recoveries,
            **({"ignored": belief.ignored} | more),
        )  # fmt: skip
        return made

    # Step 1: resample and replace

    def _open(self, belief: Belief) -> tuple[Floats, Ints, Floats]:
        """Resample, then replace a share of the classes, drawn uniformly from the tracks; positions are kept.

        Under ``ess_threshold`` both happen only when the effective sample size falls below that share of N.
        """
        count, key, step = self.particles, belief.key, belief.step + 1
        self._own(belief)
        if len(belief.points) != count:
            raise ValueError(f"the belief has {len(belief.points)} particles, the filter {count}")
        if self.ess_threshold is not None and belief.ess >= self.ess_threshold * count:
            return belief.points.copy(), belief.classes.copy(), belief.log_weights.copy()
        first, kept = 1 if self.resampling == "systematic" else count, NONE
        if self.resampling in ("multinomial", "residual"):
            kept = resample(belief.log_weights, _draw(random.uniforms, key, step, OPEN, (first,)), self.resampling)
        state, leaves = (belief.log_weights, belief.points, belief.classes), len(self.model.filtration)
        points, classes = kernel.opened(key, step, OPEN, *state, kept, first, self.redrawn, leaves)
        return points, classes, self._even.copy()

    # Step 2: motion

    def _span(self, dt: float) -> tuple[int, int, float]:
        """The first sub-step, how many there are and their length, s, as the kernels take them."""
        parts = self.model.dynamics.substeps(dt)
        return 0, parts, dt / max(parts, 1)

    def _roll(self, belief: Belief, purpose: int, points: Floats, classes: Ints, dt: float) -> None:
        """Move particles under their own classes, in place, by the noise of the belief's next step."""
        stream, ground = (belief.key, belief.step + 1, purpose), self.model.dynamics.ground
        motion.roll(points, classes, motion.ALONE, points, stream, self._noise, self._span(dt), ground)

    # Step 4: a fix, and what to do when every weight is zero

    def _fix(self, fix: Fix) -> tuple[Floats, int, float, float, float]:
        """A fix as the kernels take it: position (d,), family, scale, degrees of freedom, distance that means lost."""
        dynamics = self.model.dynamics
        at = fix.on_plane(self.model.tracks.projection, dynamics.dim)
        if self.likelihood == "log":
            limit = math.inf if fix.sd is None else LOST * fix.sd
            return at, kernel.LOG, dynamics.diagonal or 1.0, self.dof, limit
        scale = self.sd if fix.sd is None else fix.sd
        return at, FAMILIES[self.likelihood], scale, self.dof, LOST * scale

    def _recover_fix(self, belief: Belief, fix: Fix, classes: Ints, log_weights: Floats) -> tuple[Floats, Ints]:
        """Points of all tracks, drawn in proportion to class mass times the likelihood of the fix; their classes.

        A share v of the mass is spread evenly, as the replacement of classes would, so that a class that has no
        particle left can be found again.
        """
        count, (_, log_lengths) = len(self.model.tracks), self._rows()
        weights = small.exp(log_weights - log_weights.max())
        mass = np.bincount(classes, weights, count) if self.single else np.ones(count)
        mass = (1.0 - self.depletion) * mass / mass.sum() + self.depletion / count
        u = _draw(random.uniforms, belief.key, belief.step + 1, RECOVER, (1,))
        log_mass = small.log(mass) - log_lengths
        points, found = self._points_near(fix, log_mass, u)
        return points, found if self.single else classes

    def _recover_class(self, belief: Belief, item: CoarseClass, level: float) -> Ints:
        """Classes drawn from the prior in proportion to the likelihood of coarse evidence that no particle met."""
        log_g = self._coarse(item, level)[: len(self.model.filtration)]
        u = _draw(random.uniforms, belief.key, belief.step + 1, RECOVER, (1,))
        return pick_strata(log_g, u, self.particles)

    def _coarse_log_g(self, item: CoarseClass, level: float) -> Floats:
        """``(C,)`` log-likelihood of coarse evidence for the class alive at its level above (or at) each class.

        Asked by ``_coarse``, which remembers the answer: reports name few classes, and working it out for the
        particles at hand took longer than the rest of a step. 0 for inner classes that are not alive at the level.
        """
        tree = self.model.filtration
        alive, out = tree.alive(level), np.zeros(len(tree.birth))
        out[alive] = coarse_log_g(tree, item, level, alive, self.likelihood, self.model.dynamics.diagonal)
        out[tree.order] = np.repeat(out[alive], tree.hi[alive] - tree.lo[alive])
        return out

    def _rows_of_tracks(self) -> tuple[Ints, Floats]:
        """``(P,)`` track of each training point, ``(M,)`` logs of the numbers of points; asked by ``_rows``."""
        lengths = self.model.tracks.lengths
        return np.repeat(np.arange(len(lengths)), lengths), small.log(lengths)

    def _points_near(self, fix: Fix, log_mass: Floats, u: Floats) -> tuple[Floats, Ints]:
        """Training points drawn in proportion to exp(log mass of their track) times the likelihood; their tracks."""
        tracks, (owner, _) = self.model.tracks, self._rows()
        log_g = np.empty(len(owner))
        writable = tracks.points.copy()  # those of a model are not: the kernel would be compiled once more
        kernel.log_likelihood(writable, *self._fix(fix)[:-1], log_g)
        log_weights = log_g + log_mass[owner]
        if log_weights.max() == -math.inf:  # too many sd away for the arithmetic: the nearest points, all alike
            away = np.abs(tracks.points - fix.on_plane(tracks.projection, tracks.dim)).max(axis=1)
            away[log_mass[owner] == -math.inf] = math.inf
            log_weights = np.where(away == away.min(), log_mass[owner], -math.inf)
        rows = pick_strata(log_weights, u, self.particles)
        return tracks.points[rows], owner[rows]
