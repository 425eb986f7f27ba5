"""The Multiscale Hierarchy of Particle Filters (Hawasly et al. 2016, Algorithms 1 to 3; docs/algorithm.md)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats, Ints
from wakefold.evidence.coarse import CoarseClass
from wakefold.evidence.fix import Fix
from wakefold.filters.belief import Belief, StackBelief
from wakefold.filters.kernels import particles as kernel
from wakefold.filters.particles import COPIES, NOISE, Items, ParticleFilter
from wakefold.filters.sets import Stack
from wakefold.model.kernels import motion
from wakefold.model.model import Model

Rule = Literal["arxiv2016", "gsi2017"]


class MHPF(ParticleFilter[StackBelief]):
    """A bank of particle filters, one for each level of the filtration, consistent over the tree.

    Args:
        rule: what the new class masses multiply after evidence: every set but the observed one ("gsi2017", which is
            Bayes' rule with a proper likelihood) or every set ("arxiv2016", the papers' first, meant for the likelihood
            "log": with a density it counts evidence about a track twice, and warns once).
        levels: the levels that keep particle sets: "all", a number of levels picked by ``Filtration.levels``, or
            heights in metres. Class probabilities are answered at any level all the same, and evidence may come at
            any level; the sets serve the estimates of a level and of the stack.

    The other arguments are those of ``ParticleFilter``.

    Raises:
        ValueError: a setting out of range; the message names it.
    """

    kind = StackBelief

    def __init__(
        self,
        model: Model,
        particles: int = 100,
        *,
        rule: Rule = "gsi2017",
        levels: Literal["all"] | int | Sequence[float] | NDArray[np.float64] = 8,
        **settings: Any,
    ) -> None:
        super().__init__(model, particles, **settings)
        if rule not in ("arxiv2016", "gsi2017"):
            raise ValueError(f"rule must be 'arxiv2016' or 'gsi2017', got {rule!r}")
        self.rule: Rule = rule
        if rule == "arxiv2016" and self.likelihood != "log":
            _warn_twice()
        tree = model.filtration
        inner = np.arange(len(tree.birth)) >= len(tree)
        if isinstance(levels, str):
            if levels != "all":
                raise ValueError(f"levels must be 'all', a number or heights in metres, got {levels!r}")
            self.levels = np.unique(tree.birth)
            self._used = inner
        else:
            self.levels = np.unique(tree.levels(levels) if isinstance(levels, int) else np.asarray(levels, np.float64))
            self._used = np.zeros(len(tree.birth), dtype=bool)
            for level in self.levels:
                self._used[tree.alive(level)] = True
            self._used &= inner

    @property
    def marginal(self) -> bool:
        """Whether ``log_evidence`` is the log marginal likelihood: of a density, under the rule that is Bayes'."""
        return super().marginal and self.rule == "gsi2017"

    def _remember(self) -> None:
        super()._remember()
        self._up = lru_cache(maxsize=64)(self._ancestors_in_use)

    def _ancestors_in_use(self, *more: float) -> Ints:
        """(C,) the nearest ancestor in use of every class, with the levels of a step's evidence in use as well."""
        tree, used = self.model.filtration, self._used
        if more:
            used = used.copy()
            for level in more:
                used[tree.alive(level)] = True
            used[: len(tree)] = False
        return kernel.nearest_used(tree.parent, used)

    def _step(self, belief: Belief, items: Items, dt: float, now: float | None) -> StackBelief:
        up = self._up(*(level for level, item in items if not isinstance(item, Fix)))
        points, classes, logs = self._open(belief)  # Algorithm 1, lines 12-13 of the step before
        sets = _Sets(self, classes, up, logs, points.copy(), belief, dt)  # lines 3-9 for the coarse sets
        self._roll(belief, NOISE, points, classes, dt)  # lines 7-9
        told = []
        for level, item in items:  # lines 10-11, Algorithm 3
            if isinstance(item, Fix):
                gain, met = kernel.weigh(points, *self._fix(item), logs)
                if not met:
                    points, classes = self._recover_fix(belief, item, classes, logs)
                    logs = self._even.copy()
                    sets = _Sets(self, classes, up, logs, points, belief)
                else:
                    sets.spread_fix(logs)
            else:
                gain = sets.observe(logs, item, level)
                met = gain > -np.inf
                if not met:
                    classes = self._recover_class(belief, item, level)
                    logs = self._even.copy()
                    sets = _Sets(self, classes, up, logs, points, belief)
            told.append((gain, not met))
        kernel.normalise(logs)
        return self._after(belief, points, classes, logs, now, told, stack=sets.stack())

    def _bare(self, belief: StackBelief) -> StackBelief:
        return replace(belief, stack=None)


