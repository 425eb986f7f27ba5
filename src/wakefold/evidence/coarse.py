"""A report of a class of the filtration: coarse evidence, and how likely it is under each class."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from wakefold.base.checks import real, whole

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration

Family = Literal["log", "gaussian", "student"]
CONFIDENCE = 0.9  # of a report that does not tell its own


@dataclass(frozen=True)
class CoarseClass:
    """A report that the agent belongs to a class of the filtration.

    Args:
        class_: id of the class, as ``Filtration.class_of`` or ``Belief.map`` give it.
        level: height at which the report is to be read, metres; by default the birth of the class.
        confidence: probability that the report is right, in (0, 1]; the rest is shared evenly by the other classes of
            the level. Read by the "gaussian" and "student" likelihoods; "log" goes by tree distance.
    """

    class_: int
    level: float | None = None
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        if isinstance(self.class_, bool) or not isinstance(self.class_, (int, np.integer)):
            raise ValueError(f"CoarseClass takes the id of a class, an integer, got {self.class_!r}")
        whole(self.class_, "CoarseClass id of a class", least=-(1 << 62), most=1 << 62)
        if self.level is not None and not 0.0 <= real(self.level, "CoarseClass level") < math.inf:
            raise ValueError(f"CoarseClass level must be a finite number of metres >= 0, got {self.level}")
        if not 0.0 < real(self.confidence, "CoarseClass confidence") <= 1.0:
            raise ValueError(f"CoarseClass confidence must be within (0, 1], got {self.confidence}")

    def at_level(self, tree: Filtration) -> float:
        """The level at which the report is read, metres.

        Raises:
            ValueError: no such class, or it is not alive at the level; the message names the class that is.
        """
        if not 0 <= self.class_ < len(tree.birth):
            raise ValueError(f"CoarseClass {self.class_}: the filtration has classes 0 to {len(tree.birth) - 1}")
        birth, death = float(tree.birth[self.class_]), float(tree.death[self.class_])
        level = birth if self.level is None else float(self.level)
        if not birth <= level < death:
            first = tree.order[tree.lo[self.class_]]
            there = int(alive_classes(tree, np.array([first]), level)[0])
            raise ValueError(
                f"class {self.class_} is alive from {birth:g} to {death:g}, not at level {level:g}; "
                f"there class {there} holds its tracks"
            )
        return level


def coarse_log_g(
    tree: Filtration, item: CoarseClass, level: float, classes: NDArray[np.int64], family: Family, diagonal: float
) -> NDArray[np.float64]:
    """Log-likelihood of coarse evidence for classes alive at its level, ``(n,)`` (docs/algorithm.md, Likelihoods).

    "log": -log(clip(tree distance / diagonal, 1e-4, 1)). Otherwise the confidence for the named class and an even
    share of the rest for each of the others alive at that level.
    """
    from wakefold.base.small import log

    if family == "log":
        distance = np.asarray(tree.tree_distance(classes, item.class_), dtype=np.float64)
        scaled = distance / diagonal if diagonal > 0 else np.sign(distance)
        g = -log(np.minimum(np.maximum(scaled, 1e-4), 1.0))
    else:
        others = np.count_nonzero(tree.gaps > level)
        if others == 0:
            return np.zeros(len(classes))
        g = np.where(classes == item.class_, item.confidence, (1.0 - item.confidence) / others)
    return log(g)


def alive_classes(tree: Filtration, classes: NDArray[np.int64], level: float) -> NDArray[np.int64]:
    """The class alive at a level that holds each of ``classes`` (n,), none of them born after the level."""
    from wakefold.model.linkage.kernels.dendrogram import climb

    out = np.empty(len(classes), dtype=np.int64)
    climb(classes, tree.parent, tree.death, float(level), out)
    return out
