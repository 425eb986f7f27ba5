"""What objects are, how they move and what they can be to each other: the model of the relational particle filter.

Manfredotti, Fleet, Hamilton and Zilles, "Relational Particle Filtering" (2011). Objects move given the relations of
before; relations change given the relations of before and the objects of now (Eq. 1); sensors see objects only (Eq. 2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wakefold.base.types import Floats
from wakefold.relations.predicates import Predicate, ahead, closing, near, number, same_velocity, seen, slow

__all__ = [  # noqa: RUF022 (by subject)
    "near",
    "same_velocity",
    "slow",
    "ahead",
    "closing",
    "seen",
    "Predicate",
    "couple_velocity",
    "follow_velocity",
    "Coupling",
    "PairEvidence",
    "Relation",
    "Activity",
    "ConstantVelocity",
    "Sampler",
    "RelationalModel",
]


def _check(ok: bool, message: str) -> None:
    if not ok:
        raise ValueError(message)


@dataclass(frozen=True)
class ConstantVelocity:
    """Motion with nearly constant velocity: drift dx = v dt, diffusion dv = q dW per axis.

    Args:
        q: diffusion of the velocity, m/s per square root of a second. After t seconds unseen the position has spread by
            q t^1.5 / sqrt(3).
        speed: standard deviation of the velocity of a new object per axis, m/s.
    """

    q: float
    speed: float = 1.5

    def __post_init__(self) -> None:
        _check(
            0.0 < number("ConstantVelocity: q", self.q) < math.inf,
            f"ConstantVelocity: q must be a positive number, got {self.q}",
        )
        _check(
            0.0 < number("speed", self.speed) < math.inf,
            f"ConstantVelocity: speed must be a positive number, got {self.speed}",
        )


@dataclass(frozen=True)
class Sampler:
    """Motion known by its draws alone; for the engine "bootstrap".

    Args:
        move: ``move(position, velocity, dt, rng) -> position, velocity``, all ``(N, d)``; metres, m/s, seconds.
            Couplings act on the result: they draw the velocities of related objects together.
        speed: as for ``ConstantVelocity``.
    """

    move: Callable[[Floats, Floats, float, np.random.Generator], tuple[Floats, Floats]]
    speed: float = 1.5

    def __post_init__(self) -> None:
        _check(callable(self.move), "Sampler: move must be a function (position, velocity, dt, rng)")
        _check(
            0.0 < number("speed", self.speed) < math.inf, f"Sampler: speed must be a positive number, got {self.speed}"
        )


@dataclass(frozen=True)
class Coupling:
    """How a relation acts on motion; made by ``couple_velocity`` and ``follow_velocity``.

    Attributes:
        k: rate at which the difference of the velocities decays, 1/s.
        noise: diffusion of that difference, m/s per square root of a second.
        pull: how strongly distance draws them together, 1/s².
        mutual: both give way (couple), or the first alone (follow).
    """

    k: float
    noise: float
    pull: float
    mutual: bool

    def __post_init__(self) -> None:
        _check(0.0 <= self.k < math.inf, f"coupling: k must be a number >= 0, got {self.k}")
        _check(0.0 <= self.pull < math.inf, f"coupling: pull must be a number >= 0, got {self.pull}")
        _check(0.0 < self.noise < math.inf, f"coupling: noise must be a positive number, got {self.noise}")


def couple_velocity(k: float, noise: float, pull: float = 0.0) -> Coupling:
    """Related objects keep to one velocity: their difference w obeys dw = -(k w + pull u) dt + noise dW.

    With ``pull`` they also keep together: u is their difference in position, and in the long run each coordinate of it
    has standard deviation noise / sqrt(2 k pull). The centre of a group moves as the mean of independent members would.

    Args:
        k: 1/s.
        noise: m/s per square root of a second.
        pull: 1/s².
    """
    return _coupling("couple_velocity", k, noise, pull, True)


def follow_velocity(k: float, noise: float, pull: float = 0.0) -> Coupling:
    """The first takes on the velocity of the second, which moves as it likes; units as in ``couple_velocity``."""
    return _coupling("follow_velocity", k, noise, pull, False)


def _coupling(name: str, k: float, noise: float, pull: float, mutual: bool) -> Coupling:
    return Coupling(number(f"{name}: k", k), number(f"{name}: noise", noise), number(f"{name}: pull", pull), mutual)


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """What related pairs look like: log-density ratio of pair features, related over unrelated, in nats per second.

    A factor of the motion model (an interaction potential, as in Khan, Balch and Dellaert, PAMI 2005): positions are
    likelier for a related pair where related pairs are found. Frames close in time tell the same thing twice, hence
    nats per *second*. Looks at one pair repeat each other for longer than that: with ``fade`` the t seconds for which
    both have been seen count as t^(1 - fade), so each second tells less than the one before. Features beyond the last
    edge use the last bin.

    Attributes:
        distance: ``(D + 1,)`` rising edges, metres.
        relative_speed: ``(S + 1,)`` rising edges, m/s.
        speed: ``(V + 1,)`` rising edges of the mean of the two speeds, m/s.
        log_ratio: ``(D, S, V)``, finite; with ``fade`` nats for the first second.
        fade: how much later looks repeat earlier ones, from 0 (not at all) to below 1.
    """

    distance: Floats
    relative_speed: Floats
    speed: Floats
    log_ratio: Floats
    fade: float

    def __init__(
        self,
        distance: ArrayLike,
        relative_speed: ArrayLike,
        speed: ArrayLike,
        log_ratio: ArrayLike,
        fade: float = 0.0,
    ) -> None:
        for name, values in (("distance", distance), ("relative_speed", relative_speed), ("speed", speed)):
            edges = np.array(values, dtype=np.float64)
            ok = edges.ndim == 1 and len(edges) >= 2 and bool(np.isfinite(edges).all() and (np.diff(edges) > 0).all())
            _check(ok, f"PairEvidence: {name} must be rising finite edges of at least one bin")
            object.__setattr__(self, name, edges)
        table = np.ascontiguousarray(log_ratio, dtype=np.float64)
        shape = (len(self.distance) - 1, len(self.relative_speed) - 1, len(self.speed) - 1)
        _check(table.shape == shape, f"PairEvidence: log_ratio must have shape {shape}, got {table.shape}")
        _check(bool(np.isfinite(table).all()), "PairEvidence: log_ratio must be finite")
        object.__setattr__(self, "log_ratio", table)
        object.__setattr__(self, "fade", number("PairEvidence: fade", fade))
        _check(0.0 <= self.fade < 1.0, f"PairEvidence: fade must be at least 0 and below 1, got {fade}")

    def share(self, looked: Floats, dt: float) -> Floats:
        """What the next ``dt`` seconds count as, in first seconds, of pairs seen for ``looked (P,)`` seconds before."""
        if self.fade == 0.0:
            return np.full(len(looked), dt)
        from wakefold.base.small import power

        return power(looked + dt, 1.0 - self.fade) - power(looked, 1.0 - self.fade)


@dataclass(frozen=True)
class Relation:
    """A proposition about two objects that may come to hold and cease to.

    While both are seen, it comes to hold at ``rate_on`` times the probability of ``on_when``, and ceases at
    ``rate_off`` plus ``rate_break`` times the probability that ``on_when`` does not hold. While one of them is hidden
    nothing is known about ``on_when``: the relation does not come to hold, and ceases at ``rate_hidden``. Rates are per
    second.

    Args:
        name: of the relation.
        pair: kinds of the two objects, of ``RelationalModel.objects``.
        on_when: predicate about the two; None: it always holds.
        rate_on, rate_off: see above.
        rate_break: see above; ``rate_on`` by default.
        rate_hidden: see above; ``rate_off`` by default. A relation that may break unseen has a larger one.
        couples: how it acts on motion; None: not at all.
        prior: probability that two objects that come within the gate (or of which one is new) are related already, if
            ``on_when`` holds.
        symmetric: whether it holds of (a, b) whenever of (b, a). An asymmetric one is kept for each order.
        seen_within: objects seen at most this many seconds ago count as seen.
        evidence: what related pairs look like.
    """

    name: str
    pair: tuple[str, str]
    on_when: Predicate | None = None
    rate_on: float = 0.1
    rate_off: float = 0.01
    rate_break: float | None = None
    rate_hidden: float | None = None
    couples: Coupling | None = None
    prior: float = 0.0
    symmetric: bool | None = None
    seen_within: float = 0.0
    evidence: PairEvidence | None = None

    def __post_init__(self) -> None:
        where = f"relation {self.name!r}"
        _check(isinstance(self.name, str) and bool(self.name), "Relation: name must be a text")
        pair = not isinstance(self.pair, str) and len(self.pair) == 2
        _check(pair, f"{where}: pair must be two kinds, got {self.pair!r}")
        for part, kind in (("on_when", Predicate), ("couples", Coupling), ("evidence", PairEvidence)):
            value = getattr(self, part)
            if value is not None and not isinstance(value, kind):
                raise TypeError(f"{where}: {part} must be a {kind.__name__}, got {value!r}")
        for name, default in (("rate_break", self.rate_on), ("rate_hidden", self.rate_off)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
        for name in ("rate_on", "rate_off", "rate_break", "rate_hidden", "seen_within"):
            value = number(f"{where}: {name}", getattr(self, name))
            _check(0.0 <= value < math.inf, f"{where}: {name} must be a number >= 0, got {value}")
        _check(
            0.0 <= number(f"{where}: prior", self.prior) <= 1.0,
            f"{where}: prior must be a probability, got {self.prior}",
        )
        same = self.pair[0] == self.pair[1]
        if self.symmetric is None:
            object.__setattr__(self, "symmetric", same and (self.couples is None or self.couples.mutual))
        _check(not self.symmetric or same, f"{where}: a symmetric relation needs two objects of one kind")
        follows = self.couples is not None and not self.couples.mutual
        _check(not (self.symmetric and follows), f"{where}: follow_velocity needs symmetric=False")


@dataclass(frozen=True)
class Activity:
    """Something two objects do that a relation is part of: before it, during it (for a while), after it.

    Args:
        name: of the activity.
        chain: phases in their order; one of them is the name of a relation, at most one precedes and one follows.
        min_time: how long the relation must last, seconds, for the activity to have taken place.
    """

    name: str
    chain: Sequence[str]
    min_time: float = 0.0

    def __post_init__(self) -> None:
        where = f"activity {self.name!r}"
        _check(not isinstance(self.chain, str), f"{where}: chain must be a list of phases, got {self.chain!r}")
        object.__setattr__(self, "chain", tuple(self.chain))
        _check(
            0.0 <= number(f"{where}: min_time", self.min_time) < math.inf,
            f"activity {self.name!r}: min_time must be >= 0, got {self.min_time}",
        )


@dataclass(frozen=True)
class RelationalModel:
    """Kinds of objects, the relations they may have, and activities.

    Args:
        objects: motion of each kind.
        relations: of distinct names.
        activities: of distinct names.

    Raises:
        ValueError: a relation about an unknown kind, an activity without its relation, or a name that is there twice.
    """

    objects: Mapping[str, ConstantVelocity | Sampler]
    relations: Sequence[Relation] = ()
    activities: Sequence[Activity] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.objects, Mapping):
            raise TypeError(f"RelationalModel: objects must map names of kinds to motions, got {self.objects!r}")
        for name, kind in (("relations", Relation), ("activities", Activity)):
            value = getattr(self, name)
            if not isinstance(value, Sequence) or not all(isinstance(one, kind) for one in value):
                raise TypeError(f"RelationalModel: {name} must be a list of {kind.__name__}, got {value!r}")
        object.__setattr__(self, "objects", dict(self.objects))
        object.__setattr__(self, "relations", tuple(self.relations))
        object.__setattr__(self, "activities", tuple(self.activities))
        _check(bool(self.objects), "RelationalModel: objects must name at least one kind")
        for kind, motion in self.objects.items():
            if not isinstance(motion, (ConstantVelocity, Sampler)):
                raise TypeError(f"kind {kind!r}: motion must be ConstantVelocity or Sampler, got {motion!r}")
        for things in (self.relations, self.activities):
            names = [thing.name for thing in things]
            for name in names:
                _check(names.count(name) == 1, f"RelationalModel: {name!r} is there twice")
        for relation in self.relations:
            for kind in relation.pair:
                _check(
                    kind in self.objects, f"relation {relation.name!r} is about {kind!r}, which is no kind of object"
                )
        known = [r.name for r in self.relations]
        for activity in self.activities:
            inside = [i for i, phase in enumerate(activity.chain) if phase in known]
            where = f"activity {activity.name!r}: its chain {activity.chain}"
            _check(len(inside) == 1, f"{where} must hold the name of one relation")
            at = inside[0]
            _check(at <= 1 and len(activity.chain) - at <= 2, f"{where} has more than one phase before or after it")

    def activities_of(self, relation: Relation) -> list[Activity]:
        """The activities a relation is part of, in the order given."""
        return [a for a in self.activities if relation.name in a.chain]

    @property
    def kinds(self) -> list[str]:
        """Names of the kinds of objects, in the order given."""
        return list(self.objects)
