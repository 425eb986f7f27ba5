"""What the relational filter believes about a scene: objects, their relations, groups and activities."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from wakefold.base import store
from wakefold.base.types import Floats, Ints
from wakefold.relations.activities import phases, taken_place
from wakefold.relations.model import RelationalModel
from wakefold.relations.pairs import GaussianPairs, Pairs, ParticlePairs

KIND = "scene"
Kind = TypeVar("Kind", bound=Pairs)


class ObjectTable(NamedTuple):
    """Objects that are likely to exist, in the order in which they were first seen.

    Attributes:
        ids: ``(n,)`` names given by the detections, or whole numbers given by the filter.
        kinds: ``(n,)`` texts.
        position, velocity: ``(n, d)``, metres and m/s.
        sd: ``(n,)`` standard deviation of the position per axis, metres.
        existence: ``(n,)`` probability that the object is (still) there.
        unseen: ``(n,)`` seconds since it was last detected.
    """

    ids: NDArray
    kinds: NDArray
    position: Floats
    velocity: Floats
    sd: Floats
    existence: Floats
    unseen: Floats


class RelationTable(NamedTuple):
    """Relations of pairs, the likeliest first.

    Attributes:
        relation: ``(K,)`` names.
        first, second: ``(K,)`` ids of objects; an asymmetric relation holds of them in this order.
        probability: ``(K,)``.
    """

    relation: NDArray
    first: NDArray
    second: NDArray
    probability: Floats


class ActivityTable(NamedTuple):
    """Activities of pairs, the likeliest first.

    Attributes:
        activity: ``(K,)`` names.
        first, second: ``(K,)`` ids of objects.
        probability: ``(K,)`` that the relation of the activity has lasted its least time.
        phase: ``(K,)`` the likeliest phase, a name of the chain; "" where the chain names none for it.
        phases: ``(K, 3)`` probabilities of before, during and after the relation.
    """

    activity: NDArray
    first: NDArray
    second: NDArray
    probability: Floats
    phase: NDArray
    phases: Floats


@dataclass(frozen=True, eq=False)
class Particles:
    """Joint hypotheses about all objects (engines "bootstrap" and "rbk").

    Attributes:
        mean: ``(M, 2, n, d)`` positions and velocities, or their conditional means.
        cov: ``(M, 2n, 2n)`` conditional covariance on each axis, positions before velocities; zero for sampled objects.
        log_weights: ``(M, n)``, for each object those of its block: sets of objects that may be related.
        block: ``(n,)`` which block an object belongs to.
    """

    mean: Floats
    cov: Floats
    log_weights: Floats
    block: Ints


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Generic[Kind]):
    """Belief about a scene, of one of two kinds. Immutable: ``RelationalFilter.step`` makes a new one.

    Attributes:
        model: what the objects are and what they can be to each other.
        ids: ``(n,)``; kinds: ``(n,)`` places in ``model.kinds``; serial: ``(n,)`` order of first detection.
        mean, cov: ``(n, 2, d)``, ``(n, 3)`` position and velocity of each object as believed, with the covariance
            (position, cross, velocity) averaged over the axes.
        existence, unseen: ``(n,)``.
        pairs: for each relation of the model.
        time: seconds.
        log_evidence: log marginal likelihood of all detections so far (approximate where relations are summed out).
        recoveries: how often every particle had no weight and the filter went on from the prediction.
        key, step, serials: random stream, number of steps, number of objects ever seen.
    """

    model: RelationalModel
    ids: NDArray
    kinds: Ints
    serial: Ints
    mean: Floats
    cov: Floats
    existence: Floats
    unseen: Floats
    pairs: tuple[Kind, ...]
    key: NDArray[np.uint64]
    step: int = 0
    serials: int = 0
    time: float = 0.0
    log_evidence: float = 0.0
    recoveries: int = 0

    def __len__(self) -> int:
        return len(self.ids)

    def tracks(self, at_least: float = 0.5) -> ObjectTable:
        """The objects whose probability of existing is ``at_least`` this."""
        rows = np.flatnonzero(self.existence >= at_least)
        kinds = np.array(self.model.kinds)[self.kinds[rows]]
        sd = np.sqrt(np.maximum(self.cov[rows, 0], 0.0))
        state = self.mean[rows, 0], self.mean[rows, 1], sd
        return ObjectTable(self.ids[rows], kinds, *state, self.existence[rows], self.unseen[rows])

    def relations(self, name: str | None = None, at_least: float = 0.0) -> RelationTable:
        """Pairs within the gate, and how probable each relation (or the one named) is.

        Raises:
            ValueError: no relation of that name.
        """
        names = [r.name for r in self.model.relations]
        wanted = [names[self._place(name)]] if name is not None else names
        parts = [(n, self.pairs[names.index(n)]) for n in wanted]
        p = np.concatenate([np.zeros(0), *(pairs.p for _, pairs in parts)])
        first = np.concatenate([np.zeros(0, np.int64), *(pairs.first for _, pairs in parts)])
        second = np.concatenate([np.zeros(0, np.int64), *(pairs.second for _, pairs in parts)])
        which = np.repeat(np.array(wanted, dtype=str), [len(pairs.p) for _, pairs in parts])
        order = np.argsort(-p, kind="stable")
        order = order[p[order] >= at_least]
        return RelationTable(which[order], self.ids[first[order]], self.ids[second[order]], p[order])

    def probability(self, name: str, first: int | str, second: int | str) -> float:
        """Probability that a relation holds of two objects; 0 where they are not within the gate.

        Raises:
            ValueError: no relation of that name.
        """
        place = self._place(name)
        pairs, at = self.pairs[place], {i: k for k, i in enumerate(self.ids.tolist())}
        if first not in at or second not in at:
            return 0.0
        a, b = at[first], at[second]
        found = (pairs.first == a) & (pairs.second == b)
        if self.model.relations[place].symmetric:
            found |= (pairs.first == b) & (pairs.second == a)
        return float(pairs.p[found].sum())

    def _place(self, name: str) -> int:
        names = [r.name for r in self.model.relations]
        if name not in names:
            raise ValueError(f"no relation {name!r}; the model has {', '.join(names) or 'none'}")
        return names.index(name)

    def groups(self, name: str | None = None, at_least: float = 0.5) -> list[list[int] | list[str]]:
        """Sets of two and more objects held together by probable relations, each in the order of ``ids``.

        Args:
            name: of a relation; by default any.
            at_least: probability from which on a relation ties two objects.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        wanted = self.pairs if name is None else (self.pairs[self._place(name)],)
        first = np.concatenate([np.zeros(0, np.int64), *(p.first[p.p >= at_least] for p in wanted)])
        second = np.concatenate([np.zeros(0, np.int64), *(p.second[p.p >= at_least] for p in wanted)])
        if not len(first):
            return []
        graph = coo_array((np.ones(len(first)), (first, second)), shape=(len(self), len(self)))
        _, label = connected_components(graph, directed=False)
        sizes = np.bincount(label)
        return [self.ids[label == g].tolist() for g in dict.fromkeys(label.tolist()) if sizes[g] > 1]

    def activities(self, name: str | None = None, at_least: float = 0.0) -> ActivityTable:
        """Pairs and how probable it is that they take, or took, part in each activity (or the one named).

        Raises:
            ValueError: no activity of that name.
        """
        known = [a.name for a in self.model.activities]
        if name is not None and name not in known:
            raise ValueError(f"no activity {name!r}; the model has {', '.join(known) or 'none'}")
        none = np.zeros(0, np.int64)
        which, first, second = [np.zeros(0, str)], [none], [none]
        p, phase, shares = [np.zeros(0)], [np.zeros(0, str)], [np.zeros((0, 3))]
        for place, relation in enumerate(self.model.relations):
            about = self.model.activities_of(relation)
            for activity, stages in zip(about, self.pairs[place].stages, strict=True):
                if name not in (None, activity.name):
                    continue
                during = activity.chain.index(relation.name)
                words = [activity.chain[0] if during else "", relation.name, *activity.chain[during + 1 :], ""][:3]
                share = phases(stages)
                which.append(np.full(len(stages), activity.name))
                first.append(self.pairs[place].first)
                second.append(self.pairs[place].second)
                p.append(taken_place(stages))
                phase.append(np.array(words)[share.argmax(axis=1)])
                shares.append(share)
        chance = np.concatenate(p)
        order = np.argsort(-chance, kind="stable")
        order = order[chance[order] >= at_least]
        return ActivityTable(
            np.concatenate(which)[order],
            self.ids[np.concatenate(first)[order]],
            self.ids[np.concatenate(second)[order]],
            chance[order],
            np.concatenate(phase)[order],
            np.concatenate(shares)[order],
        )

    def save(self, directory: str | os.PathLike[str]) -> None:
        """Store bit for bit as a directory of arrays and a manifest; ``load`` needs the same model again."""
        arrays: dict[str, NDArray] = {name: getattr(self, name) for name in _ARRAYS}
        for i, pairs in enumerate(self.pairs):
            arrays |= {f"pairs_{i}_{name}": getattr(pairs, name) for name in (*_PAIRS, *_PAIRS_OF[type(pairs)])}
            arrays |= {f"pairs_{i}_stages_{j}": stages for j, stages in enumerate(pairs.stages)}
        arrays |= self._arrays()
        meta = {name: getattr(self, name) for name in _NUMBERS} | {"model": outline(self.model)}
        store.save(directory, arrays, meta | self._meta(), KIND)

    def _arrays(self) -> dict[str, NDArray]:
        """What only this kind of scene has, as stored."""
        return {}

    def _meta(self) -> dict[str, Any]:
        return {}

    @classmethod
    def load(cls, directory: str | os.PathLike[str], model: RelationalModel) -> Scene:
        """Read a stored scene back.

        Raises:
            StoreError: missing, damaged, or made with a model of other kinds, relations or activities.
        """
        arrays, meta = store.load(directory, KIND)
        if meta.get("model") != outline(model):
            raise store.StoreError(f"{directory} was made with another relational model")
        kind = ParticlePairs if "particles_mean" in arrays else GaussianPairs
        try:
            pairs = []
            for i, relation in enumerate(model.relations):
                about = len(model.activities_of(relation))
                stages = tuple(arrays[f"pairs_{i}_stages_{j}"] for j in range(about))
                held = {name: arrays[f"pairs_{i}_{name}"] for name in (*_PAIRS, *_PAIRS_OF[kind])}
                pairs.append(kind(**held, stages=stages))
            known: dict[str, Any] = {name: arrays[name] for name in _ARRAYS} | {name: meta[name] for name in _NUMBERS}
            known |= {"model": model, "pairs": tuple(pairs)}
            if kind is ParticlePairs:
                particles = Particles(**{name: arrays[f"particles_{name}"] for name in _PARTICLES})
                return ParticleScene(**known, particles=particles, engine=meta.get("engine"))
            return CollapsedScene(**known, own_mean=arrays["own_mean"], own_cov=arrays["own_cov"])
        except (KeyError, TypeError) as error:
            raise store.StoreError(f"{directory} is damaged: {error}") from None

    def __repr__(self) -> str:
        likely = sum(int((pairs.p >= 0.5).sum()) for pairs in self.pairs)
        there = int((self.existence >= 0.5).sum())
        lost = f", {self.recoveries} recoveries" if self.recoveries else ""
        return f"Scene({there} objects, {likely} probable relations, step {self.step}, t={self.time:g} s{lost})"

    def _repr_html_(self) -> str:
        there, known = self.tracks(), self.relations(at_least=0.05)
        objects = [
            (name, kind, ", ".join(f"{x:,.1f}" for x in at), f"{sd:.2g}", f"{unseen:g}")
            for name, kind, at, sd, unseen in zip(
                there.ids, there.kinds, there.position, there.sd, there.unseen, strict=True
            )
        ]
        pairs = [(r, f"{a}, {b}", f"{p:.2f}") for r, a, b, p in zip(*known, strict=True)]
        return (
            f"<p>{escape(repr(self))}</p><div style='display:flex;gap:1em'>"
            f"{_table(('object', 'kind', 'position, m', '± m', 'unseen, s'), objects)}"
            f"{_table(('relation', 'of', 'probability'), pairs)}</div>"
        )


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class CollapsedScene(Scene[GaussianPairs]):
    """Of the engine "collapsed".

    Attributes:
        own_mean, own_cov: ``(n, 2, d)``, ``(n, 3)`` each object's own Kalman filter, blind to relations.
    """

    own_mean: Floats
    own_cov: Floats

    def _arrays(self) -> dict[str, NDArray]:
        return {"own_mean": self.own_mean, "own_cov": self.own_cov}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ParticleScene(Scene[ParticlePairs]):
    """Of the engines "bootstrap" and "rbk".

    Attributes:
        particles: joint hypotheses about all objects.
        engine: that made it; None of scenes that were stored when this was not kept.
    """

    particles: Particles
    engine: str | None

    def _arrays(self) -> dict[str, NDArray]:
        return {f"particles_{name}": getattr(self.particles, name) for name in _PARTICLES}

    def _meta(self) -> dict[str, Any]:
        return {"engine": self.engine}


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """The first ten rows in HTML, and how many more there are."""
    lines = ["".join(f"<td>{escape(str(value))}</td>" for value in row) for row in rows[:10]]
    if len(rows) > 10:
        lines.append(f"<td colspan={len(head)}>and {len(rows) - 10:,} more</td>")
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    return f"<table><tr>{top}</tr>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


_ARRAYS = ("ids", "kinds", "serial", "mean", "cov", "existence", "unseen", "key")
_PAIRS = ("first", "second", "p", "looked")
_PAIRS_OF: dict[type[Pairs], tuple[str, ...]] = {GaussianPairs: ("counts", "states"), ParticlePairs: ("bits",)}
_PARTICLES = ("mean", "cov", "log_weights", "block")
_NUMBERS = ("step", "serials", "time", "log_evidence", "recoveries")


def outline(model: RelationalModel) -> list[list[str]]:
    """What a stored scene must share with the model it is read back with."""
    return [model.kinds, [f"{r.name} {r.symmetric}" for r in model.relations], [a.name for a in model.activities]]
