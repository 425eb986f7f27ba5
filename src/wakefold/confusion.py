"""What reports of coarse evidence are worth: how often they are wrong, from simulation, and how many are genuine."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, roots_jacobi

from wakefold.deviation import Deviation
from wakefold.particles import along

if TYPE_CHECKING:
    from wakefold.model import Model

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Reporter = Callable[[Floats, np.random.Generator], Ints]
"""Classes ``(n,)`` that somebody would report of agents at positions ``(n, d)``, with the reporter's own errors."""

NODES = 16  # of the quadrature: exact up to 31 reports, close beyond
PRIOR = 2.0  # reports that every track is taken to have had before the simulation


@dataclass(frozen=True, eq=False)
class Confusion:
    """How often agents of each track are reported to be of each class.

    Attributes:
        shares: ``(M, C)`` of the reports about an agent of a track that name a class; rows sum to 1.
        chance: ``(C,)`` of reports that have nothing to do with the agent.
        power: to which the probability of a report is raised, in [0, 1]: the reporter errs about one agent again and
            again, so many reports tell less than as many independent ones would.
    """

    shares: Floats
    chance: Floats
    power: float = 1.0

    @classmethod
    def learn(
        cls,
        model: Model,
        reporter: Reporter,
        *,
        deviation: Deviation | None = None,
        agents: int = 4,
        reports: int = 12,
        seed: int = 0,
    ) -> Confusion:
        """Let the reporter name the classes of simulated agents, who stray from the tracks as agents do.

        The power is the one under which the reports about one agent, with shares learned from all others, give its
        track the largest mean log-probability.

        Args:
            reporter: see ``Reporter``; asked once, about all positions.
            deviation: by default what the tracks show of one another.
            agents: of each track, two or more; each keeps its offset from the track.
            reports: about each agent, at even times along the track.

        Raises:
            ValueError: the reporter does not name a class of the model for every position.
        """
        beside = Deviation.learn(model) if deviation is None else deviation
        tracks, classes = model.tracks, len(model.filtration.birth)
        rng = np.random.default_rng(seed)
        owner = np.repeat(np.arange(len(tracks)), agents)
        sizes = beside.scales[owner] * np.tile(beside.quantiles(agents), len(tracks))
        offsets = sizes[:, None] * rng.normal(size=(len(owner), tracks.dim))
        share = (np.arange(reports) + rng.random((len(owner), reports))) / reports
        places = along(tracks, np.repeat(owner, reports), share.ravel()) + np.repeat(offsets, reports, axis=0)
        named = np.asarray(reporter(places, rng), dtype=np.int64)
        if named.shape != (len(places),) or named.min() < 0 or named.max() >= classes:
            raise ValueError(f"the reporter must name a class, 0 to {classes - 1}, for each of {len(places)} positions")
        heard = np.zeros((len(owner), classes))
        np.add.at(heard, (np.repeat(np.arange(len(owner)), reports), named), 1.0)
        chance = 0.5 * heard.sum(axis=0) / heard.sum() + 0.5 / classes
        counts = heard.reshape(len(tracks), agents, classes).sum(axis=1) + PRIOR * chance
        shares = counts / counts.sum(axis=1, keepdims=True)
        others = counts[owner] - heard
        own = (heard * np.log(others / others.sum(axis=1, keepdims=True))).sum(axis=1)
        logs = heard @ np.log(shares).T
        logs[np.arange(len(owner)), owner] = own
        powers = np.linspace(0.0, 1.0, 41)
        scores = [np.mean(p * own - logsumexp(p * logs, axis=1)) for p in powers]
        return cls(shares, chance, float(powers[np.argmax(scores)]))

    def probability(self, class_: int, tracks: Ints) -> tuple[Floats, float]:
        """Of a report of a class about agents of ``tracks`` (n,), ``(n,)``; and of one about nobody."""
        return self.shares[tracks, class_], float(self.chance[class_])


class Reliability(NamedTuple):
    """A distribution of the share of reports that are genuine, on the nodes of a Gauss-Jacobi quadrature.

    After n reports the posterior is the prior times a polynomial of degree n in the share, so that its integrals over G
    nodes are exact for n up to 2 G - 2 (the mean) or 2 G - 1 (the probability of the reports).

    Attributes:
        nodes: ``(G,)`` shares. log_weights: ``(G,)``.
    """

    nodes: Floats
    log_weights: Floats

    @classmethod
    def beta(cls, genuine: float, wrong: float) -> Reliability:
        """The beta distribution, as if so many genuine and wrong reports had been seen.

        Raises:
            ValueError: a number that is not positive.
        """
        if not (0.0 < genuine < math.inf and 0.0 < wrong < math.inf):
            raise ValueError(f"reliability must be two positive numbers, got {genuine} and {wrong}")
        x, w = roots_jacobi(NODES, wrong - 1.0, genuine - 1.0)
        return cls((x + 1.0) / 2.0, np.log(w / w.sum()))

    @classmethod
    def certain(cls) -> Reliability:
        """Every report is genuine."""
        return cls(np.ones(1), np.zeros(1))
