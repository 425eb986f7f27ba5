"""Who walks with whom: constants of the relation "together" learned from scenes with known groups.

The log-odds that two people are together add up what their spacing and the difference of their velocities say. Three
things are learned in every scene anew, from its unlabelled people: how far apart those who walk together keep (a
posterior about the training scenes' mean), how often strangers look alike (from ghosts: the same people at another
time) and who has friends in common.

Learned with ``online=True`` all that a pair tells is a sum over frames, and ``TogetherFit.relation`` makes a relation
of it that ``RelationalFilter`` can follow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wakefold.base import small
from wakefold.base.types import Bools, Floats
from wakefold.relations.kernels.looks import in_common
from wakefold.relations.learning.logistic import logistic, probability
from wakefold.relations.learning.walkers import (
    DIFFERENCE,
    SPACING,
    Looks,
    Together,
    Walkers,
    ghost_pairs,
    join,
    looks,
    pairs_of,
    running,
)
from wakefold.relations.model import PairEvidence, Relation

UNIT = 20.0  # frames; a pair seen for n frames counts as (n / UNIT) ** (1 - fade) such pairs
ROUNDS = 12  # of learning a scene's constants in turn
REPEATS = 3  # of fitting weights and shifts in turn
MOST_SHIFT = 6.0  # most that a scene shifts the log-odds
CELLS = 18, 12  # between the outermost knots of spacing and of the difference of velocities, in a relation's evidence


class Crowd(NamedTuple):
    """A scene as the fit sees it.

    Attributes:
        people: how many.
        pairs: those seen together long enough.
        looks: of these pairs.
        ghosts: looks of pairs of people and ghosts.
        rate: pairs of people for each pair with a ghost.
        dt: seconds between frames.
    """

    people: int
    pairs: Together
    looks: Looks
    ghosts: Looks
    rate: float
    dt: float


def crowd(walkers: Walkers, *, least: int = 5, ghosts: int = 60_000) -> Crowd:
    """What the fit reads of a scene.

    Args:
        walkers: the people.
        least: frames that a pair must be seen together.
        ghosts: about how many pairs with ghosts to look at, in one to ten rounds.
    """
    pairs = pairs_of(walkers, least)
    rounds = max(1, min(10, round(ghosts / max(len(pairs.first), 1))))
    unreal = join([looks(walkers, g) for g in ghost_pairs(walkers, rounds, least)])
    rate = len(pairs.first) / max(len(unreal.frames), 1)
    return Crowd(len(walkers.ids), pairs, looks(walkers, pairs), unreal, rate, walkers.dt)


class SceneConstants(NamedTuple):
    """What a scene has told of itself.

    Attributes:
        spacing: mean log spacing (metres) of people together, its posterior mean.
        spacing_sd: standard deviation of that posterior.
        shift: of all log-odds.
    """

    spacing: float
    spacing_sd: float
    shift: float


@dataclass(frozen=True, eq=False)
class TogetherFit:
    """Learned constants of "together"; made by ``fit``.

    Attributes:
        fade: how much frames of one pair repeat each other: 0 not at all, 1 entirely.
        trust: share of the shift that the ghosts ask for.
        weights: ``(20,)`` never strolled, spacing off the scene's squared, the same signed, the 16 hats of
            ``walkers.Looks.shape``, constant.
        friends: ``(4,)`` constant, own log-odds, friends in common, friends not in common.
        online: as ``fit`` was told; the first weight is 0 then.
        spacing, between, within: mean log spacing of people together over scenes, its standard deviation from scene
            to scene, and that from pair to pair inside a scene.
    """

    fade: float
    trust: float
    online: bool
    weights: Floats
    friends: Floats
    spacing: float
    between: float
    within: float

    def settle(self, scene: Crowd) -> SceneConstants:
        """The constants of a scene, from its people alone (no groups given).

        Spacing: mean of the pairs weighed by how probably they are together, with the training scenes as prior; a pair
        counts a fifth, as it is not known to be one. Shift: the number of strangers expected among the pairs taken as
        together equals that of ghosts that would be.
        """
        spacing, shift, sd = self.spacing, 0.0, self.between
        terms = _terms(scene.looks, self.fade), _terms(scene.ghosts, self.fade)
        designs = [_design(term, spacing, self.online) for term in terms]
        base = _base_rate(scene)
        for _ in range(ROUNDS):
            for design, term in zip(designs, terms, strict=True):
                design[:, 1:3] = np.column_stack(_judged(term, spacing, self.online))
            z, ghosts = (small.times(design, self.weights) + base for design in designs)
            shift = self.trust * _shift(z, ghosts, scene.rate)
            p = probability(z + shift)
            count = 0.2 * p.sum()
            precision = 1.0 / self.between**2 + count / self.within**2
            mean = float((p * scene.looks.log_spacing).sum() / max(p.sum(), 1e-9))
            spacing = (self.spacing / self.between**2 + count * mean / self.within**2) / precision
            sd = precision**-0.5
        return SceneConstants(float(spacing), float(sd), float(shift))

    def posterior(self, scene: Crowd, constants: SceneConstants) -> Floats:
        """``(K,)`` probability that each pair of the scene is together, given all it was seen to do."""
        z = self._told(_terms(scene.looks, self.fade), constants.spacing)
        return self._with_friends(z + _base_rate(scene) + constants.shift, scene.pairs, scene.people)

    def over_time(self, walkers: Walkers, scene: Crowd, constants: SceneConstants) -> Floats:
        """``(R,)`` probability of each pair given what was seen up to each frame, laid end to end as in ``walkers``.

        Friends in common are left out: they are known at the end only.
        """
        frames, told, log_spacing, strolled = running(walkers, scene.pairs, self._at_knots(constants.spacing))
        amount = small.power(frames / UNIT, 1.0 - self.fade)
        z = told * amount + self.weights[-1]
        if not self.online:
            columns = np.column_stack([~strolled, *_off(log_spacing - constants.spacing)])
            z += small.times(columns, self.weights[:3])
        return probability(z + _base_rate(scene) + constants.shift)

    def relation(
        self, scene: Crowd, constants: SceneConstants, *, name: str = "together", kind: str = "person"
    ) -> Relation:
        """What was learned, as a relation for a ``RelationalModel``: it holds of a pair or not, and does not change.

        The prior is the scene's base rate with its shift; the evidence is what spacing and the difference of the
        velocities tell, frame by frame and fading. Objects should move with the diffusion that ``walkers.follow`` had.

        Args:
            constants: what ``settle`` said of the scene.
            name, kind: of the relation, and of its objects.

        Raises:
            ValueError: learned without ``online=True``, or with ``fade=1``.
        """
        if not self.online:
            raise ValueError("relation needs constants learned by fit(..., online=True)")
        told = self._at_knots(constants.spacing)
        distance, near = _cells(SPACING, told[: len(SPACING)], CELLS[0])
        relative_speed, alike = _cells(DIFFERENCE, told[len(SPACING) :], CELLS[1])
        first = (UNIT * scene.dt) ** (self.fade - 1.0)  # UNIT frames count as one
        table = first * (near[:, None, None] + alike[None, :, None])
        evidence = PairEvidence(distance, relative_speed, [0.0, 1.0], table, fade=self.fade)
        prior = float(probability(np.array(self.weights[-1] + _base_rate(scene) + constants.shift)))
        return Relation(name, (kind, kind), rate_on=0.0, rate_off=0.0, prior=prior, evidence=evidence)

    def _told(self, terms: _Terms, spacing: float) -> Floats:
        """``(K,)`` log-odds without base rate and shift."""
        return small.times(_design(terms, spacing, self.online), self.weights)

    def _at_knots(self, spacing: float) -> Floats:
        """``(16,)`` what a look tells at each knot of spacing and of the difference of velocities."""
        told = self.weights[3:-1].copy()
        if self.online:
            told[: len(SPACING)] += small.times(np.column_stack(_off(SPACING - spacing)), self.weights[1:3])
        return told

    def _with_friends(self, z: Floats, pairs: Together, people: int) -> Floats:
        return probability(small.times(_friends(z, pairs, people), self.friends))


def fit(
    scenes: list[Crowd],
    together: list[Bools],
    *,
    fade: float = 0.5,
    ridge: float = 0.5,
    trust: float = 0.5,
    online: bool = False,
) -> TogetherFit:
    """Learn the constants from scenes whose groups are known.

    Penalised logistic regression; scenes weigh with the square root of their number of pairs together. The shifts of
    the training scenes are learned as in ``TogetherFit.settle``, in turn with the weights.

    Args:
        scenes: at least one.
        together: ``(K,)`` for each scene, whether each of its pairs is together.
        fade, trust: see ``TogetherFit``; between 0 and 1.
        ridge: penalty on squared weights.
        online: judge spacing frame by frame like the rest, and do not ask whether both have walked, so that all a pair
            tells adds up frame by frame; for ``TogetherFit.relation``.

    Raises:
        ValueError: a scene without a pair together, labels that do not fit, or a setting out of range.
    """
    return fits(scenes, together, fade=fade, ridge=ridge, trusts=[trust], online=online)[0]


def fits(
    scenes: list[Crowd],
    together: list[Bools],
    *,
    fade: float = 0.5,
    ridge: float = 0.5,
    trusts: Sequence[float],
    online: bool = False,
) -> list[TogetherFit]:
    """``fit`` for several values of ``trust``, which have the beginning in common."""
    if not scenes or len(scenes) != len(together):
        raise ValueError(f"fit needs labels for each scene, got {len(scenes)} scenes and {len(together)} of labels")
    for name, value in (("fade", fade), *(("trust", trust) for trust in trusts)):
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{name} must be between 0 and 1, got {value}")
    for number, (scene, y) in enumerate(zip(scenes, together, strict=True)):
        if len(y) != len(scene.looks.frames):
            raise ValueError(f"scene {number} has {len(scene.looks.frames)} pairs but {len(y)} labels")
        if not y.any() or y.all():
            raise ValueError(f"scene {number} needs pairs together and pairs that are not")
    means = [float(s.looks.log_spacing[y].mean()) for s, y in zip(scenes, together, strict=True)]
    within = float(np.mean([s.looks.log_spacing[y].std() for s, y in zip(scenes, together, strict=True)]))
    between = max(0.15, float(np.std(means, ddof=1)) if len(means) > 1 else 0.3)
    designs = [_design(_terms(s.looks, fade), m, online) for s, m in zip(scenes, means, strict=True)]
    unreal = [_design(_terms(s.ghosts, fade), m, online) for s, m in zip(scenes, means, strict=True)]
    importance = [np.full(len(y), 10.0 / np.sqrt(y.sum())) for y in together]
    labels, heavy = np.concatenate(together), np.concatenate(importance)
    design = np.concatenate(designs)

    def weigh(shifts: Sequence[float]) -> Floats:
        offset = [np.full(len(x), _base_rate(s) + d) for x, s, d in zip(designs, scenes, shifts, strict=True)]
        return logistic(design, labels, heavy, np.concatenate(offset), ridge)

    def asked(weights: Floats) -> list[float]:
        return [
            _shift(small.times(x, weights) + _base_rate(s), small.times(g, weights) + _base_rate(s), s.rate)
            for x, g, s in zip(designs, unreal, scenes, strict=True)
        ]

    first = asked(weigh([0.0] * len(scenes)))
    out = []
    for trust in trusts:
        shifts = [trust * shift for shift in first]
        weights = weigh(shifts)
        for _ in range(REPEATS - 1):
            shifts = [trust * shift for shift in asked(weights)]
            weights = weigh(shifts)
        known = [
            _friends(small.times(x, weights) + _base_rate(s) + d, s.pairs, s.people)
            for x, s, d in zip(designs, scenes, shifts, strict=True)
        ]
        friends = logistic(np.concatenate(known)[:, ::-1], labels, heavy, np.zeros(len(labels)), 0.01)[::-1]
        friends = np.ascontiguousarray(friends)
        centre, inside = float(np.mean(means)), max(within, 0.05)
        out.append(TogetherFit(fade, trust, online, weights, friends, centre, between, inside))
    return out


class _Terms(NamedTuple):
    amount: Floats
    shape: Floats
    log_spacing: Floats
    strolled: Bools


def _terms(seen: Looks, fade: float) -> _Terms:
    amount = small.power(seen.frames / UNIT, 1.0 - fade)
    return _Terms(amount, seen.shape * amount[:, None], seen.log_spacing, seen.strolled)


def _design(terms: _Terms, spacing: float, online: bool) -> Floats:
    """Columns of the regression; the constant last."""
    ones = np.ones(len(terms.amount))
    never = 0.0 * ones if online else ~terms.strolled
    return np.column_stack([never, *_judged(terms, spacing, online), *terms.shape.T, ones]).astype(np.float64)


def _judged(terms: _Terms, spacing: float, online: bool) -> list[Floats]:
    """The two columns that say how the spacing is off the scene's."""
    if not online:
        return list(_off(terms.log_spacing - spacing))
    near = np.ascontiguousarray(terms.shape[:, : len(SPACING)])  # hat functions: straight lines between the knots
    return [small.times(near, x) for x in _off(SPACING - spacing)]


