"""Which column of a table is the time, by what stands in it: a time is taken only if the values can be times.

What can be read in two ways is refused with the two, never guessed: seconds of the minute, times of day without a
date, 1/11/2023. A sample, the first rows of a file, decides.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from wakefold.io import times
from wakefold.io.records import plain
from wakefold.io.report import ReadError, some

NAMES = (
    "time", "t", "timestamp", "datetime", "basedatetime", "ts", "epoch", "unixtime", "unixtimestamp", "epochtime",
    "posixtime", "gpstime", "utc", "received", "receivedat", "rxuxtime", "rxtime", "rectime", "recordedat", "date",
    "when", "frame", "frameid", "frameno", "framenumber", "frames",
)  # fmt: skip
"""Names of columns of times, without "utc" or "gmt" at either end and a unit behind; the first that can be one is."""
FRAMES = ("frame", "frameid", "frameno", "framenumber", "frames")
UNIT = re.compile(r"(.*?)(ms|us|ns|millis|micros|nanos|millisecond|microsecond|nanosecond)s?")
UNIT_NAMES = {"millis": "ms", "micros": "us", "nanos": "ns"}
UNIT_NAMES |= {"millisecond": "ms", "microsecond": "us", "nanosecond": "ns"}
TIMELY = re.compile(r"time|date|stamp|utc|epoch|clock|hour|when")
LARGEST = 1e25
MOST, HALF = 0.9, 0.5
"""Share of the values that must be of a kind, as some lines of any file are damaged; of the likeliest if none is."""
DATES = 1e9, times.YEAR_2100
"""Seconds since 1970 that are taken for dates, from 2001 on."""
SERIALS = 25_569.0, 73_415.0
"""Days since 1899-12-30 of the years 1970 to 2100."""
DATED = ("moment", "day", "written", "date number", "clock", "serial", "yyyymmddhhmmss")
APART = re.compile(r"birth|built|eta|arriv|depart|update|expir|valid|modif|creat")
"""Names of columns of dates that are not those of a position."""
DAILY = re.compile(r"date|day|dmy|ymd|mdy|utc")
_WRITTEN = re.compile(
    r"(\d{1,4})([/.-])(\d{1,2})\2(\d{1,4})(?:([ T])(\d{1,2}):(\d\d)(?::(\d\d)([.]\d+)?)?( ?[AaPp][Mm])?)?"
)
_COMMA = re.compile(r"(?<=^\d{5}),(?=\d+$)")
"""Of day serials where numbers have a decimal comma."""
_MOMENT = re.compile(r"\d{4}-?\d\d-?\d\d[T ]\d")

Sample = Sequence[Sequence[str]]


class Clock(NamedTuple):
    """Where the time of a table stands: a column, or one of the date and one of the time of day.

    Attributes:
        columns: one index or two.
        form: ``time_format``.
        hhmm: times of day are digits without seconds.
    """

    columns: tuple[int, ...]
    form: str | None = None
    hhmm: bool = False


def stem(name: str) -> tuple[str, str | None]:
    """A name of a column without what stands for UTC and for a unit, and the unit."""
    text = plain(name)
    for zone in ("utc", "gmt"):
        if text != zone:
            text = text.removeprefix(zone).removesuffix(zone)
    if (match := UNIT.fullmatch(text)) and match[1] in NAMES and text not in NAMES:
        return match[1], UNIT_NAMES.get(match[2], match[2])
    return text, None


def kind(values: Sequence[str]) -> str:
    """What texts are: "none", "moment", "day", "clock" (10:15), "written" (1/11/2023), "serial", "second" (of the
    minute), "hhmmss", "date number" (seconds, ms, us or ns since 1970), "number" or "other"."""
    known = [_COMMA.sub(".", value.strip()) for value in values if value.strip()]
    if not known:
        return "none"
    numbers = np.array([times.number(value) for value in known])
    finite = np.abs(numbers) < LARGEST  # NaN is not
    tests: dict[str, Callable[[str], object]] = {
        "moment": lambda text: _MOMENT.match(text) and times.parse(text) == times.parse(text),
        "day": lambda text: times.day(text) == times.day(text),
        "clock": lambda text: ":" in text and times.of_day(text) == times.of_day(text),
        "written": _WRITTEN.fullmatch,
    }
    share = {name: sum(map(bool, map(test, known))) / len(known) for name, test in tests.items()}
    enough = (name for least in (MOST, HALF) for name in share if share[name] >= least)
    best = next(enough, "other")
    if finite.mean() >= MOST or (finite.mean() >= HALF and finite.mean() > share.get(best, 0.0)):
        return _kind_of_numbers([text for text, good in zip(known, finite, strict=True) if good], numbers[finite])
    return best


def _kind_of_numbers(texts: Sequence[str], numbers: np.ndarray) -> str:
    def most(found: Iterable[object]) -> bool:
        return sum(map(bool, found)) >= MOST * len(texts)

    if most((numbers % 1 == 0) & (numbers >= 0) & (numbers <= 63)):
        return "second"
    if most(len(text.removesuffix(".0")) == 8 and times.day(text) == times.day(text) for text in texts):
        return "day"
    if most(re.fullmatch(r"(19|20)\d{12}", text) for text in texts):
        return "yyyymmddhhmmss"
    for per_second in times.PER_SECOND.values():
        if most((numbers >= DATES[0] * per_second) & (numbers < DATES[1] * per_second)):
            return "date number"
    six = [text for text in texts if re.fullmatch(r"\d{6}(\.\d*)?", text) and times.of_day(text) == times.of_day(text)]
    if len(six) >= MOST * len(texts) and (len(set(six)) >= 3 or any(text.startswith("0") for text in six)):
        return "hhmmss"
    # Days of a spreadsheet: of our time, some written with many digits, each a whole second.
    fine = any(len(text.partition(".")[2].rstrip("0")) >= 5 for text in texts)
    seconds = numbers * 86_400
    whole = np.abs(seconds - np.round(seconds)) < 0.1
    return "serial" if fine and most(whole & (numbers >= SERIALS[0]) & (numbers < SERIALS[1])) else "number"


def chosen(
    source: str,
    names: Sequence[str],
    sample: Sample,
    who: int | None,
    taken: set[int],
    form: str | None,
    geodetic: bool,
) -> tuple[Clock | None, list[str]]:
    """The time of a table whose caller does not name it, and notes on how it was found.

    Args:
        who: the column of the agents.
        taken: columns that are something else.
        form: ``time_format`` as the caller states it: then the values are not questioned.
        geodetic: positions are degrees.

    Raises:
        ReadError: a column named like a time cannot be one; or none is, and there are columns that could be.
    """
    free = [i for i in range(len(names)) if i not in taken]
    ranked = sorted((NAMES.index(stem(names[i])[0]), i) for i in free if stem(names[i])[0] in NAMES)
    kinds = {i: kind(sample[i]) for i in free}
    why: list[str] = []
    for _, i in ranked:
        name, unit = stem(names[i])
        other = _partner(names, sample, kinds, i)
        if kinds[i] != "day" and other is not None:
            return joined(source, (other, i), sample, form), [f"times are {names[other]} and {names[i]} together"]
        if kinds[i] == "day" and other is not None:
            return joined(source, (i, other), sample, form), [f"times are {names[i]} and {names[other]} together"]
        if form is not None:
            return Clock((i,), form), []
        if reason := _against(names, sample, kinds, i, who, geodetic):
            why.append(f"{names[i]} {reason}")
            continue
        clock, notes = _taken(source, names, sample, kinds, i, unit)
        if name in FRAMES:
            notes.append(f"{names[i]} is taken for seconds: speeds are those per frame")
        if why:
            notes.append(f"{names[i]} is the time: {'; '.join(why)}")
        return clock, notes
    if form is None and len(moments := [i for i in free if kinds[i] == "moment"]) == 1 and why:
        return Clock((moments[0],)), [f"{names[moments[0]]} is the time: {'; '.join(why)}"]
    could = [i for i in free if kinds[i] in DATED]
    could += [i for i in free if i not in could and TIMELY.search(plain(names[i])) and kinds[i] != "none"]
    if why or could or form is not None:
        named = {i for _, i in ranked}
        others = [names[i] for i in could if i not in named] or [names[i] for i in free if i not in named]
        if not others:
            because = "; ".join(why) or "no column can be the time"
            raise ReadError(f"{source}: {because}; say how times are written by time_format (--time-format)")
        because = f" ({'; '.join(why)})" if why else ""
        raise ReadError(
            f"{source}: which column is time{because}? There are {some(others)}; give columns (--columns time=...)"
        )
    return None, []


def _partner(names: Sequence[str], sample: Sample, kinds: dict[int, str], i: int) -> int | None:
    """The column of the dates that belong to times of day, or of the times of day that belong to dates."""
    day = kinds[i] == "day"
    if not day and not (kinds[i] in ("clock", "hhmmss", "number", "second") and _of_day(sample[i])):
        return None
    for j, other in kinds.items():
        text = plain(names[j])
        if j == i or APART.search(text):
            continue
        if day and (other in ("clock", "hhmmss") or ("hhmm" in text and _of_day(sample[j]))):
            return j
        if not day and (other == "day" or (other == "written" and DAILY.search(text))):
            return j
    return None


def _of_day(values: Sequence[str]) -> bool:
    """Whether nearly all values can be times of day."""
    known = [text for value in values if (text := value.strip())]
    return sum(times.of_day(text) >= 0 for text in known) >= MOST * len(known)


def _against(
    names: Sequence[str], sample: Sample, kinds: dict[int, str], i: int, who: int | None, geodetic: bool
) -> str | None:
    """Why a column named like a time is none."""
    if kinds[i] == "clock" or (kinds[i] == "hhmmss" and geodetic):
        return "holds times of day without a date; if they are seconds, --time-format s"
    if kinds[i] == "other":
        return f"holds no times, such as {_shown(sample[i])}"
    name = stem(names[i])[0]
    if kinds[i] != "second" or name in FRAMES or not (geodetic or name == "timestamp"):
        return None
    ais = who is not None and plain(names[who]) == "mmsi" and name == "timestamp"
    dates = any(kinds[j] in ("moment", "date number") for j in kinds if j != i)
    if ais or dates or _back(sample[i], sample[who] if who is not None else None):
        return "holds numbers from 0 to 63, as the seconds of a minute in AIS; if it is the time, --time-format s"
    return None


def _back(values: Sequence[str], agents: Sequence[str] | None) -> bool:
    """Whether times of an agent ever go back."""
    last: dict[str, float] = {}
    for agent, value in zip(agents or [""] * len(values), values, strict=True):
        seconds = times.number(value)
        if seconds < last.get(agent, seconds):
            return True
        last[agent] = seconds
    return False


def _taken(
    source: str, names: Sequence[str], sample: Sample, kinds: dict[int, str], i: int, unit: str | None
) -> tuple[Clock, list[str]]:
    """A column whose values can be times, and how they are read."""
    name = names[i]
    if kinds[i] == "written":
        form = written(sample[i])
        if form is None:
            raise ReadError(
                f"{source}: {name} such as {_shown(sample[i])} can be read in more than one way; say how by "
                "time_format (--time-format), such as %d/%m/%Y %H:%M"
            )
        return Clock((i,), form), [f"times such as {_shown(sample[i])} are read as {form}"]
    if kinds[i] == "serial":
        return Clock((i,), times.SERIAL), [f"{name} holds days since 1899-12-30, as spreadsheets write dates"]
    if kinds[i] == "yyyymmddhhmmss":
        return Clock((i,), "%Y%m%d%H%M%S"), []
    if kinds[i] == "day" and re.fullmatch(r"\d{8}", _first(sample[i])):
        return Clock((i,), "%Y%m%d"), []
    return Clock((i,), unit), []


def stated(source: str, names: Sequence[str], sample: Sample, i: int, form: str | None) -> tuple[Clock, list[str]]:
    """A column that the caller names as the time, and notes on how its values are read.

    Raises:
        ReadError: they can be read in more than one way, and the caller does not say which.
    """
    if form is not None:
        return Clock((i,), form), []
    kinds = {i: kind(sample[i])}
    return _taken(source, names, sample, kinds, i, stem(names[i])[1])


def form_of(source: str, name: str, values: Sequence[str]) -> tuple[str | None, list[str]]:
    """The ``time_format`` of a column that is known to be the time, and notes on it.

    Raises:
        ReadError: its values can be read in more than one way.
    """
    clock, notes = _taken(source, [name], [values], {0: kind(values)}, 0, None)
    return clock.form, notes


def _first(values: Sequence[str]) -> str:
    return next(value.strip() for value in values if value.strip())


def _shown(values: Sequence[str]) -> str:
    return repr(_first(values)[:40])


def joined(source: str, pair: tuple[int, int], sample: Sample, form: str | None) -> Clock:
    """Dates and times of day in two columns; the format of dates such as 31/12/2023 from the sample."""
    if form is None and kind(sample[pair[0]]) == "written":
        form = written([f"{a.strip()} {b.strip()}" for a, b in zip(*(sample[k] for k in pair), strict=True)])
        if form is None:
            raise ReadError(
                f"{source}: dates such as {_shown(sample[pair[0]])} can be read in more than one way; say how by "
                "time_format (--time-format) of date, blank and time, such as %d/%m/%Y %H:%M:%S"
            )
    digits = [text.strip() for text in sample[pair[1]] if text.strip()]
    return Clock(pair, form, hhmm=all(re.fullmatch(r"\d{4}", text) for text in digits))


def written(values: Sequence[str]) -> str | None:
    """The strptime format of times such as 31/12/2023 23:59, if the sample leaves one only."""
    matches = [_WRITTEN.fullmatch(text) for value in values if (text := value.strip())]
    good = [match for match in matches if match is not None]
    if not good or len(good) < HALF * len(matches):
        return None
    shapes = {(len(m[1]) == 4, m[2], len(m[4]), m[5], m[6] is not None, m[8] is not None, m[9] is not None, bool(m[10]))
              for m in good}  # fmt: skip
    if len(shapes) > 1:
        return None
    match = good[0]
    firsts, seconds = [int(m[1]) for m in good], [int(m[3]) for m in good]
    separator = match[2]
    if len(match[1]) == 4:
        date = separator.join(("%Y", "%m", "%d"))
    elif len(match[4]) != 4 or (max(firsts) > 12) == (max(seconds) > 12):
        return None  # of two digits everything may be the year; and day and month may be either
    else:
        date = separator.join(("%d", "%m", "%Y") if max(firsts) > 12 else ("%m", "%d", "%Y"))
    if match[6] is None:
        return date
    hour = "%I" if match[10] else "%H"
    clock = f"{hour}:%M" + (":%S" if match[8] else "") + (".%f" if match[9] else "")
    half = "" if not match[10] else " %p" if match[10].startswith(" ") else "%p"
    return f"{date}{match[5]}{clock}{half}"
