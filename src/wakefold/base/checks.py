"""What public functions are given: of the right kind, or refused in a sentence that names it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

SHOWN = 60  # characters of a value that a message repeats


def instance(value: Any, kind: type | tuple[type, ...], what: str) -> Any:
    """A value of a kind.

    Raises:
        TypeError: it is of another.
    """
    if not isinstance(value, kind):
        raise TypeError(f"{what}, got {shown(value)}")
    return value


def real(value: Any, what: str) -> float:
    """A number as a float.

    Raises:
        TypeError, ValueError: it is none, or too large for one.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.number)):
        raise TypeError(f"{what} must be a number, got {shown(value)}")
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{what} is too large a number: {shown(value)}") from None


def whole(value: Any, what: str, least: int = 1, most: int = 1 << 40) -> int:
    """A whole number within limits.

    Raises:
        ValueError: it is none, or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{what} must be a whole number of at least {least}, got {shown(value)}")
    if value > most:
        raise ValueError(f"{what} must be at most {most:,}, got {shown(value)}")
    return int(value)


def shown(value: object) -> str:
    """A value for a message, clipped; whole numbers of hundreds of digits by how many they have."""
    if isinstance(value, int) and abs(value) >= 10**SHOWN:
        return f"a whole number of about {int(math.log10(abs(value) >> 64) + 19.27):,} digits"
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 1]}…"
