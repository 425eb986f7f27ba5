"""Times of files as seconds (UTC, since 1970): ISO 8601, a strptime format, or numbers in a unit.

A ``time_format`` is None (ISO 8601 text, or numbers that are seconds), one of the units "s", "ms", "us", "ns" for
numbers, or a strptime format such as ``%d/%m/%Y %H:%M:%S``. Times without an offset are UTC.
"""

# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from wakefold.base.types import Floats
from wakefold.io.records import as_text

PER_SECOND = {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}
"""Units of numeric times."""
EARLIEST, LATEST = -62_135_596_800.0, 253_402_300_800.0
"""The years 1 to 9999. Nothing else is a time: it is a damaged line, or not in seconds."""
YEAR_2100 = 4_102_444_800.0
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
PLAIN = r"^\d{4}-\d\d-\d\d[T ][0-2]\d:[0-5]\d:[0-5]\d(\.\d{1,6})?$"
_OFFSET = re.compile(r"\d(Z|[+-]\d\d:?\d\d)$")


def arrow_type(samples: Sequence[str], time_format: str | None) -> pa.DataType:
    """The type in which pyarrow's CSV parser can read times that look like these; binary if in none."""
    samples = [text for text in samples if text]
    if time_format in PER_SECOND or (time_format is None and samples and all(map(_NUMBER.fullmatch, samples))):
        return pa.float64()
    if time_format is not None and ("%z" in time_format or "%f" in time_format):
        return pa.binary()  # pyarrow's strptime does not know these: one by one
    if time_format is None and any(map(_OFFSET.search, samples)):
        return pa.timestamp("us", tz="UTC")
    return pa.timestamp("us")


def parsers(time_format: str | None) -> list[Any]:
    """What pyarrow's CSV parser takes as ``timestamp_parsers``."""
    return [pyarrow.csv.ISO8601 if time_format is None or time_format in PER_SECOND else time_format]


def from_arrow(values: pa.Array, time_format: str | None) -> Floats:
    """``(n,)`` seconds of numbers (in the unit of the format), timestamps or dates; NaN for nulls.

    Raises:
        ValueError: they are none of these.
    """
    if pa.types.is_date(values.type):
        values = values.cast(pa.timestamp("s"))
    if pa.types.is_timestamp(values.type):
        return _scaled(values.cast(pa.int64()), PER_SECOND[values.type.unit])
    if pa.types.is_integer(values.type) or pa.types.is_floating(values.type):
        return _scaled(values, PER_SECOND.get(time_format or "s", 1))
    raise ValueError(f"times of type {values.type} are not understood")


def _scaled(values: pa.Array, per_second: int) -> Floats:
    return values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False) / per_second


def from_text(values: pa.Array, time_format: str | None) -> Floats:
    """``(n,)`` seconds of texts or bytes; NaN for those that are no time."""
    one_by_one = partial(formatted, time_format=time_format) if time_format else parse
    seconds, rest = np.full(len(values), np.nan), np.arange(len(values))
    if time_format is None:
        values = values.cast(pa.binary())
        plain = pc.match_substring_regex(values, PLAIN).fill_null(False)
        try:  # nearly all texts are like this, and are converted at once
            seconds = from_arrow(pc.if_else(plain, values, None).cast(pa.string()).cast(pa.timestamp("us")), None)
            rest = np.flatnonzero(~plain.to_numpy(zero_copy_only=False))
        except pa.ArrowInvalid:  # a day that is none, such as 31 February
            pass
    seconds = seconds.copy()
    seconds[rest] = [one_by_one(as_text(value)) for value in values.take(pa.array(rest)).to_pylist()]
    return seconds


def parse(value: Any) -> float:
    """Seconds of an ISO 8601 text or a number; NaN if it is neither."""
    seconds = number(value)
    if np.isnan(seconds) and isinstance(value, str):
        try:
            moment = datetime.fromisoformat(value)
            return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError):
            pass
    return seconds


def within(seconds: Any) -> Any:
    """Whether times lie in the years 1 to 9999; NaN does not."""
    return (seconds >= EARLIEST) & (seconds < LATEST)


def number(value: Any) -> float:
    """A number, or a text that is one, as it is; NaN for anything else."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value) if abs(value) < 1e300 else np.nan
    return float(value) if isinstance(value, str) and _NUMBER.fullmatch(value.strip()) else np.nan


def formatted(text: str, time_format: str) -> float:
    """Seconds of a text in a stated format; NaN if it is none."""
    try:
        if time_format in PER_SECOND:
            return float(text) / PER_SECOND[time_format]
        moment = datetime.strptime(text, time_format)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return np.nan
