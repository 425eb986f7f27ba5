"""Statements about two objects that a relation may depend on: ``near(2.0) & same_velocity(0.5)``.

Predicates combine with ``&``, ``|`` and ``~``. What they answer is a probability under the belief about the two objects
(0 or 1 where the objects are sampled), and they are only asked while both objects are seen: see ``Relation``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from wakefold.relations.kernels.codes import AHEAD, BEGIN, CLOSING, NEAR, NOT, SAME_VELOCITY, SEEN, SLOW

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Predicate:
    """A statement about an ordered pair of objects, kept as a program of (operation, constant, constant).

    Made by ``near``, ``same_velocity``, ``slow``, ``ahead``, ``closing`` and ``seen``; combined with ``&``, ``|``,
    ``~``. Under a Gaussian the second of two conjuncts is asked of what the first leaves, taken as Gaussian again.
    """

    program: tuple[tuple[int, float, float], ...]

    def __and__(self, other: Predicate) -> Predicate:
        return Predicate((*self.program, *_predicate(other).program))

    def __or__(self, other: Predicate) -> Predicate:
        return ~(~self & ~_predicate(other))

    def __invert__(self) -> Predicate:
        return Predicate(((BEGIN, 0.0, 0.0), *self.program, (NOT, 0.0, 0.0)))

    def __bool__(self) -> bool:
        raise TypeError("combine predicates with & | ~, not with and, or, not")

    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The program as kernels read it: operations ``(n,)`` and constants ``(n, 2)``."""
        import numpy as np

        rows = np.array(self.program, dtype=np.float64).reshape(-1, 3)
        return rows[:, 0].astype(np.int64), np.ascontiguousarray(rows[:, 1:])


def _predicate(other: object) -> Predicate:
    if not isinstance(other, Predicate):
        raise TypeError(f"a predicate combines with a predicate, got {other!r}")
    return other


def _one(op: int, first: float = 0.0, second: float = 0.0) -> Predicate:
    return Predicate(((op, float(first), float(second)),))


def number(name: str, value: object) -> float:
    """A setting as a float.

    Raises:
        TypeError: it is no number; the message names it.
    """
    if isinstance(value, (bool, str, bytes)) or not hasattr(value, "__float__"):
        raise TypeError(f"{name} must be a number, got {value!r}")
    try:
        return float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a number, got {value!r}") from None


def _positive(name: str, value: float) -> float:
    if not 0.0 < number(name, value) < math.inf:
        raise ValueError(f"{name} must be a positive number, got {value}")
    return float(value)


def near(distance: float) -> Predicate:
    """The two are within ``distance`` metres."""
    return _one(NEAR, _positive("near: distance", distance))


def same_velocity(difference: float) -> Predicate:
    """Their velocities differ by at most ``difference`` m/s."""
    return _one(SAME_VELOCITY, _positive("same_velocity: difference", difference))


def slow(speed: float) -> Predicate:
    """Both move at most at ``speed`` m/s."""
    return _one(SLOW, _positive("slow: speed", speed))


def ahead(distance: float, width: float) -> Predicate:
    """The second is ahead of the first: within ``distance`` metres along its course, ``width`` metres beside it."""
    return _one(AHEAD, _positive("ahead: distance", distance), _positive("ahead: width", width))


def closing(speed: float) -> Predicate:
    """Their distance shrinks by at least ``speed`` m/s."""
    return _one(CLOSING, _positive("closing: speed", speed))


def seen() -> Predicate:
    """Both have been seen lately (within the relation's ``seen_within``)."""
    return _one(SEEN)
