"""Scenarios of the papers' experiments: data, truth, model, and what is observed (Hawasly et al. 2016, Section 4).

All noise is in fractions of the diagonal of the data's bounding box, per step. Everything follows from one seed: the
observations of a run are the same for every filter and, up to their scale, for every noise.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from wakefold.base.remember import Remembers
from wakefold.base.types import Floats
from wakefold.evidence.confusion import Reporter
from wakefold.evidence.kernels import name_classes
from wakefold.experiments.mhpf import datasets
from wakefold.experiments.mhpf.rasters import TANKERS, traffic
from wakefold.model.dynamics import Dynamics
from wakefold.model.filtration import Filtration
from wakefold.model.model import Model
from wakefold.tracks.tracks import Tracks

SAMPLES = 10  # that a coarse report is made from
NEAREST = 64  # points looked at around each of them


class Setting(NamedTuple):
    """What is observed of whom, and what the model is told.

    Attributes:
        data: "ways" (33 tracks in the configuration space), "common" (13 with common ends) or "tankers" (194; see
            ``rasters``).
        truth: "out": the true track is in no model; "in": it is one of the training tracks.
        kappa, psi: noise of the dynamics and of observations.
        coarse: probability of a coarse report at a step.
        lead_in: share of the trial after which there are no fixes any more; coarse reports come only then.
        wrong: share of the coarse reports that name any other class.
        linkage: "single" or "complete".
        epsilon: "default", or "near" (twice the spacing of the points) or "wide" (half the birth of the root).
        spread: of the points that a coarse report is made from; psi without.
        told_by: whose tree reports are named in: the "model"'s, or that of "all" tracks, the truth among them.
    """

    data: str
    truth: str
    kappa: float
    psi: float
    coarse: float = 0.0
    lead_in: float | None = None
    wrong: float = 0.0
    linkage: str = "single"
    epsilon: str = "default"
    spread: float | None = None
    told_by: str = "model"


class Report(NamedTuple):
    """A coarse report: a class of the model's tree and the level it is to be read at."""

    class_: int
    level: float


class Observed(NamedTuple):
    """What is observed at one step; None where nothing is."""

    fix: Floats | None
    report: Report | None


def _family(name: str) -> str:
    """A data set's name without the place of its raster, on which no random number depends."""
    return name.partition(":")[0]


@lru_cache(maxsize=8)
def data(name: str) -> Tracks:
    """The tracks of a data set."""
    match name:
        case "ways":
            return datasets.configuration_space()
        case "common":
            return datasets.common_ends()
        case _ if _family(name) == TANKERS:
            return datasets.walks(*traffic(name))
    raise ValueError(f"no data set {name!r}")


@lru_cache(maxsize=64)
def tree_of(name: str, linkage: str, without: int | None) -> tuple[Tracks, Filtration]:
    """The tracks of a data set, all or without one, and their filtration."""
    tracks = data(name)
    if without is not None:
        tracks = tracks.select([k for k in range(len(tracks)) if k != without])
    return tracks, Filtration.fit(tracks, linkage="complete" if linkage == "complete" else "single", threads=1)


def chosen(name: str, number: int, seed: int) -> list[int]:
    """The true tracks of the scenarios: the first ``number`` of a seeded order."""
    tracks = data(name)
    if number > len(tracks):
        raise ValueError(f"{number} scenarios of {len(tracks)} tracks")
    order = np.random.default_rng([seed, crc32(_family(name).encode())]).permutation(len(tracks))
    return order[:number].tolist()