def _off(off: Floats) -> tuple[Floats, Floats]:
    """How a log spacing off the scene's mean is judged: squared and signed."""
    return -np.minimum(off * off, 4.0), np.clip(off, -1.5, 1.5)


def _cells(knots: Floats, values: Floats, many: int) -> tuple[Floats, Floats]:
    """A function of a logarithm, straight between knots, as a table: edges and the value in the middle of each cell.

    The first cell and the last are what lies outside the knots.
    """
    inner = np.linspace(knots[0], knots[-1], many + 1)
    middle = np.concatenate([knots[:1], 0.5 * (inner[1:] + inner[:-1]), knots[-1:]])
    return np.concatenate([[0.0], small.exp(inner), 2.0 * small.exp(knots[-1:])]), np.interp(middle, knots, values)


def _base_rate(scene: Crowd) -> float:
    """Log-odds before anything is seen: so many partners for each person, whoever else is there."""
    return math.log(scene.people / max(len(scene.pairs.first), 1))


def _shift(z: Floats, ghosts: Floats, rate: float) -> float:
    """The shift of the log-odds at which as many strangers are taken as together as ghosts would be.

    Solves sum p (1 - p) over pairs = rate times sum p over ghosts, the two sides of that balance.
    """
    from scipy.optimize import root_scalar

    def over(shift: float) -> float:
        p = probability(z + shift)
        return float((p * (1.0 - p)).sum() - rate * probability(ghosts + shift).sum())

    if over(-MOST_SHIFT) <= 0.0:
        return -MOST_SHIFT
    if over(MOST_SHIFT) >= 0.0:
        return MOST_SHIFT
    return float(root_scalar(over, bracket=(-MOST_SHIFT, MOST_SHIFT), method="brentq").root)


def _friends(z: Floats, pairs: Together, people: int) -> Floats:
    """Columns: constant, own log-odds, expected number of friends in common, and of friends of one alone."""
    p = np.zeros((people, people))
    p[pairs.first, pairs.second] = p[pairs.second, pairs.first] = probability(z)
    shared = in_common(p, pairs.first, pairs.second)
    degree = p.sum(axis=1)
    alone = degree[pairs.first] + degree[pairs.second] - 2.0 * probability(z) - 2.0 * shared
    return np.column_stack([np.ones(len(z)), z, shared, np.maximum(alone, 0.0)])