@lru_cache(maxsize=1)  # once a process
def _warn_twice() -> None:
    warnings.warn(
        "rule 'arxiv2016' multiplies by the class masses twice: with a likelihood that is a density its probabilities "
        "are not Bayes'; use rule 'gsi2017', or likelihood 'log' as in the papers",
        stacklevel=3,
    )


class _Sets:
    """The coarse particle sets of one step and the class masses P over the classes that hold particles.

    Weights inside a coarse set only ever change together, so a set needs one log-factor, not one for each copy. No
    weight depends on where the copies are: they are moved when somebody asks where they are.
    """

    def __init__(
        self, f: MHPF, classes: Ints, up: Ints, logs: Floats, points: Floats, belief: Belief, dt: float = 0.0
    ) -> None:
        """Algorithm 2 upwards from the base set, and a copy of the base particles below each class in use.

        Args:
            points: (N, d) where the copies start, not to be changed any more; they will move for ``dt`` seconds.
        """
        self.filter = f
        made = kernel.layout(classes, logs, up, len(up))
        self.nodes, self.parent, self.leaf_of, self.start, self.copy_of, self.base_mass = made
        self.classes, self.up = classes, up
        self.mass = self.base_mass.copy()
        self.factors = np.zeros(len(self.nodes))
        self.copied = logs.copy()  # the weights that the copies were made with
        self.points, self.belief, self.dt = points, belief, dt

    def spread_fix(self, logs: Floats) -> None:
        """Algorithm 3, lines 16-19, after a fix has weighed the base set."""
        both = self.filter.rule == "arxiv2016"
        kernel.spread_fix(logs, self.leaf_of, self.parent, self.start, self.mass, self.factors, both)

    def observe(self, logs: Floats, item: CoarseClass, level: float) -> float:
        """Algorithm 3, lines 6-19: coarse evidence; the log of the mean likelihood, -inf when every weight is zero."""
        f = self.filter
        observed = kernel.alive_above(self.nodes, self.parent, self.start, f.model.filtration.death, level)
        log_g = f._coarse(item, level)[self.nodes]  # read at observed nodes only
        state = (self.base_mass, self.mass, self.factors, observed, log_g, f.rule == "arxiv2016")
        return kernel.spread_coarse(logs, self.leaf_of, self.parent, self.start, *state)

    def stack(self) -> Stack | None:
        """The sets as they are after the evidence; None when there are none but the base set."""
        if not len(self.copy_of):
            return None
        tree = (self.classes, self.up, self.nodes, self.start, self.copy_of)
        where = partial(_copies, self.filter, self.points, tree, self.belief.key, self.belief.step + 1, self.dt)
        return Stack(self.nodes, self.start, self.copy_of, self.copied, self.factors, where)


def _copies(f: MHPF, points: Floats, tree: tuple[Ints, ...], key: NDArray[np.uint64], step: int, dt: float) -> Floats:
    """(S, d) where copies of particles at ``points`` are after ``dt`` seconds under the classes of their sets."""
    stream, ground, (begin, parts, h) = (key, step, COPIES), f.model.dynamics.ground, f._span(dt)
    classes, up, nodes, start, copy_of = tree
    if parts == 0:
        return points[copy_of]
    copies = np.empty((len(copy_of), points.shape[1]))
    motion.roll(points, classes, (up, nodes, start), copies, stream, f._noise, (begin, parts, h), ground)
    if parts > 1:  # from the second sub-step on every copy is somewhere else
        under = np.repeat(nodes, start[1:] - start[:-1])
        motion.roll(copies, under, motion.ALONE, copies, stream, f._noise, (1, parts, h), ground)
    return copies
