"""Times of files as seconds (UTC, since 1970): ISO 8601, a strptime format, or numbers in a unit.

A ``time_format`` is None (ISO 8601 text, or numbers that are seconds), one of the units "s", "ms", "us", "ns" for
numbers since 1970, "days" for the day serials of spreadsheets (since 1899-12-30), or a strptime format such as
``%d/%m/%Y %H:%M:%S``. Times without an offset are UTC.
"""

# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from wakefold.base.types import Floats
from wakefold.io.records import as_text

PER_SECOND = {"s": 1, "ms": 1000, "us": 10**6, "ns": 10**9}
"""Units of numeric times."""
SERIAL = "days"
SERIAL_OF_1970 = 25_569  # days from 1899-12-30, from which spreadsheets count
UNITS = (*PER_SECOND, SERIAL)
EARLIEST, LATEST = -62_135_596_800.0, 253_402_300_800.0
"""The years 1 to 9999. Nothing else is a time: it is a damaged line, or not in seconds."""
YEAR_2100 = 4_102_444_800.0
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
PLAIN = r"^\d{4}-\d\d-\d\d[T ][0-2]\d:[0-5]\d:[0-5]\d(\.\d{1,6})?$"
ZONE = re.compile(r" ?(UTC|GMT|Z)$")
_OFFSET = re.compile(r"\d(Z|[+-]\d\d:?\d\d)$")
_CLOCK = re.compile(r"(\d{1,2}):(\d\d)(?::(\d\d(?:[.,]\d*)?))?\s*([AaPp])?[Mm]?Z?")
_DIGITS_14 = re.compile(r"(19|20)\d{12}")
_DIGITS = re.compile(r"\d{1,6}(\.\d*)?")


def arrow_type(samples: Sequence[str], time_format: str | None) -> pa.DataType:
    """The type in which pyarrow's CSV parser can read times that look like these; binary if in none."""
    samples = [text for text in samples if text]
    if time_format in UNITS or (time_format is None and samples and all(map(_NUMBER.fullmatch, samples))):
        return pa.float64()
    if time_format is not None and ("%z" in time_format or "%f" in time_format):
        return pa.binary()  # pyarrow's strptime does not know these: one by one
    if time_format is None and any(map(_OFFSET.search, samples)):
        return pa.timestamp("us", tz="UTC")
    return pa.timestamp("us")


def parsers(time_format: str | None) -> list[Any]:
    """What pyarrow's CSV parser takes as ``timestamp_parsers``."""
    return [pyarrow.csv.ISO8601 if time_format is None or time_format in UNITS else time_format]


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
        if time_format == SERIAL:
            return of_serials(_scaled(values, 1))
        return _scaled(values, PER_SECOND.get(time_format or "s", 1))
    raise ValueError(f"times of type {values.type} are not understood")


def _scaled(values: pa.Array, per_second: int) -> Floats:
    return values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False) / per_second


def of_serials(days: Any) -> Any:
    """Seconds of the day serials of a spreadsheet, to the millisecond: their last digit is about a microsecond."""
    return np.round((days - SERIAL_OF_1970) * 86_400.0, 3)


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
    if seconds > LATEST and (match := _DIGITS_14.fullmatch(str(value))):  # 20240501100000, and no number of seconds
        return formatted(match[0], "%Y%m%d%H%M%S")
    if np.isnan(seconds) and isinstance(value, str):
        try:
            moment = datetime.fromisoformat(ZONE.sub("", value))
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
        if time_format == SERIAL:
            return float(of_serials(number(text.replace(",", "."))))
        if time_format in PER_SECOND:
            return float(text.replace(",", ".")) / PER_SECOND[time_format]
        moment = datetime.strptime(text, time_format)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return np.nan


def from_days(days: pa.Array, clocks: pa.Array, time_format: str | None, hhmm: bool = False) -> Floats:
    """``(n,)`` seconds of texts of dates and texts of times of day; NaN where either is none.

    Args:
        time_format: of a date, a blank and a time of day; if not given, see ``day`` and ``of_day``.
        hhmm: times of day of four digits have no seconds.
    """
    if time_format is not None:
        pairs = zip(days.to_pylist(), clocks.to_pylist(), strict=True)
        return np.array([formatted(f"{as_text(d)} {as_text(c)}", time_format) for d, c in pairs])

    def each(values: pa.Array, read: Any) -> Floats:
        encoded = values.dictionary_encode()
        table = np.array([*(read(as_text(value)) for value in encoded.dictionary.to_pylist()), np.nan])
        return table[encoded.indices.fill_null(len(table) - 1).to_numpy(zero_copy_only=False)]

    return each(days, day) + each(clocks, partial(of_day, hhmm=hhmm))


class Moment(NamedTuple):
    """A date and a time of day in two fields."""

    day: str
    of_day: str

    def __str__(self) -> str:
        return f"{self.day} {self.of_day}"

    @property
    def seconds(self) -> float:
        return day(self.day) + of_day(self.of_day)


def day(text: str) -> float:
    """Seconds of the midnight at which a day begins: 2024-05-01, 2024/05/01, 20240501; NaN of anything else."""
    whole = text.removesuffix(".0")
    if re.fullmatch(r"\d{8}", whole):
        whole = f"{whole[:4]}-{whole[4:6]}-{whole[6:]}"
    elif re.fullmatch(r"\d{4}[/.]\d{1,2}[/.]\d{1,2}", whole):
        whole = "-".join(part.zfill(2) for part in re.split("[/.]", whole))
    seconds = parse(whole) if "-" in whole[1:] else np.nan
    return seconds if seconds % 86_400 == 0 else np.nan


def of_day(text: str, hhmm: bool = False) -> float:
    """Seconds since midnight of 10:15:30, 10:15, 3:05 PM, or the digits 101530 (and 80500, 8:05:00); NaN of others."""
    if match := _CLOCK.fullmatch(text):
        hour, minute, second = int(match[1]), int(match[2]), float((match[3] or "0").replace(",", "."))
        if match[4]:
            hour = hour % 12 + (12 if match[4] in "Pp" else 0) if 1 <= hour <= 12 else 99
    elif match := _DIGITS.fullmatch(text):
        whole, _, part = text.partition(".")
        whole = whole.zfill(4) + "00" if hhmm else whole.zfill(6)
        hour, minute, second = int(whole[:-4]), int(whole[-4:-2]), float(f"{whole[-2:]}.{part or 0}")
    else:
        return np.nan
    return hour * 3600.0 + minute * 60.0 + second if hour < 24 and minute < 60 and second < 61 else np.nan
