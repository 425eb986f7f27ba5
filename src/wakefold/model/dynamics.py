"""The localised velocity field of every class (Hawasly et al. 2016, Section 3.1; docs/algorithm.md, Dynamics)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.checks import real
from wakefold.base.remember import Remembers
from wakefold.tracks.ragged import ragged_rows

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.model.kernels.boxes import Field, Ground
    from wakefold.tracks.tracks import Tracks

Noise = Literal["gaussian", "uniform"]
MAX_SUBSTEPS = 100_000
SETTINGS = ("epsilon", "interval", "noise", "scale")  # that are kept on disk
OFF_EDGE = 1e-9  # relative: more than rounding can change a distance by
DEPARTURES = 20_000  # training points that the default noise is learned from


@dataclass(frozen=True, eq=False)
class Dynamics(Remembers):
    """How the classes move: one velocity field for each class, all read from the same points.

    Attributes:
        points: ``(P, d)`` training points in leaf order, metres.
        velocities: ``(P, d)`` m/s: forward difference over time; the last point of a track repeats the one before, a
            one-point track stands still.
        starts: ``(M + 1,)`` first point of each leaf rank.
        lo, hi: ``(C,)`` interval of leaf ranks of each class.
        epsilon: radius of the ball, metres, one for all classes.
        diagonal: of the bounding box of the training tracks, metres.
        interval: median sample interval, s; longer steps are split into equal sub-steps no longer than this.
        noise: "gaussian" with sd ``scale * sqrt(dt)``, or "uniform" on +-``scale`` per axis and step (the papers').
        scale: m/sqrt(s) for "gaussian", metres for "uniform".
    """

    points: NDArray[np.float64]
    velocities: NDArray[np.float64]
    starts: NDArray[np.int64]
    lo: NDArray[np.int64]
    hi: NDArray[np.int64]
    epsilon: float
    diagonal: float
    interval: float
    noise: Noise
    scale: float

    def __post_init__(self) -> None:
        if self.noise not in ("gaussian", "uniform"):
            raise ValueError(f"noise must be 'gaussian' or 'uniform', got {self.noise!r}")
        for name in ("epsilon", "interval"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name} must be a positive number, got {getattr(self, name)}")
        if not (math.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"the scale of the noise must be a number >= 0, got {self.scale}")

    @classmethod
    def learn(
        cls,
        tracks: Tracks,
        filtration: Filtration,
        epsilon: float | None = None,
        noise: Noise = "gaussian",
        scale: float | None = None,
    ) -> Dynamics:
        """Velocities of all training points, and the settings the data suggest.

        Args:
            epsilon: metres; by default the larger of twice the median spacing of track points and the median death
                of the leaves, times 1 + 1e-9: it may itself be the distance of two points, and rounding must not decide
                whether the open ball holds them. It does.
            noise: see the class.
            scale: by default what the tracks show: how far, robustly (1.4826 times the median absolute residual per
                axis over the square root of time), a track departs from the velocity of the *other* tracks of the
                smallest class around it. For "uniform", 5 % of the diagonal.
        """
        rows, starts = _leaf_order(tracks, filtration)
        points, times = tracks.points[rows], tracks.times[rows]
        velocities, steps, intervals = _forward_difference(points, times, starts)
        if epsilon is None:
            deaths = filtration.death[: len(tracks)]
            finite = deaths[np.isfinite(deaths)]
            spacing = float(np.median(steps)) if len(steps) else 0.0
            epsilon = max(2 * spacing, float(np.median(finite)) if len(finite) else 0.0) * (1.0 + OFF_EDGE)
            epsilon = epsilon or max(tracks.diagonal, 1.0)  # every point in one place
        made = cls(
            points=points,
            velocities=velocities,
            starts=starts,
            lo=filtration.lo,
            hi=filtration.hi,
            epsilon=real(epsilon, "epsilon"),
            diagonal=tracks.diagonal,
            interval=float(np.median(intervals)) if len(intervals) else 1.0,
            noise=noise,
            scale=0.0 if scale is None else real(scale, "scale"),
        )
        if scale is not None:
            return made
        learned = 0.05 * made.diagonal if noise == "uniform" else made._departure(filtration)
        return cls(**{**{f: getattr(made, f) for f in made.__dataclass_fields__}, "scale": learned})

    def packed(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and JSON metadata that ``unpacked`` takes back, without what tracks and filtration say."""
        return {"velocities": self.velocities}, {name: getattr(self, name) for name in SETTINGS}

    @classmethod
    def unpacked(
        cls, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any], tracks: Tracks, filtration: Filtration
    ) -> Dynamics:
        """The dynamics that ``packed`` took apart; of models that keep no velocities, learned again.

        Raises:
            ValueError: velocities that are not those of so many points, or a setting out of range.
            KeyError, TypeError: a setting that is missing or no number.
        """
        if "velocities" not in arrays:
            return cls.learn(tracks, filtration, meta["epsilon"], meta["noise"], meta["scale"])
        rows, starts = _leaf_order(tracks, filtration)
        points, velocities = tracks.points[rows], arrays["velocities"]
        if velocities.shape != points.shape or velocities.dtype != np.float64 or not np.isfinite(velocities).all():
            raise ValueError("its velocities are not a number for each coordinate of each point")
        settings = {name: meta[name] for name in SETTINGS}
        return cls(points, velocities, starts, filtration.lo, filtration.hi, diagonal=tracks.diagonal, **settings)

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return self.points.shape[1]

    @property
    def floor(self) -> float:
        """Smallest distance used in 1/distance: 1e-9 of the diagonal."""
        return 1e-9 * self.diagonal if self.diagonal > 0 else 1e-9

    @property
    def reach(self) -> tuple[float, float]:
        """Squares of epsilon and of the floor, as the kernels take them."""
        return self.epsilon**2, self.floor**2

    @property
    def dims(self) -> tuple[int, ...]:
        """d zeros: tells the kernels the number of coordinates when they are compiled."""
        return (0,) * self.dim

    @cached_property
    def ground(self) -> Ground:
        """What the kernels are told of where a particle moves."""
        from wakefold.model.kernels.boxes import Ground

        return Ground(self.lo, self.hi, self.field, *self.reach, self.dims)

    @cached_property
    def field(self) -> Field:
        """Points, velocities and the boxes over them, as the kernels take them."""
        from wakefold.model.kernels.boxes import field

        return field(self.points, self.velocities, self.starts)

    def substeps(self, dt: float) -> int:
        """Number of equal sub-steps that a step of ``dt`` seconds is split into (0 when dt = 0).

        Raises:
            ValueError: dt is negative or not finite, or would take more than 100,000 sub-steps.
        """
        if not 0.0 <= dt < math.inf:  # NaN too
            raise ValueError(f"dt must be a finite number of seconds >= 0, got {dt}")
        count = math.ceil(dt / self.interval * (1 - 1e-12))
        if count > MAX_SUBSTEPS:
            raise ValueError(
                f"dt = {dt:g} s is more than {MAX_SUBSTEPS:,} sample intervals of {self.interval:g} s: start anew"
            )
        return count

    def velocity(self, points: ArrayLike, classes: ArrayLike) -> NDArray[np.float64]:
        """Localised velocity at ``points`` (n, d) of the ``classes`` (n,) or one class, ``(n, d)`` m/s."""
        from wakefold.model.kernels.motion import drifts

        at = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=np.float64)))
        chosen = np.ascontiguousarray(np.broadcast_to(np.asarray(classes, dtype=np.int64), (len(at),)))
        out = np.empty_like(at)
        drifts(at, chosen, np.empty(0, dtype=np.int64), out, self.ground)
        return out

    def _departure(self, filtration: Filtration) -> float:
        """Spread of a track about the velocity of the other tracks of its parent class, m/sqrt(s)."""
        from wakefold.model.kernels.neighbours import departures

        leaves = np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))
        rows = np.arange(0, len(self.points), max(1, len(self.points) // DEPARTURES))
        around = filtration.parent[filtration.order][leaves[rows]]
        if (around < 0).any():  # a single track has nothing to depart from
            return 0.0
        ranks = (leaves[rows], self.lo[around], self.hi[around])
        residual = departures(self.points[rows], self.velocities[rows], *ranks, self.ground)
        known = np.isfinite(residual)
        return float(1.4826 * np.median(np.abs(residual[known])) * math.sqrt(self.interval)) if known.any() else 0.0


def _leaf_order(tracks: Tracks, filtration: Filtration) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the points ``(P,)`` in leaf order, and the first point ``(M + 1,)`` of each leaf rank."""
    order = filtration.order
    lengths = tracks.lengths[order]
    return ragged_rows(tracks.offsets[:-1][order], lengths), np.concatenate([[0], np.cumsum(lengths)])


def _forward_difference(
    points: NDArray[np.float64], times: NDArray[np.float64], starts: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Velocities (P, d), and the length and duration of every step inside a track."""
    velocities = np.zeros_like(points)
    last = starts[1:] - 1
    inside = np.ones(len(points), dtype=bool)
    inside[last] = False
    rows = np.flatnonzero(inside)
    step, dt = points[rows + 1] - points[rows], times[rows + 1] - times[rows]
    velocities[rows] = step / dt[:, None]
    longer = last[np.diff(starts) > 1]
    velocities[longer] = velocities[longer - 1]
    return velocities, np.linalg.norm(step, axis=1), dt