class Scenario(Remembers):
    """One true track, followed under a setting.

    Attributes:
        truth: index of the true track.
        path: ``(n, d)`` where the agent is at each step.
        offset: mean error of a fix per axis, which is uniform on [0, psi] (sic, Section 4); the model has its sd.
        model: what the filters know.
        kept: ``(K,)`` index in the data of each of the model's tracks.
    """

    def __init__(self, setting: Setting, truth: int) -> None:
        self.setting, self.truth = setting, truth
        self.everything, self.tree = tree_of(setting.data, setting.linkage, None)
        out = setting.truth == "out"
        known, tree = tree_of(setting.data, setting.linkage, truth if out else None)
        self.kept = np.array([k for k in range(len(self.everything)) if not (out and k == truth)])
        self.path: Floats = self.everything[truth]
        self.diagonal = self.everything.diagonal
        self.offset = 0.5 * setting.psi * self.diagonal
        dynamics = Dynamics.learn(
            known, tree, _epsilon(setting.epsilon, known, tree), "uniform", setting.kappa * self.diagonal
        )
        self.model = Model(known, tree, dynamics, setting.psi * self.diagonal / math.sqrt(12.0))

    @cached_property
    def away(self) -> Floats:
        """``(K,)`` tree distance of each of the model's tracks to the truth, in the tree of all tracks."""
        return np.asarray(self.tree.tree_distance(self.kept, self.truth), dtype=np.float64)

    @cached_property
    def reach(self) -> float:
        """Birth of the root of all tracks: the range of tree distances."""
        return float(self.tree.birth[self.tree.root])

    def observations(self, seed: int, repetition: int) -> list[Observed]:
        """What is observed at the steps 1 to n - 1 of a repetition."""
        s = self.setting
        rng = np.random.default_rng([seed, crc32(_family(s.data).encode()), self.truth, repetition])
        steps = len(self.path) - 1
        offsets = rng.uniform(size=(steps, 2))
        told, lies = rng.uniform(size=(2, steps))
        spread = rng.normal(size=(steps, SAMPLES, 2))
        other = rng.integers(1 << 30, size=steps)
        scale, at = s.psi * self.diagonal, self.path[1:]
        leading = np.arange(1, steps + 1) <= (1.0 if s.lead_in is None else s.lead_in) * steps
        reported = (told < s.coarse) & (~leading if s.lead_in is not None else True)
        named = dict.fromkeys(range(steps), -1)
        if reported.any():
            rows = np.flatnonzero(reported)
            classes = self.namer.classes(at[rows, None] + self.spread * spread[rows])
            named |= dict(zip(rows.tolist(), classes.tolist(), strict=True))
        out = []
        for k in range(steps):
            class_ = self.namer.another(named[k], int(other[k])) if reported[k] and lies[k] < s.wrong else named[k]
            fix = at[k] + scale * offsets[k] if leading[k] else None
            out.append(Observed(fix, self.report(class_) if reported[k] else None))
        return out

    def report(self, class_: int) -> Report | None:
        """The report that names a class of the namer's tree.

        A class of the tree of all tracks is read as the least of the model's classes that holds its other tracks and is
        no single track; None where that is the root, which says nothing.
        """
        tree = self.model.filtration
        if self.namer.tree is not tree:
            members = self.namer.tree.members(class_)
            ranks = tree.rank[np.searchsorted(self.kept, members[members != self.truth])]
            class_ = int(tree.order[ranks.min()])
            while class_ < len(tree) or tree.hi[class_] <= ranks.max() or tree.lo[class_] > ranks.min():
                class_ = int(tree.parent[class_])
            if class_ == tree.root:
                return None
        return Report(class_, float(0.5 * (tree.birth[class_] + tree.death[class_])))

    @property
    def spread(self) -> float:
        """Sd of the points that a coarse report is made from, plane units."""
        s = self.setting
        return (s.psi if s.spread is None else s.spread) * self.diagonal

    @cached_property
    def reporter(self) -> Reporter | None:
        """Who makes the coarse reports, as far as a filter may know: not the wrong ones. None where there are none."""
        if self.setting.coarse == 0.0:
            return None

        def report(positions: Floats, rng: np.random.Generator) -> NDArray[np.int64]:
            samples = positions[:, None] + self.spread * rng.normal(size=(len(positions), SAMPLES, positions.shape[1]))
            return self.namer.classes(samples)

        return report

    @cached_property
    def namer(self) -> Namer:
        s = self.setting
        return _namer(s.data, s.linkage, self.truth if s.truth == "out" and s.told_by == "model" else None)


class Namer:
    """Names the class most likely to have made some points, as the authors' public code does.

    See ``kernels.reports``; a report is read at the middle of its class's life. Single tracks are never named, nor is
    the root, which says nothing. Of the points around each sample the ``NEAREST`` count.

    Raises:
        ValueError: the tree has no class between its tracks and its root.
    """

    def __init__(self, tracks: Tracks, tree: Filtration) -> None:
        if tree.root <= len(tree):
            raise ValueError("there is no class to name between the single tracks and the root")
        self.tree, self.diagonal = tree, tracks.diagonal
        self.points = KDTree(tracks.points)
        self.owner = np.repeat(np.arange(len(tracks)), tracks.lengths)
        self.size = tree.hi - tree.lo
        self.near = min(NEAREST, len(tracks.points))

    def classes(self, samples: Floats) -> NDArray[np.int64]:
        """The class for each set of samples ``(R, S, d)``, ``(R,)``."""
        distances, rows = self.points.query(samples, k=self.near)
        out = np.empty(len(samples), dtype=np.int64)
        name_classes(distances, self.owner[rows], self.tree.parent, self.size, self.diagonal, out)
        return out

    def another(self, class_: int, number: int) -> int:
        """Any class that can be named but this one, picked by a number."""
        others = [c for c in range(len(self.tree), self.tree.root) if c != class_]
        return others[number % len(others)] if others else class_


@lru_cache(maxsize=64)
def _namer(name: str, linkage: str, without: int | None) -> Namer:
    return Namer(*tree_of(name, linkage, without))


def _epsilon(rule: str, tracks: Tracks, tree: Filtration) -> float | None:
    match rule:
        case "default":
            return None
        case "near":
            return 2.0 * tracks.median_spacing
        case "wide":
            return 0.5 * float(tree.birth[tree.root])
    raise ValueError(f"no epsilon rule {rule!r}")
