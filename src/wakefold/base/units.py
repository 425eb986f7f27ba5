"""Durations, lengths, speeds and times as people write them, turned into seconds and metres; units of both."""

from __future__ import annotations

import math
import re
from datetime import UTC, date, datetime, timedelta

import numpy as np

from wakefold.base.checks import real

Duration = float | str | timedelta | np.timedelta64
Length = float | str
Time = float | str | date | np.datetime64  # a datetime is a date

HOUR, DAY = 3600.0, 86400.0  # seconds
NAUTICAL_MILE = 1852.0  # metres
KNOT = NAUTICAL_MILE / HOUR  # metres per second
FARTHEST = 1e12  # metres or plane units from the origin: farther away, squares of distances lose all their digits
LOST = 6.0  # sd: who is farther than this from where it was seen is lost

_SECONDS = {"ms": 1e-3, "s": 1.0, "sec": 1.0, "second": 1.0, "min": 60.0, "minute": 60.0}
_SECONDS |= {"h": HOUR, "hr": HOUR, "hour": HOUR, "d": DAY, "day": DAY}
_METRES = {"m": 1.0, "metre": 1.0, "meter": 1.0, "km": 1000.0, "nmi": NAUTICAL_MILE, "ft": 0.3048}
_SPEEDS = {"m/s": 1.0, "km/h": 1 / 3.6, "kn": KNOT, "knot": KNOT}
_PART = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([a-z/]*)\s*")


def seconds(duration: Duration) -> float:
    """A duration in seconds: 1800, "1800", "30min", "1h 30min", "0.5 h", a timedelta.

    Raises:
        ValueError: not a duration, negative or not finite.
    """
    if isinstance(duration, timedelta):
        return _checked(duration.total_seconds(), duration, "a duration")
    if isinstance(duration, np.timedelta64):
        return _checked(float(duration / np.timedelta64(1, "s")), duration, "a duration")
    return _measure(duration, _SECONDS, '"200s", "30min", "1h 30min"', "a duration")


def metres(length: Length) -> float:
    """A length in metres (or the data's plane units): 200, "200", "200m", "1.5 km", "2 nmi" (nautical miles).

    Raises:
        ValueError: not a length, negative or not finite.
    """
    return _measure(length, _METRES, '"200m", "1.5km", "2nmi"', "a length")


def metres_per_second(speed: float | str) -> float:
    """A speed in metres per second: 1, "1", "1m/s", "3.6 km/h", "2kn" (knots).

    Raises:
        ValueError: not a speed, negative or not finite.
    """
    return _measure(speed, _SPEEDS, '"2kn", "1m/s"', "a speed")


def timestamp(time: Time) -> float:
    """A moment in seconds UTC since 1970: 1.6e9, "2020-12-08", "2020-12-08T06:30:00Z", a date, datetime or datetime64.

    A time that names no zone is UTC.

    Raises:
        ValueError: not a time, or not finite.
    """
    if isinstance(time, str):
        try:
            time = datetime.fromisoformat(time.strip())
        except ValueError:
            raise ValueError(f'{time!r} is not a time such as "2020-12-08" or "2020-12-08T06:30:00Z"') from None
    if isinstance(time, datetime):
        return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
    if isinstance(time, date):
        return datetime(time.year, time.month, time.day, tzinfo=UTC).timestamp()
    if isinstance(time, np.datetime64):
        time = float((time - np.datetime64(0, "s")) / np.timedelta64(1, "s"))
    seconds = real(time, "a time")
    if not math.isfinite(seconds):
        raise ValueError(f"{time!r} is not a time")
    return seconds


def _measure(value: float | str, units: dict[str, float], examples: str, what: str) -> float:
    if not isinstance(value, str):
        return _checked(real(value, what), value, what)
    text = value.strip().lower()
    try:
        return _checked(float(text), value, what)
    except ValueError:
        total, position = 0.0, 0
        while part := _PART.match(text, position):
            unit = part[2] if part[2] in units else part[2].removesuffix("s")
            if unit not in units:
                break
            total, position = total + float(part[1]) * units[unit], part.end()
        if position == 0 or position != len(text):
            raise ValueError(f"{value!r} is not {what} such as {examples}") from None
        return _checked(total, value, what)


def _checked(number: float, given: object, what: str) -> float:
    if not (math.isfinite(number) and number >= 0):
        raise ValueError(f"{given!r} is not {what}: it must be finite and not negative")
    return number
