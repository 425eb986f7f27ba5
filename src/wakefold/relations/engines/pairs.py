"""Which pairs are looked at, and how they move and switch: what the engines of the relational filter share."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats, Ints
from wakefold.relations.activities import begin
from wakefold.relations.engines.objects import GONE, Objects, Settings
from wakefold.relations.kernels import histories, turnover
from wakefold.relations.kernels.histories import WIDTH
from wakefold.relations.kernels.looks import Looks
from wakefold.relations.kernels.objects import difference
from wakefold.relations.kernels.pairs import FLOOR
from wakefold.relations.kernels.predicates import truth
from wakefold.relations.model import ConstantVelocity, PairEvidence, Relation, RelationalModel
from wakefold.relations.motion import row
from wakefold.relations.pairs import GaussianPairs, Pairs, ParticlePairs
from wakefold.relations.predicates import Predicate

Kind = TypeVar("Kind", bound=Pairs)

HYSTERESIS = 1.25  # a pair is let go at this many gates


def staying(objects: Objects, forget: float) -> tuple[NDArray[np.bool_], Ints]:
    """Which objects are kept: they may exist and were seen ``forget`` seconds ago at most; new place of each, or -1."""
    stays = (objects.existence >= GONE) & (objects.unseen <= forget)
    return stays, np.where(stays, np.cumsum(stays) - 1, -1)


def motions(model: RelationalModel, kinds: Ints, dt: float) -> Floats:
    """``(n, 7)`` motion of each object on its own."""
    q = diffusions(model)
    return np.array([row(0.0, 0.0, x * x, dt) for x in q])[kinds]


def diffusions(model: RelationalModel) -> list[float]:
    """q of each kind; 0 where the motion is a sampler."""
    return [m.q if isinstance(m, ConstantVelocity) else 0.0 for m in model.objects.values()]


def relative_motions(model: RelationalModel, relation: Relation, dt: float) -> Floats:
    """``(2, 7)`` motion of the difference of two objects, unrelated and related."""
    q = [model.objects[kind] for kind in relation.pair]
    apart = sum(m.q**2 for m in q if isinstance(m, ConstantVelocity))
    alone = row(0.0, 0.0, apart, dt)
    how = relation.couples
    return np.array([alone, alone if how is None else row(how.k, how.pull, how.noise**2, dt)])


def settled_variance(relation: Relation) -> float | None:
    """Variance per axis of the difference in velocity of two who have long been related; None: there is no law."""
    how = relation.couples
    return None if how is None or how.k <= 0.0 else how.noise**2 / (2.0 * how.k)


def switches(relation: Relation, dt: float) -> Floats:
    """``(3, 2)`` chances of switching on and off within ``dt`` where the predicate holds, where not, where unknown.

    Where the truth of the predicate is itself uncertain the expected chance is between the first two.
    """
    assert relation.rate_break is not None
    assert relation.rate_hidden is not None
    return _switches(relation.rate_on, relation.rate_off, relation.rate_break, relation.rate_hidden, dt).copy()


@lru_cache(maxsize=4096)
def _switches(on: float, off: float, broken: float, hidden: float, dt: float) -> Floats:
    rates = np.array([[on, off], [0.0, off + broken], [0.0, hidden]])
    total = rates.sum(axis=1, keepdims=True)
    change = np.array([[-math.expm1(-x * dt)] for x in total[:, 0].tolist()])  # numpy's differs between processors
    return np.divide(rates * change, total, out=np.zeros((3, 2)), where=total > 0.0)


def program(relation: Relation) -> tuple[Ints, Floats]:
    """The predicate of a relation as kernels read it; empty where it always holds."""
    return _program(relation.on_when)


@lru_cache(maxsize=256)
def _program(predicate: Predicate | None) -> tuple[Ints, Floats]:
    if predicate is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return predicate.arrays()


def looks(evidence: PairEvidence | None, looked: Floats, dt: float) -> Looks:
    """What related pairs look like as kernels read it, of pairs seen for ``looked (P,)`` seconds before."""
    e = evidence
    if e is None:
        none = np.zeros(0)
        return Looks(none, none, none, np.zeros((0, 0, 0)), none)
    return Looks(e.distance, e.relative_speed, e.speed, e.log_ratio, e.share(looked, dt))


def candidates(positions: Floats, gate: float) -> Ints:
    """``(P, 2)`` pairs of objects within the gate, the first the smaller place."""
    if len(positions) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    x, y = positions.T
    wide = max(gate * (1.0 + 1e-9), float(np.abs(y).max()) * 1e-15)  # so that strips are counted exactly
    strip = np.floor(y / wide)
    order = np.lexsort((x, strip))
    return turnover.within(positions[order], strip[order], order, gate)


def of_relation(near: Ints, relation: Relation, model: RelationalModel, kinds: Ints) -> Ints:
    """The pairs a relation is about as first * n + second, rising."""
    ordered = near if relation.symmetric else np.concatenate([near, near[:, ::-1]])
    if len(model.objects) > 1:
        a, b = (model.kinds.index(kind) for kind in relation.pair)
        ordered = ordered[(kinds[ordered[:, 0]] == a) & (kinds[ordered[:, 1]] == b)]
    return np.sort(ordered[:, 0] * len(kinds) + ordered[:, 1])


def refresh(
    pairs: Kind, relation: Relation, s: Settings, objects: Objects, place: Ints, near: Ints
) -> tuple[Kind, NDArray[np.bool_]]:
    """Pairs let go and taken up; the new ones have their prior, and are related in no particle yet.

    Args:
        place: ``(n_before,)`` new place of each object, -1 for one let go.
        near: ``(P, 2)`` pairs within the gate now.

    Returns:
        The pairs in order, and which of them are new.
    """
    wanted = of_relation(near, relation, s.model, objects.kinds)
    reach = HYSTERESIS * s.gate
    first, second, source = turnover.merge(
        pairs.first, pairs.second, place, objects.mean, objects.unseen > 0, reach, wanted
    )
    is_new = source < 0
    if not is_new.any() and len(source) == len(pairs.p):
        return replace(pairs, first=first, second=second), is_new
    p, states = begun(first[is_new], second[is_new], relation, objects)

    def merge(old: Floats, added: Floats) -> Floats:
        out = np.empty((len(source), math.prod(old.shape[1:])))
        turnover.gather(old.reshape(-1, out.shape[1]), added.reshape(-1, out.shape[1]), source, out)
        return out.reshape(-1, *old.shape[1:])

    stages = tuple(merge(x, begin(p)) for x in pairs.stages)
    merged = replace(
        pairs, first=first, second=second, p=merge(pairs.p, p), looked=merge(pairs.looked, np.zeros(len(p))),
        stages=stages, **_told_apart(pairs, states, source),
    )  # fmt: skip
    return merged, is_new


def _told_apart(pairs: Pairs, new: Floats, source: Ints) -> dict[str, NDArray]:
    """What only one kind of pairs has, of those at ``source`` (-1: the next of the ``new`` states)."""
    if isinstance(pairs, GaussianPairs):
        counts, states = np.empty((len(source), 2), dtype=np.int64), np.empty((len(pairs.states) + len(new), WIDTH))
        one = np.ones((len(new) // 2, 2), dtype=np.int64)
        many = histories.gather(pairs.states, pairs.counts, new, one, source, states, counts)
        return {"counts": counts, "states": states[:many]}
    assert isinstance(pairs, ParticlePairs)
    bits = np.zeros((len(pairs.bits), len(source)), dtype=bool)
    bits[:, source >= 0] = pairs.bits[:, source[source >= 0]]
    return {"bits": bits}


def begun(first: Ints, second: Ints, relation: Relation, objects: Objects) -> tuple[Floats, Floats]:
    """Of new pairs: probability ``(P,)``, which is ``prior`` if the predicate holds, and the two Gaussians of each.

    The velocities of two that start related differ as those of long related ones do.
    """
    count, d = len(first), objects.mean.shape[2]
    mean, cov = np.zeros((count, 2, d)), np.zeros((count, 3))
    difference(first, second, objects.mean, objects.cov, mean, cov)
    p = np.full(count, relation.prior)
    if relation.prior > 0.0:
        p *= holds(relation, first, second, mean, cov, objects)
    p = np.clip(p, FLOOR, 1.0 - FLOOR)
    states = np.empty((count, 2, WIDTH))
    states[:, :, :4], states[:, :, 4:7] = mean.reshape(count, 1, 4), cov[:, None]
    states[:, 0, 7], states[:, 1, 7] = 1.0 - p, p
    settled = settled_variance(relation)
    if settled is not None:  # as if the difference had been measured: 0 m/s
        total = cov[:, 2] + settled
        pull = cov[:, 1:3] / total[:, None]  # of position and velocity
        states[:, 1, :4] -= (pull[:, :, None] * mean[:, 1:2]).reshape(count, 4)
        states[:, 1, 4:7] -= np.column_stack([pull[:, 0] * cov[:, 1], pull[:, 0] * cov[:, 2], pull[:, 1] * cov[:, 2]])
    return p, states.reshape(-1, WIDTH)


def holds(relation: Relation, first: Ints, second: Ints, mean: Floats, cov: Floats, objects: Objects) -> Floats:
    """Probability of a relation's predicate for pairs with relative states ``mean (P, 2, d)``, ``cov (P, 3)``."""
    out, known = np.empty(len(first)), objects.unseen <= relation.seen_within
    truth(program(relation), (first, second), (mean, cov), (objects.mean, objects.cov), known, out)
    return out
