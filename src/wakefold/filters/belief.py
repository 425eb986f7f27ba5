"""Beliefs: weighted particles (position, class) and the class masses they imply at every level."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from wakefold.base import small, store
from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints
from wakefold.filters.levels import LevelTable
from wakefold.filters.sets import Gaussians, Stack
from wakefold.model.growth import carried

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.model.model import Model

Estimate = Literal["base", "stack"]
KIND = "belief"


@dataclass(frozen=True, eq=False, repr=False)
class Belief(Remembers):
    """What a filter believes about one agent. Immutable: ``step`` makes a new one.

    Every kind of filter has a kind of belief, and steps no other: see the classes below.

    Attributes:
        filter: the kind of filter that made it.
        tree: the filtration of the model.
        points: ``(N, d)`` positions of the base particles, metres.
        classes: ``(N,)`` class id of each (single tracks; the root for BL2).
        log_weights: ``(N,)``, normalised.
        key, step: the agent's random stream and the number of steps taken.
        time: seconds UTC, or None when the filter was never told a time.
        log_evidence: log marginal likelihood of all evidence so far; None where there is none: for the "log" weights,
            which are no density, and under the rule "arxiv2016" of MHPF, which is not Bayes'.
            One report that nothing explains makes it -inf for good.
        log_evidence_since: the same of the evidence after that at which the agent was last lost and found again; of
            all evidence while it never was. NaN where a belief stored by an older version does not tell.
        recoveries: how often the filter lost the agent and started again.
        ignored: how many items of coarse evidence a published baseline could not use.
    """

    filter: ClassVar[str] = ""

    tree: Filtration
    points: Floats
    classes: Ints
    log_weights: Floats
    key: NDArray[np.uint64]
    step: int = 0
    time: float | None = None
    log_evidence: float | None = 0.0
    log_evidence_since: float | None = 0.0
    recoveries: int = 0
    ignored: int = 0

    @cached_property
    def weights(self) -> Floats:
        """``(N,)`` weights of the base particles; they sum to 1."""
        w = small.exp(self.log_weights - self.log_weights.max())
        return w / w.sum()

    @property
    def ess(self) -> float:
        """Effective sample size, 1 / (sum of squared weights)."""
        return float(1.0 / np.square(self.weights).sum())

    @cached_property
    def _sums(self) -> tuple[Floats, float]:
        """Prefix sums of the weights over leaf ranks, and the birth of the oldest class that a particle names."""
        at = np.bincount(self.tree.lo[self.classes], weights=self.weights, minlength=len(self.tree))
        inner = self.classes[self.classes >= len(self.tree)]
        return np.concatenate([[0.0], np.cumsum(at)]), float(self.tree.birth[inner].max(initial=0.0))

    def probability(self, class_: int) -> float:
        """Probability of one class: the weight of the particles below it.

        Raises:
            ValueError: no such class, or one finer than the classes this belief tells apart (BL2 knows the root only).
        """
        if not 0 <= class_ < len(self.tree.birth):
            raise ValueError(f"class {class_}: the filtration has classes 0 to {len(self.tree.birth) - 1}")
        sums, oldest = self._sums
        if self.tree.birth[class_] < oldest:
            raise ValueError(f"this belief does not tell classes apart below level {oldest:g}")
        return float(sums[self.tree.hi[class_]] - sums[self.tree.lo[class_]])

    def level(self, level: float) -> LevelTable:
        """Probabilities of all classes alive at a level (metres), the likeliest first; they sum to 1.

        Raises:
            ValueError: the level is negative or not finite, or finer than the classes this belief tells apart.
        """
        sums, oldest = self._sums
        if level < oldest:
            raise ValueError(f"this belief does not tell classes apart below level {oldest:g}, asked for {level:g}")
        classes = self.tree.alive(level)
        lo, hi = self.tree.lo[classes], self.tree.hi[classes]
        probability = np.maximum(sums[hi] - sums[lo], 0.0)
        order = np.argsort(-probability, kind="stable")
        return LevelTable(self.tree, float(level), classes[order], (hi - lo)[order], probability[order])

    def map(self, level: float = 0.0) -> int:
        """The likeliest class at a level (metres); of several equally likely the first in leaf order."""
        return int(self.level(level).classes[0])

    def _cloud(self, estimate: Estimate, level: float | None) -> tuple[Floats, Floats]:
        """Positions and normalised weights of the sets an estimate is made from."""
        if estimate not in ("base", "stack"):
            raise ValueError(f"estimate must be 'base' or 'stack', got {estimate!r}")
        if level is None and estimate == "base":
            return self.points, self.weights
        points, logs = self.points, self.log_weights
        if level is not None:
            own = (self.tree.death[self.classes] > level) & (self.tree.birth[self.classes] <= level)
            points, logs = points[own], logs[own]
        copies, theirs = self._copies(level)
        points, logs = np.concatenate([points, copies]), np.concatenate([logs, theirs])
        if level is not None and len(points) != len(self.points):
            raise ValueError(f"no particle sets are kept for level {level:g}: name it in the filter's levels")
        weights = small.exp(logs - logs.max())
        return points, weights / weights.sum()

    def _copies(self, level: float | None) -> tuple[Floats, Floats]:
        """Positions and log-weights of the particles in coarse sets, of a level or all; a bootstrap filter has none."""
        return self.points[:0], self.log_weights[:0]

    def mean(self, estimate: Estimate = "base", *, level: float | None = None) -> Floats:
        """Estimated position ``(d,)``, metres: weighted mean of particles.

        Args:
            estimate: "base" takes the finest set, "stack" every class's set, each counted once.
            level: the sets of this level (metres) alone; it must be one the filter keeps sets for.
        """
        points, weights = self._cloud(estimate, level)
        return small.mean(weights, points)

    def cov(self, estimate: Estimate = "base", *, level: float | None = None) -> Floats:
        """Covariance ``(d, d)`` of the position, square metres, over the same particles as ``mean``."""
        points, weights = self._cloud(estimate, level)
        return small.covariance(weights, points, small.mean(weights, points))

    def on(self, model: Model) -> Self:
        """The same belief about the classes of another model: this one extended, say, or without its old tracks.

        Single tracks are known by their ids; another class becomes the smallest that holds those of its tracks that the
        model has. Particles on tracks that it has not get the weight 0, which the others share in proportion, and are
        drawn anew by the next step. A track that came new has no particle: it is reached as any other that has none, by
        the share of classes that is redrawn, or when the agent is lost and found again.

        Args:
            model: in the same plane. Steps then take a filter of that model, with the settings of the one before.

        Raises:
            ValueError: none of the tracks that the agent may be on is there, or positions of other coordinates.
        """
        if self.points.shape[1] != model.tracks.dim:
            raise ValueError(f"the belief is {self.points.shape[1]}-D, the model {model.tracks.dim}-D")
        return self._on(model.filtration)

    def _on(self, tree: Filtration) -> Self:
        classes = carried(self.tree, tree, self.classes)
        logs = np.where(classes < 0, -math.inf, self.log_weights)
        if (likeliest := logs.max()) == -math.inf:
            raise ValueError("no track that the agent may be on is left in the model: start a new belief")
        if (classes < 0).any():
            classes[classes < 0] = classes[logs.argmax()]
            logs -= likeliest + math.log(small.exp(logs - likeliest).sum())
        return replace(self, tree=tree, classes=classes, log_weights=logs)

    def save(self, directory: str | os.PathLike[str]) -> None:
        """Store bit for bit as a directory of arrays and a manifest; ``load`` needs the same model again."""
        whose = {"filter": self.filter, "tree": _fingerprint(self.tree)}
        store.save(directory, self._arrays(), {**self._meta(), **whose}, KIND)

    def _meta(self) -> dict[str, Any]:
        """Numbers that are stored beside the arrays."""
        meta = {name: getattr(self, name) for name in _NUMBERS}
        return meta | {name: _told(getattr(self, name)) for name in _EVIDENCE}

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {name: getattr(self, name) for name in _ARRAYS}

    @classmethod
    def _more(cls, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        """Fields of this kind of belief from the arrays stored."""
        return {}

    @classmethod
    def _stored(cls, tree: Filtration, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> Belief:
        """The belief of this kind that was stored so.

        Raises:
            KeyError, TypeError, ValueError: something is missing or unsound.
        """
        numbers = {name: meta[name] if name == "time" else int(meta[name]) for name in _NUMBERS}
        evidence = _heard(meta["log_evidence"])
        before = None if evidence is None else math.nan if meta["recoveries"] else evidence  # of an older version
        since = _heard(meta["log_evidence_since"]) if "log_evidence_since" in meta else before
        own = {name: arrays[name] for name in _ARRAYS}
        return cls(tree=tree, log_evidence=evidence, log_evidence_since=since, **own, **numbers, **cls._more(arrays))

    @classmethod
    def load(cls, directory: str | os.PathLike[str], tree: Filtration) -> Belief:
        """Read a stored belief of any kind back.

        Args:
            tree: the filtration of the model it was made with (``model.filtration``).

        Raises:
            StoreError: missing, damaged, or made with another filtration.
        """
        arrays, meta = store.load(directory, KIND)
        if meta.get("tree") != _fingerprint(tree):
            raise store.StoreError(f"{directory} was made with another filtration")
        try:
            kind = _kind_named(meta["filter"]) if "filter" in meta else _kind_of(arrays, tree)
            return kind._stored(tree, arrays, meta)
        except (KeyError, TypeError, ValueError) as error:
            raise store.StoreError(f"{directory} is damaged: {error}") from None

    def __repr__(self) -> str:
        where = ", ".join(f"{x:.1f}" for x in self.mean())
        spread = math.sqrt(max(float(np.trace(self.cov())), 0.0))
        lost = f", {self.recoveries} recoveries" if self.recoveries else ""
        return (
            f"Belief({len(self.points)} particles, step {self.step}, at ({where}) ± {spread:.1f}, "
            f"ESS {self.ess:.1f}{lost})"
        )

    def _repr_html_(self) -> str:
        from html import escape

        levels = self.tree.levels(4)
        tables = "".join(self.level(b)._repr_html_() for b in levels if b >= self._sums[1])
        return f"<p>{escape(repr(self))}</p>{tables}"


class TrackBelief(Belief):
    """Of ``BL1``: every particle follows a single track."""

    filter = "BL1"


class FieldBelief(Belief):
    """Of ``BL2``: every particle follows the root, the field of all tracks."""

    filter = "BL2"

    def _on(self, tree: Filtration) -> Self:
        return replace(self, tree=tree, classes=np.full_like(self.classes, tree.root))


@dataclass(frozen=True, eq=False, repr=False)
class StackBelief(Belief):
    """Of ``MHPF``.

    Attributes:
        stack: the coarse sets of the last step; None where there are none, as before the first, or after ``on``.
    """

    stack: Stack | None = None
    filter = "MHPF"

    def _on(self, tree: Filtration) -> Self:
        return replace(super()._on(tree), stack=None)

    def _copies(self, level: float | None) -> tuple[Floats, Floats]:
        s = self.stack
        if s is None:
            return super()._copies(level)
        if level is None:
            return s.points, s.log_weights
        alive = (self.tree.birth[s.nodes] <= level) & (level < self.tree.death[s.nodes])
        rows = np.flatnonzero(np.repeat(alive, np.diff(s.start)))
        return s.points[rows], s.log_weights[rows]

    def _arrays(self) -> dict[str, NDArray[Any]]:
        s = self.stack
        if s is None:
            return super()._arrays()
        sets = {"nodes": s.nodes, "start": s.start, "copies": s.points}
        return super()._arrays() | sets | {"copy_of": s.particle, "copied": s.copied, "factors": s.factors}

    @classmethod
    def _more(cls, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        if "nodes" not in arrays:
            return {}
        weights = arrays["copy_of"], arrays["copied"], arrays["factors"]
        return {"stack": Stack(arrays["nodes"], arrays["start"], *weights, partial(np.asarray, arrays["copies"]))}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class GaussianBelief(Belief):
    """Of ``Calibrated``: every particle is a Gaussian about its position.

    Attributes:
        gaussians: what the particles carry beside the mean of their position.
    """

    gaussians: Gaussians
    filter = "Calibrated"

    def _on(self, tree: Filtration) -> Self:
        """Every track that came new gets a Gaussian without mass, which holds all that the others do.

        The share of the mass that switches gives it some at the next step.
        """
        moved, own = super()._on(tree), self.gaussians
        come = np.flatnonzero(~np.isin(tree.ids, self.tree.ids))
        rows = np.concatenate([np.flatnonzero(carried(self.tree, tree, self.classes) >= 0), np.zeros_like(come)])
        classes, new = moved.classes[rows], slice(len(rows) - len(come), None)
        points, logs = moved.points[rows], moved.log_weights[rows]
        covs, spreads, trust = own.covs[rows], own.spreads[rows], own.trust[rows]
        classes[new], points[new], logs[new], covs[new] = come, moved.mean(), -math.inf, moved.cov()
        spreads[new] = small.mean(moved.weights, own.spreads[:, None])[0]
        trust[new] = small.log(small.mean(moved.weights, small.exp(own.trust)))
        by = np.argsort(tree.rank[classes], kind="stable")
        gaussians = Gaussians(covs[by], spreads[by], trust[by])
        return replace(moved, points=points[by], classes=classes[by], log_weights=logs[by], gaussians=gaussians)

    def cov(self, estimate: Estimate = "base", *, level: float | None = None) -> Floats:
        """Covariance ``(d, d)`` of the position, square metres, between the Gaussians and within them."""
        _, weights = self._cloud(estimate, level)
        covs = self.gaussians.covs
        within = small.mean(weights, covs.reshape(len(covs), -1)).reshape(covs.shape[1:])
        return super().cov(estimate, level=level) + within

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return super()._arrays() | self.gaussians._asdict()

    @classmethod
    def _more(cls, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        return {"gaussians": Gaussians(*(arrays[name] for name in Gaussians._fields))}


class EarlierBelief(StackBelief, TrackBelief):
    """Stored before beliefs told whose they are, and without coarse sets: ``BL1`` and ``MHPF`` take it alike."""

    filter = "BL1 or MHPF"


_KINDS = {kind.filter: kind for kind in (TrackBelief, FieldBelief, StackBelief, GaussianBelief, EarlierBelief)}
_ELSEWHERE = {"Trail": ("wakefold.filters.trail", "TrailBelief")}  # they stand above this file
_ARRAYS = ("points", "classes", "log_weights", "key")
_NUMBERS = ("step", "time", "recoveries", "ignored")
_EVIDENCE = ("log_evidence", "log_evidence_since")


def _kind_named(name: str) -> type[Belief]:
    if name in _ELSEWHERE:
        module, kind = _ELSEWHERE[name]
        return getattr(import_module(module), kind)
    return _KINDS[name]


def _kind_of(arrays: dict[str, NDArray[Any]], tree: Filtration) -> type[Belief]:
    """Whose a belief is that was stored before beliefs told."""
    if "covs" in arrays:
        return GaussianBelief
    if "nodes" in arrays:
        return StackBelief
    return FieldBelief if len(tree) > 1 and (arrays["classes"] == tree.root).all() else EarlierBelief


def _told(evidence: float | None) -> float | str | None:
    """Evidence as JSON may hold it: numbers that are not finite as text."""
    return evidence if evidence is None or math.isfinite(evidence) else str(evidence)


def _heard(evidence: float | str | None) -> float | None:
    return None if evidence is None else float(evidence)


def _fingerprint(tree: Filtration) -> str:
    """What a belief must share with the filtration it is read back with: leaf order and heights."""
    return hashlib.sha256(tree.order.tobytes() + tree.gaps.tobytes()).hexdigest()
