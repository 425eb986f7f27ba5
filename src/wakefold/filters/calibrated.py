"""A filter of matched likelihoods and exact class masses (docs/algorithm.md, The calibrated filter)."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from wakefold.base import random, small
from wakefold.base.random import agent_key
from wakefold.base.types import Floats, Ints
from wakefold.base.units import LOST, Time, timestamp
from wakefold.evidence.coarse import CoarseClass, alive_classes, coarse_log_g
from wakefold.evidence.confusion import Confusion, Reliability
from wakefold.evidence.evidence import Evidence
from wakefold.evidence.fix import Fix
from wakefold.filters.belief import Belief, GaussianBelief
from wakefold.filters.kernels import particles as kernel
from wakefold.filters.particles import RECOVER, START, Items, ParticleFilter, check_start
from wakefold.filters.resampling import pick_strata
from wakefold.filters.sets import Gaussians
from wakefold.model.deviation import KINDS, Deviation
from wakefold.model.kernels import components
from wakefold.model.model import Model
from wakefold.tracks.shaping import along


class _Cloud(NamedTuple):
    """Gaussian components; see ``Belief`` and ``Gaussians``."""

    points: Floats
    covs: Floats
    spreads: Floats
    classes: Ints
    log_weights: Floats
    trust: Floats


class Calibrated(ParticleFilter[GaussianBelief]):
    """Mixture Kalman filter over the tracks: nothing about classes is left to chance.

    Each particle is a track with a Gaussian for where the agent is beside it, moved by the track's velocity and
    corrected by fixes as in a Kalman filter, so its weight is the probability of all evidence under that track. Every
    track keeps particles of its own, up to three with different ideas of how far the agent strays, and none is ever
    drawn away: with a straight track the filter is the Kalman filter, with several the exact mixture.

    Args:
        model: what ``wakefold.learn`` made. Its noise is not used.
        particles: the most there are, but never fewer than tracks: every track keeps one at least, so a step takes as
            long as the model has tracks.
        sd: of a fix that does not tell its own, metres; the model's by default.
        deviation: how agents move beside their tracks; by default what the tracks show of one another.
        confusion: what reports of coarse evidence say about where agents are; by default the confidence that each
            report gives.
        reliability: beta prior of the share of reports that are genuine, which is inferred with the class; the rest may
            name any class. None: all are.
        switching: share of the mass that changes to a class drawn uniformly from the tracks at each step.
        seed: of all agents' random streams.

    Raises:
        ValueError: a setting out of range; the message names it.
    """

    kind = GaussianBelief

    def __init__(
        self,
        model: Model,
        particles: int = 100,
        *,
        sd: float | None = None,
        deviation: Deviation | None = None,
        confusion: Confusion | None = None,
        reliability: tuple[float, float] | None = (1.0, 1.0),
        switching: float = 1e-6,
        seed: int = 0,
    ) -> None:
        if not 0.0 <= switching <= 1.0:
            raise ValueError(f"switching must be a share within [0, 1], got {switching}")
        super().__init__(model, particles, sd=sd, depletion=switching, seed=seed)
        self.particles = max(self.particles, len(model.tracks))
        self.deviation = Deviation.learn(model) if deviation is None else deviation
        self.confusion = confusion
        self.reliability = Reliability.certain() if reliability is None else Reliability.beta(*reliability)
        each = self.particles // len(model.tracks)
        self._ratios = np.unique(self.deviation.quantiles(min(KINDS, each)))
        self._pieces = each // len(self._ratios)

    # Prior

    def start(
        self,
        *,
        fix: Fix | None = None,
        at: Literal["any", "begin"] = "any",
        time: Time | None = None,
        agent: str | None = None,
    ) -> GaussianBelief:
        """The prior belief about an agent: class uniform over the tracks, time uniform along the track.

        Args:
            fix: the posterior after this fix instead; every track keeps its exact mass.
            at: "any" time along the tracks, or their "begin" (as in the papers), give or take the spread.
            time: of the belief, seconds UTC, a datetime or ISO 8601 text.
            agent: a name; agents of different names draw different random numbers from the same seed.
        """
        check_start(fix, at, agent)
        key, tracks = agent_key(self.seed, agent), self.model.tracks
        u = np.empty(1)
        random.uniforms(key, 0, START, u)
        now = None if time is None else timestamp(time)
        if fix is not None:
            points, covs, spreads, classes, logs, trust = self._around(fix, np.zeros(len(tracks)), float(u[0]))
        else:
            points, covs, spreads, classes, logs, trust = self._along(at == "begin")
        gaussians = Gaussians(covs, spreads, trust)
        return GaussianBelief(self.model.filtration, points, classes, logs, key, time=now, gaussians=gaussians)

    def _along(self, begin: bool) -> _Cloud:
        """Every track at its first point, or cut into equal times with components over each piece."""
        tracks, kinds = self.model.tracks, len(self._ratios)
        pieces = 1 if begin else self._pieces
        chosen = np.repeat(np.arange(len(tracks)), pieces * kinds)
        number = np.arange(len(chosen))
        share = np.zeros(len(chosen)) if begin else (number // kinds % pieces + 0.5) / pieces
        points = along(tracks, chosen, share)
        spreads = self.deviation.scales[chosen] * self._ratios[number % kinds]
        length = np.zeros(len(chosen)) if begin else tracks.length[chosen] / pieces
        covs = _beside(self.model.dynamics.velocity(points, chosen), length, spreads)
        return self._cloud(points, covs, spreads, chosen, np.zeros(len(chosen)))

    def _around(self, fix: Fix, log_mass: Floats, u: float) -> _Cloud:
        """Components at points of the tracks, corrected by a fix; each track's mass is the exact sum over its points.

        Args:
            log_mass: (M,) of the tracks before the fix.
            u: uniform; of a track with more points than it may have components, they are drawn systematically.
        """
        d, tracks = self.model.dynamics, self.model.tracks
        owner = np.repeat(self.model.filtration.order, np.diff(d.starts))
        prior = (log_mass - small.log(tracks.lengths))[owner]
        length = np.linalg.norm(d.velocities, axis=1) * d.interval
        kinds: list[tuple[Floats, Floats, Floats, Ints, Floats]] = []
        for ratio in self._ratios:
            points, spreads = d.points.copy(), self.deviation.scales[owner] * ratio
            covs = _beside(d.velocities, length, spreads)
            logs, _ = self._correct(points, covs, fix)
            if (logs + prior).max() == -math.inf:  # too many sd away for the arithmetic: the nearest points, all alike
                away = np.abs(points - fix.on_plane(tracks.projection, d.dim)).max(axis=1)
                away[prior == -math.inf] = math.inf
                logs = np.where(away == away.min(), 0.0, -math.inf)
            rows, weights = _thinned(logs + prior, d.starts, self.particles // len(self._ratios), u)
            kinds.append((points[rows], covs[rows], spreads[rows], owner[rows], weights))
        points, covs, spreads, classes, logs = zip(*kinds, strict=True)
        parts = (np.concatenate(points), np.concatenate(covs), np.concatenate(spreads), np.concatenate(classes))
        return self._cloud(*parts, np.concatenate(logs))

    def _cloud(self, points: Floats, covs: Floats, spreads: Floats, classes: Ints, logs: Floats) -> _Cloud:
        """Components with normalised weights, in the order of their tracks, and trust as at the beginning."""
        by = np.argsort(self.model.filtration.rank[classes], kind="stable")
        trust = np.tile(self.reliability.log_weights, (len(by), 1))
        return _Cloud(points[by], covs[by], spreads[by], classes[by], logs[by] - kernel.log_sum(logs), trust)

    # Steps

    def _step(self, belief: Belief, items: Items, dt: float, now: float | None) -> GaussianBelief:
        tree = self.model.filtration
        cloud = self._opened(belief)
        if self.depletion > 0.0:
            components.mix_classes(cloud.log_weights, cloud.classes, self.depletion, len(tree))
        self._advance(cloud, dt)
        told = []
        for level, item in items:
            before = cloud.log_weights.copy()
            if isinstance(item, Fix):
                log_g, away = self._correct(cloud.points, cloud.covs, item)
                logs = cloud.log_weights
                logs += log_g
                lost = not away <= LOST
            else:
                logs = cloud.log_weights
                components.weigh_report(logs, *self._report(cloud, item, level), cloud.trust, self.reliability.nodes)
                lost = False
            gain = kernel.log_sum(logs)
            lost = lost or gain == -math.inf
            told.append((gain, lost))
            if lost:
                cloud = self._recovered(belief, cloud._replace(log_weights=before), item, level)
                continue
            if isinstance(item, Fix) and self.deviation.power < 1.0:
                components.temper(logs, before, cloud.classes, self.deviation.power, len(tree))
                gain = kernel.log_sum(logs)
            logs -= gain
        gaussians = Gaussians(cloud.covs, cloud.spreads, cloud.trust)
        return self._after(belief, cloud.points, cloud.classes, cloud.log_weights, now, told, gaussians=gaussians)

    def _opened(self, belief: Belief) -> _Cloud:
        """A copy of the components of a belief."""
        own = self._own(belief).gaussians
        if own.trust.shape[1] != len(self.reliability.nodes):
            raise ValueError("the belief was made by a filter of another reliability: start a new one with this filter")
        points, classes, logs = np.array(belief.points), np.array(belief.classes), np.array(belief.log_weights)
        return _Cloud(points, np.array(own.covs), np.array(own.spreads), classes, logs, np.array(own.trust))

    def _advance(self, cloud: _Cloud, dt: float) -> None:
        """Move the components in place."""
        self.deviation.advance(self.model.dynamics, cloud.points, cloud.covs, cloud.spreads, cloud.classes, dt)

    def _correct(self, points: Floats, covs: Floats, fix: Fix) -> tuple[Floats, float]:
        """Correct components in place; their log-likelihoods, and how many sd the fix is away from the nearest."""
        dynamics = self.model.dynamics
        at = fix.on_plane(self.model.tracks.projection, dynamics.dim)
        sd = self.sd if fix.sd is None else fix.sd
        log_g = np.empty(len(points))
        return log_g, components.correct(points, covs, at, sd**2 + dynamics.floor**2, log_g, dynamics.dims)

    def _report(self, cloud: _Cloud, item: CoarseClass, level: float) -> tuple[Floats, float, float]:
        """Probability of a report about an agent of each component if it is genuine, (n,), and if not; the power."""
        if self.confusion is not None:  # such a report tells where the agent is, as a fix does
            return *self.confusion.probability(item.class_, cloud.points, cloud.covs), self.deviation.power
        tree = self.model.filtration
        others = len(tree.cuts(level)) - 2
        if others == 0:
            return np.ones(len(cloud.classes)), 1.0, 1.0
        above = alive_classes(tree, cloud.classes, level)
        log_g = coarse_log_g(tree, item, level, above, "gaussian", self.model.dynamics.diagonal)
        return small.exp(log_g), 1.0 / (others + 1), 1.0

    def _recovered(self, belief: Belief, cloud: _Cloud, item: Evidence, level: float) -> _Cloud:
        """The cloud started anew from evidence that it holds to be impossible."""
        tracks = len(self.model.tracks)
        if isinstance(item, Fix):
            peak = cloud.log_weights.max()
            mass = np.bincount(cloud.classes, small.exp(cloud.log_weights - peak), tracks)
            mass = (1.0 - self.depletion) * mass / mass.sum() + self.depletion / tracks
            u = np.empty(1)
            random.uniforms(belief.key, belief.step + 1, RECOVER, u)
            return self._around(item, small.log(mass), float(u[0]))
        classes, count = np.unique(self._recover_class(belief, item, level), return_counts=True)
        weights = small.exp(cloud.log_weights - cloud.log_weights.max())
        weights /= weights.sum()
        mean = small.mean(weights, cloud.points)
        away = cloud.points - mean
        cov = (weights[:, None, None] * (cloud.covs + away[:, :, None] * away[:, None, :])).sum(axis=0)
        n = len(classes)
        points, covs = np.tile(mean, (n, 1)), np.tile(cov, (n, 1, 1))
        return self._cloud(points, covs, np.full(n, (weights * cloud.spreads).sum()), classes, small.log(count))

    def _ahead(self, belief: GaussianBelief, leg: int, dt: float) -> GaussianBelief:
        cloud = self._opened(belief)
        self._advance(cloud, dt)
        return replace(belief, points=cloud.points, gaussians=Gaussians(cloud.covs, cloud.spreads, cloud.trust))

    def genuine(self, belief: Belief) -> float:
        """Expected share of genuine reports, given all there were; 1 when reports are taken to be genuine."""
        return float((small.mean(belief.weights, small.exp(self._opened(belief).trust)) * self.reliability.nodes).sum())


def _beside(velocity: Floats, length: Floats, spreads: Floats) -> Floats:
    """Covariances (n, d, d) of the prior beside a track: the spread (n,), and even over a length (n,) along it."""
    speed2 = np.square(velocity).sum(axis=1)
    stretch = np.divide(length**2 / 12.0, speed2, out=np.zeros_like(length), where=speed2 > 0)
    covs = stretch[:, None, None] * velocity[:, :, None] * velocity[:, None, :]
    return covs + np.eye(velocity.shape[1]) * np.square(spreads)[:, None, None]


def _thinned(logs: Floats, starts: Ints, particles: int, u: float) -> tuple[Ints, Floats]:
    """Points that become components, and their log-weights.

    Of every track (its points are ``starts[k]:starts[k + 1]``) as many as it may have, drawn systematically, share its
    exact mass.
    """
    tracks = len(starts) - 1
    most = particles // tracks
    one = np.array([u])
    rows, weights = [], []
    for first, last in itertools.pairwise(starts):
        mass = kernel.log_sum(logs[first:last])
        if mass > -math.inf:
            found, count = np.unique(pick_strata(logs[first:last], one, most), return_counts=True)
            rows.append(first + found)
            weights.append(mass + small.log(count / most))
    return np.concatenate(rows), np.concatenate(weights)
