"""What an observation says: fine evidence (a position fix) and coarse evidence (a class of the filtration)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from wakefold.filtration import Filtration
    from wakefold.projection import Projection

Family = Literal["log", "gaussian", "student"]


class Fix:
    """A position fix: plane coordinates, or longitude and latitude.

    Args:
        position: ``(d,)`` metres in the model's plane.
        lon, lat: degrees WGS84, instead of ``position``; needs a model learned from geodetic tracks.
        sd: standard deviation of the fix per axis, metres; without it the filter's own.

    Raises:
        ValueError: a number that is missing, not finite or out of range; the message names the field.
    """

    __slots__ = ("lonlat", "position", "sd")

    def __init__(
        self,
        position: ArrayLike | None = None,
        *,
        lon: float | None = None,
        lat: float | None = None,
        sd: float | None = None,
    ) -> None:
        self.position: NDArray[np.float64] | None = None
        self.lonlat: tuple[float, float] | None = None
        if position is not None:
            if lon is not None or lat is not None:
                raise ValueError("Fix takes a position or lon and lat, not both")
            self.position = np.atleast_1d(np.asarray(position, dtype=np.float64))
            if self.position.ndim != 1 or not 1 <= len(self.position) <= 3:
                raise ValueError(f"Fix position must be 1 to 3 coordinates, got shape {self.position.shape}")
            if not all(map(math.isfinite, self.position.tolist())):
                raise ValueError(f"Fix position must be finite, got {self.position.tolist()}")
        else:
            if lon is None or lat is None:
                raise ValueError("Fix needs a position, or lon and lat")
            if not -180.0 <= lon <= 360.0:  # NaN too
                raise ValueError(f"Fix lon must be degrees within -180..360, got {lon}")
            if not -90.0 <= lat <= 90.0:
                raise ValueError(f"Fix lat must be degrees within -90..90, got {lat}")
            self.lonlat = (float(lon), float(lat))
        if sd is not None and not 0.0 < sd < math.inf:
            raise ValueError(f"Fix sd must be a positive number of metres, got {sd}")
        self.sd = None if sd is None else float(sd)

    def on_plane(self, projection: Projection | None, dim: int) -> NDArray[np.float64]:
        """``(d,)`` metres in the plane of a model.

        Raises:
            ValueError: lon and lat for a planar model, or a wrong number of coordinates.
        """
        if self.position is None:
            assert self.lonlat is not None
            if projection is None:
                raise ValueError("this model was learned from planar tracks: give the Fix a position, not lon and lat")
            position = projection.to_plane(*self.lonlat)[0]
            if dim != 2:
                raise ValueError(f"the model is {dim}-D: give the Fix a position of {dim} coordinates")
            return position
        if len(self.position) != dim:
            raise ValueError(f"the model is {dim}-D, the Fix has {len(self.position)} coordinates")
        return self.position

    def __repr__(self) -> str:
        where = f"lon={self.lonlat[0]}, lat={self.lonlat[1]}" if self.lonlat else f"{self.position}"
        return f"Fix({where}{'' if self.sd is None else f', sd={self.sd:g}'})"


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
    confidence: float = 0.9

    def __post_init__(self) -> None:
        if isinstance(self.class_, bool) or not isinstance(self.class_, (int, np.integer)):
            raise ValueError(f"CoarseClass takes the id of a class, an integer, got {self.class_!r}")
        if self.level is not None and not 0.0 <= self.level < math.inf:
            raise ValueError(f"CoarseClass level must be a finite number of metres >= 0, got {self.level}")
        if not 0.0 < self.confidence <= 1.0:
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


Evidence = Fix | CoarseClass


def alive_classes(tree: Filtration, classes: NDArray[np.int64], level: float) -> NDArray[np.int64]:
    """The class alive at a level that holds each of ``classes`` (n,), none of them born after the level."""
    from wakefold.kernels.dendrogram import climb

    out = np.empty(len(classes), dtype=np.int64)
    climb(classes, tree.parent, tree.death, float(level), out)
    return out


def coarse_log_g(
    tree: Filtration, item: CoarseClass, level: float, classes: NDArray[np.int64], family: Family, diagonal: float
) -> NDArray[np.float64]:
    """Log-likelihood of coarse evidence for classes alive at its level, ``(n,)`` (docs/algorithm.md, Likelihoods).

    "log": -log(clip(tree distance / diagonal, 1e-4, 1)). Otherwise the confidence for the named class and an even
    share of the rest for each of the others alive at that level.
    """
    if family == "log":
        distance = np.asarray(tree.tree_distance(classes, item.class_), dtype=np.float64)
        scaled = distance / diagonal if diagonal > 0 else np.sign(distance)
        g = -np.log(np.minimum(np.maximum(scaled, 1e-4), 1.0))
    else:
        others = np.count_nonzero(tree.gaps > level)
        if others == 0:
            return np.zeros(len(classes))
        g = np.where(classes == item.class_, item.confidence, (1.0 - item.confidence) / others)
    with np.errstate(divide="ignore"):
        return np.log(g)


def in_order(evidence: Sequence[Evidence], tree: Filtration) -> list[tuple[float, Evidence]]:
    """Fixes first, then coarse evidence by rising level: pairs of (level, item), level -1 for a fix.

    Raises:
        TypeError: something that is no evidence.
        ValueError: see ``CoarseClass.at_level``.
    """
    if isinstance(evidence, (Fix, CoarseClass)):
        raise TypeError("evidence is a list: put [] around the single item")
    out: list[tuple[float, Evidence]] = []
    for item in evidence:
        if isinstance(item, Fix):
            out.append((-1.0, item))
        elif isinstance(item, CoarseClass):
            out.append((item.at_level(tree), item))
        else:
            raise TypeError(f"evidence must be Fix or CoarseClass, got {type(item).__name__}")
    if len(out) > 1:
        out.sort(key=lambda pair: pair[0])
    return out
