"""What a sensor reports in one scan: positions of objects, with or without their identities."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.types import Floats
from wakefold.base.units import FARTHEST
from wakefold.relations.predicates import number

DetectProb = float | Callable[[Floats], ArrayLike]
FINEST = 1e-9  # metres


class Detections:
    """One scan of a sensor.

    Args:
        positions: ``(m, 2)`` metres in the plane; m may be 0 (an empty scan: whoever could have been seen was missed).
        sd: standard deviation of a position per axis, metres; one number, or ``(m,)``.
        ids: names of the objects, whole numbers or texts, each at most once; None where the sensor cannot tell.
        kinds: kind of each object, of the model's; one for all, or ``(m,)``. None: the model's first kind. An object
            keeps the kind it was first detected with.
        detect_prob: probability that an object is detected; a number, or a function of positions ``(n, 2)`` that gives
            ``(n,)``. A blind region has 0.
        clutter: expected number of false detections per square metre; only for detections without ids.
        birth: expected number of new objects per square metre; only for detections without ids.

    Raises:
        ValueError: a value missing, not finite or out of range, or an id that is there twice; the message names it.
    """

    __slots__ = ("birth", "clutter", "detect_prob", "ids", "kinds", "positions", "sd")

    def __init__(
        self,
        positions: ArrayLike,
        sd: ArrayLike = 1.0,
        ids: Sequence[int] | Sequence[str] | NDArray | None = None,
        *,
        kinds: str | Sequence[str] | None = None,
        detect_prob: DetectProb = 0.99,
        clutter: float = 0.0,
        birth: float = 1e-3,
    ) -> None:
        try:
            points = np.array(positions, dtype=np.float64)
            spread = np.asarray(sd, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"Detections positions and sd must be numbers: {error}") from None
        if points.size == 0:
            points = points.reshape(0, 2)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"Detections positions must be planar, of shape (m, 2), got {points.shape}")
        near = np.abs(points) <= FARTHEST  # false for NaN too
        if not near.all():
            row = int(np.flatnonzero(~near.all(axis=1))[0])
            raise ValueError(
                f"Detections positions must be finite and within {FARTHEST:g} m, row {row} is {points[row].tolist()}"
            )
        count = len(points)
        if spread.shape not in ((), (count,)) or not ((spread >= FINEST) & (spread <= FARTHEST)).all():
            raise ValueError(
                f"Detections sd must be a positive number of metres ({FINEST:g} to {FARTHEST:g}), or one for each "
                "position"
            )
        if ids is not None:
            if not isinstance(ids, np.ndarray) and np.ndim(ids) and len({isinstance(i, str) for i in ids}) > 1:
                raise ValueError("Detections ids must be all whole numbers or all texts")
            ids = np.asarray(ids)
            if count == 0:
                ids = np.zeros(0, dtype=np.int64)
            if ids.shape != (count,) or ids.dtype.kind not in "iuU":
                raise ValueError(f"Detections ids must be {count} whole numbers (of 64 bits) or texts")
            if ids.dtype.kind == "u":
                if count and ids.max() > np.iinfo(np.int64).max:
                    raise ValueError(f"Detections ids: {ids.max()} is beyond whole numbers of 64 bits")
                ids = ids.astype(np.int64)
            names = np.sort(ids)
            twice = names[1:] == names[:-1]
            if twice.any():
                raise ValueError(f"Detections ids: {names[1:][twice][0]} is there twice")
        if kinds is not None and not isinstance(kinds, str) and np.shape(kinds) != (count,):
            raise ValueError(f"Detections kinds must be one kind, or {count} of them, got {kinds!r}")
        if not callable(detect_prob) and not 0.0 <= number("Detections detect_prob", detect_prob) <= 1.0:
            raise ValueError(f"Detections detect_prob must be a probability or a function, got {detect_prob}")
        for name, value in (("clutter", clutter), ("birth", birth)):
            if not 0.0 <= number(f"Detections {name}", value) < math.inf:
                raise ValueError(f"Detections {name} must be a number >= 0, got {value}")
        self.positions: Floats = points
        self.sd: Floats = np.full(count, spread)
        self.ids: NDArray | None = ids
        self.kinds = kinds
        self.detect_prob: DetectProb = detect_prob
        self.clutter, self.birth = float(clutter), float(birth)

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"Detections({len(self)} {'without ids' if self.ids is None else 'with ids'})"

    def chance(self, positions: Floats) -> Floats:
        """``(n,)`` probability that objects at ``positions (n, 2)`` are detected.

        Raises:
            ValueError: ``detect_prob`` gives something that is no probability.
        """
        if not callable(self.detect_prob):
            return np.full(len(positions), float(self.detect_prob))
        out = np.asarray(self.detect_prob(positions), dtype=np.float64)
        if out.shape != (len(positions),):
            raise ValueError(f"detect_prob must give {len(positions)} probabilities, got an array of shape {out.shape}")
        wrong = out[~((out >= 0.0) & (out <= 1.0))]
        if len(wrong):
            raise ValueError(f"detect_prob must give probabilities, got {wrong[0]}")
        return out

    def kind_numbers(self, kinds: list[str]) -> NDArray[np.int64]:
        """``(m,)`` place of each object's kind among the model's.

        Raises:
            ValueError: a kind the model does not have.
        """
        if self.kinds is None:
            return np.zeros(len(self), dtype=np.int64)
        named = [self.kinds] if isinstance(self.kinds, str) else self.kinds
        for kind in named:
            if kind not in kinds:
                raise ValueError(f"Detections kinds: {kind!r} is none of {', '.join(kinds)}")
        numbers = np.array([kinds.index(k) for k in named], dtype=np.int64)
        return np.full(len(self), numbers) if isinstance(self.kinds, str) else numbers

    def sorted(self) -> Detections:
        """The same scan in an order of its own (by id, else by position), so that the caller's does not matter."""
        if self.ids is None:
            order = np.lexsort((self.sd, *self.positions.T))
        elif (self.ids[1:] > self.ids[:-1]).all():
            return self
        else:
            order = np.argsort(self.ids, kind="stable")
        out = copy(self)  # not made anew: nothing is to be checked again
        out.positions, out.sd = self.positions[order], self.sd[order]
        out.ids = None if self.ids is None else self.ids[order]
        if self.kinds is not None and not isinstance(self.kinds, str):
            out.kinds = [str(self.kinds[i]) for i in order]
        return out
