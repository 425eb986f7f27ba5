"""What reports of coarse evidence are worth: how often they are wrong, from simulation, and how many are genuine."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from wakefold.base import small
from wakefold.base.types import Floats, Ints
from wakefold.evidence.kernels import shares_near
from wakefold.model.deviation import Deviation
from wakefold.tracks.shaping import along

if TYPE_CHECKING:
    from wakefold.model.model import Model

Reporter = Callable[[Floats, np.random.Generator], Ints]
"""Classes ``(n,)`` that somebody would report of agents at positions ``(n, d)``, with the reporter's own errors."""

NODES = 16  # of the quadrature: exact up to 31 reports, close beyond
PRIOR = 2.0  # reports by chance that are taken to have been made at every place before the simulation
WIDTHS = (0.25, 0.5, 1.0, 2.0)  # of the median scale of the tracks


@dataclass(frozen=True, eq=False)
class Confusion:
    """Which classes are reported of agents at some place: reports about simulated agents, smoothed.

    The reporter sees where an agent is and not where it is bound, so where the agent is known, as after a fix, a report
    hardly tells the tracks apart; where it is not, the report does, as every track has the agent elsewhere.

    Attributes:
        positions: ``(S, d)`` of the simulated agents. named: ``(S,)`` the class reported of each.
        chance: ``(C,)`` of reports that have nothing to do with the agent.
        width: of the Gaussian kernel that reports are smoothed by, metres.
    """

    positions: Floats
    named: Ints
    chance: Floats
    width: float

    @classmethod
    def learn(
        cls,
        model: Model,
        reporter: Reporter,
        *,
        deviation: Deviation | None = None,
        reports: int = 1000,
        seed: int = 0,
    ) -> Confusion:
        """Let the reporter name the classes of simulated agents, who stray from the tracks as agents do.

        The width is the one, of a quarter to twice the median scale of the tracks, under which every report is most
        probable given all the others.

        Args:
            reporter: see ``Reporter``; asked once, about all positions.
            deviation: by default what the tracks show of one another.
            reports: shared out evenly over the tracks, each about an agent somewhere along its track.

        Raises:
            ValueError: the reporter does not name a class of the model for every position.
        """
        beside = Deviation.learn(model) if deviation is None else deviation
        tracks, classes = model.tracks, len(model.filtration.birth)
        rng = np.random.default_rng(seed)
        each = len(tracks) / reports
        at = each * np.arange(reports)  # track and, behind the point, how far along it
        owner, share = at.astype(np.int64), (at + each * rng.random(reports)) % 1.0
        sizes = beside.scales[owner] * np.resize(beside.quantiles(4), reports)
        places = along(tracks, owner, share) + sizes[:, None] * rng.normal(size=(reports, tracks.dim))
        named = np.asarray(reporter(places, rng), dtype=np.int64)
        if named.shape != (len(places),) or named.min() < 0 or named.max() >= classes:
            raise ValueError(f"the reporter must name a class, 0 to {classes - 1}, for each of {len(places)} positions")
        chance = 0.5 * np.bincount(named, minlength=classes) / reports + 0.5 / classes
        apart2, alike = cdist(places, places, "sqeuclidean"), named[:, None] == named
        np.fill_diagonal(apart2, np.inf)
        widths = np.array(WIDTHS) * float(np.median(beside.scales))
        scores = []
        for width in widths:
            near = small.exp(-0.5 * apart2 / width**2)
            right = (near * alike).sum(axis=1) + PRIOR * chance[named]
            scores.append(small.log(right / (near.sum(axis=1) + PRIOR)).mean())
        return cls(places, named, chance, float(widths[np.argmax(scores)]))

    def probability(self, class_: int, points: Floats, covs: Floats) -> tuple[Floats, float]:
        """Of a report of a class about agents at ``points (n, d)``, give or take ``covs (n, d, d)``, ``(n,)``; and of
        one about nobody.
        """
        chance, out, dims = float(self.chance[class_]), np.empty(len(points)), (0,) * points.shape[1]
        shares_near(points, covs, self.width**2, self.positions, self.named == class_, PRIOR, chance, out, dims)
        return out, chance


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
        x, w = gauss_jacobi(NODES, wrong - 1.0, genuine - 1.0)
        return cls((x + 1.0) / 2.0, small.log(w))

    @classmethod
    def certain(cls) -> Reliability:
        """Every report is genuine."""
        return cls(np.ones(1), np.zeros(1))


def gauss_jacobi(count: int, a: float, b: float) -> tuple[Floats, Floats]:
    """Nodes ``(count,)``, rising, and weights of sum 1 of the quadrature with weight (1 - x)^a (1 + x)^b on [-1, 1].

    The nodes are the eigenvalues of the matrix of the recurrence of the Jacobi polynomials (Golub and Welsch 1969),
    found by bisection: an eigenvalue solver of LAPACK differs between processors.
    """
    n = np.arange(1, count)
    s = 2.0 * n + a + b
    diagonal = np.append((b - a) / (a + b + 2.0), (b - a) * (b + a) / (s * (s + 2.0)))
    with np.errstate(invalid="ignore", divide="ignore"):
        squares = 4.0 * n * (n + a) * (n + b) * (n + a + b) / (s * s * (s + 1.0) * (s - 1.0))
    squares[0] = 4.0 * (1.0 + a) * (1.0 + b) / ((a + b + 2.0) ** 2 * (a + b + 3.0))  # 0 / 0 where a + b is -1
    low, high = -np.ones(count), np.ones(count)
    for _ in range(60):
        x = 0.5 * (low + high)
        pivot = diagonal[0] - x
        below = (pivot < 0.0).astype(np.int64)  # how many eigenvalues are below x (Sturm)
        for k in range(1, count):
            pivot = diagonal[k] - x - squares[k - 1] / np.where(np.abs(pivot) < 1e-300, 1e-300, pivot)
            below += pivot < 0.0
        high = np.where(below > np.arange(count), x, high)
        low = np.where(below > np.arange(count), low, x)
    x = 0.5 * (low + high)
    before, now, total = np.zeros(count), np.ones(count), np.ones(count)  # orthonormal polynomials but for a factor
    for k in range(count - 1):
        less = np.sqrt(squares[k - 1]) * before if k else 0.0
        before, now = now, ((x - diagonal[k]) * now - less) / np.sqrt(squares[k])
        total += now * now
    return x, (1.0 / total) / (1.0 / total).sum()
