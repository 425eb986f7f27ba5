"""When AIS sentences were received: what stands beside them, and the clocks of a log.

A number beside a sentence is taken for its time only if it can be one (2001 to 2100 in seconds, ms, us or ns) and goes
with the second of the minute that the message itself tells. Of several the one that goes best with it is taken.
"""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wakefold.io import times
from wakefold.io.report import Tally

ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?")
EPOCH = re.compile(r"(?<![\w.])(\d{10}(?:\.\d{1,9})?|\d{13}(?:\.\d{1,6})?|\d{16}|\d{19})(?![\w.])")
OF_DAY = re.compile(r"(?<!\w)t(\d{6}(?:\.\d{1,6})?)(?!\w)")
"""As the receivers of the US Coast Guard write the time of day: t050056.00."""
LONGEST = 200  # bytes of a sentence and what stands before it
EARLIEST = 1e9
RMC = re.compile(rb"\$..RMC,(\d{6}(?:\.\d*)?),A?,[^*]*?,(\d{2})(\d{2})(\d{2})(?:,[^*]*)?(?:\*([0-9A-F]{2}))?\s*$")
ZDA = re.compile(rb"\$..ZDA,(\d{6}(?:\.\d*)?),(\d{2}),(\d{2}),(\d{4})(?:,[^*]*)?(?:\*([0-9A-F]{2}))?\s*$")
ENOUGH = 5
"""Messages that tell their second, after which numbers are held to it."""
TOGETHER = 0.6
"""Length of the mean of differences on the circle of a minute, 1 if all are equal, near 0 if they are any."""
SEEN = 5000  # positions that decide
AGREE = "{n} positions have a number beside them that does not go with their second of the minute: no time"
SEVERAL = "{n} positions have several numbers beside them that could be times; the one nearest to their second is taken"
APART = "times beside the sentences are about {seconds:.0f} s off the seconds that the messages tell"


class Beside(NamedTuple):
    """What stands beside a sentence.

    Attributes:
        time: where it is stated, seconds; else NaN.
        numbers: that could be times, seconds.
        of_day: a time of day, seconds; else NaN.
    """

    time: float = math.nan
    numbers: tuple[float, ...] = ()
    of_day: float = math.nan

    @property
    def near(self) -> float:
        """A time that is near enough to tell days apart."""
        return self.time if self.time == self.time else self.numbers[0] if self.numbers else math.nan


def beside(before: str, behind: str, time_format: str | None) -> Beside:
    """What the texts before and behind a sentence tell of its time."""
    numbers: list[float] = []
    of_day = math.nan
    for text in (behind, before):
        text = text.strip(" \t,;|[]()")
        if not text:
            continue
        if time_format is not None:
            return Beside(times.formatted(text, time_format))
        if found := ISO.search(text):
            return Beside(times.parse(found[0]))
        numbers += [second for number in EPOCH.findall(text) if (second := in_seconds(float(number))) is not None]
        if match := OF_DAY.search(text):
            of_day = times.of_day(match[1])
    return Beside(numbers=tuple(numbers), of_day=of_day)


def in_seconds(stamp: float) -> float | None:
    """A number that is a date in seconds, ms, us or ns, in seconds."""
    for per_second in times.PER_SECOND.values():
        if EARLIEST <= stamp / per_second < times.YEAR_2100:
            return stamp / per_second
    return None


def clock_of(line: bytes) -> float:
    """The time that an RMC or ZDA sentence tells; NaN if it is none."""
    if len(line) > LONGEST:
        return math.nan
    if match := RMC.search(line):
        clock, day, month, year, check = match.groups()
        year = b"20" + year
    elif match := ZDA.search(line):
        clock, day, month, year, check = match.groups()
    else:
        return math.nan
    body = line[match.start() + 1 : line.rfind(b"*")] if check else b""
    if check and np.bitwise_xor.reduce(np.frombuffer(body, dtype=np.uint8)) != int(check, 16):
        return math.nan
    date = b"-".join((year, month, day)).decode()
    return times.day(date) + times.of_day(clock.decode().rstrip("."))


def away(time: float, second: float) -> float:
    """Seconds from the nearest moment with this second of the minute to a time: -30 to 30."""
    return (time - second + 30) % 60 - 30


class Stamps:
    """Which of the numbers beside sentences are their times; the first positions decide, for each count of numbers."""

    def __init__(self, tally: Tally) -> None:
        self.tally = tally
        self._chosen: dict[int, int] = {}

    def resolve(self, found: Sequence[tuple[Beside, float]]) -> list[float]:
        """Times of positions, each with what stands beside it and its own second (NaN if it tells none)."""
        for count in {len(one.numbers) for one, _ in found if one.numbers} - self._chosen.keys():
            self._choose(count, [(one, second) for one, second in found if len(one.numbers) == count][:SEEN])
        out = []
        for one, second in found:
            time = one.time
            if one.numbers:
                chosen = self._chosen[len(one.numbers)]
                time = one.numbers[chosen] if chosen >= 0 else math.nan
                self.tally.note(AGREE, chosen < 0)
                self.tally.note(SEVERAL, chosen >= 0 and len(set(one.numbers)) > 1)
                if one.of_day == one.of_day and chosen >= 0:
                    time = _refined(time, one.of_day, second)
            out.append(time)
        return out

    def _choose(self, count: int, found: Sequence[tuple[Beside, float]]) -> None:
        ranked = []
        for k in range(count):
            off = [away(one.numbers[k], second) for one, second in found if second == second]
            mean = sum(cmath.exp(2j * math.pi * value / 60) for value in off) / len(off) if off else 1.0
            minutes = all(one.numbers[k] % 60 == 0 for one, _ in found)
            if len(off) >= ENOUGH and abs(mean) < TOGETHER and not minutes:
                continue
            middle = abs(cmath.phase(mean)) * 60 / (2 * math.pi)
            ranked.append((middle, k, len(off) >= ENOUGH and middle > 15))
        ranked.sort()
        self._chosen[count] = ranked[0][1] if ranked else -1
        if ranked and ranked[0][2]:
            self.tally.note(APART.format(seconds=ranked[0][0]))


def _refined(time: float, of_day: float, second: float) -> float:
    """The moment near a time at a time of day, if it goes no worse with the message's own second."""
    near = time + (of_day - time % 86_400 + 43_200) % 86_400 - 43_200
    if abs(near - time) > 120 or (second == second and abs(away(near, second)) > abs(away(time, second))):
        return time
    return near


def clocked(clock: float, second: float) -> float:
    """The time nearest to the clock at which the seconds are ``second`` (NaN: the message tells none)."""
    return clock - away(clock, second) if second == second else clock
