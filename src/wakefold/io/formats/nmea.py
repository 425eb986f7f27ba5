"""Logs of AIS sentences (NMEA 0183 ``!AIVDM``), decoded by pyais.

A sentence may have a tag block before it (``\\c:1609459200*5A\\``: seconds since 1970), a time before it or behind its
checksum (seconds since 1970, or ISO 8601), or a Gatehouse line ahead of it. Where a position has none of these, the
clock of the last base station heard (message 4) gives the minute and the message itself the second.

Rows are the messages that report a position (1, 2, 3, 18, 19, 27), and whatever is damaged. Static messages (5, 19, 24)
give the attributes of ships; other messages are counted in a note.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
from pyais.exceptions import AISBaseException
from pyais.messages import AISSentence, GatehouseSentence, NMEASentenceFactory

from wakefold.io import times
from wakefold.io.formats import ais
from wakefold.io.records import Rows, Static, as_text
from wakefold.io.report import Tally
from wakefold.io.source import Source

POSITIONS = (1, 2, 3, 18, 19, 27)
STATIC = (5, 19, 24)
BASE_STATION = 4
LINE = re.compile(rb"([^!\\]*)(\\[^\\]*\\)?\s*(![A-Z]{2}VD[MO],[^*!]*\*[0-9A-F]{2})(.*)", re.IGNORECASE | re.DOTALL)
"""What stands before, a tag block, the sentence, what stands behind."""
SENTENCE = re.compile(rb"VD[MO],", re.IGNORECASE)
ISO = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?")
EPOCH = re.compile(r"(?<![\w.])(\d{9,10}(?:\.\d+)?|\d{12,13})(?![\w.])")
TEXTS = ("name", "callsign", "type", "destination")
BATCH = 50_000
OPEN_MESSAGES = 1000
"""Messages of several sentences that may be unfinished at once; a receiver has ten numbers for them."""


def read(source: Source, tally: Tally, time_format: str | None) -> Iterator[Rows | Static]:
    """Batches of positions, and of what static messages say.

    Args:
        time_format: how times before or behind a sentence are written, if not as said above.
    """
    log = _Log(tally, time_format)
    for number, line in source.lines():
        log.take(number, line)
        if len(log.positions) >= BATCH:
            yield from log.batches()
    log.close()
    yield from log.batches()


class _Log:
    """What is remembered from line to line."""

    def __init__(self, tally: Tally, time_format: str | None) -> None:
        self.tally, self.time_format = tally, time_format
        self.positions: list[tuple[int, str, Any, float]] = []  # line number, its text, message, time
        self.static: list[dict[str, Any]] = []
        self.open: dict[tuple[Any, ...], list[tuple[int, str, AISSentence, float]]] = {}
        self.clock = np.nan
        self.wrapped = np.nan  # the time of a Gatehouse line, for the sentence that follows it
        self.others: Counter[int] = Counter()

    def take(self, number: int, line: bytes) -> None:
        """Take up one line of the log."""
        match = LINE.fullmatch(line)
        if match is None:
            if line.startswith(b"$PGHP"):
                self._wrapper(line)
            elif SENTENCE.search(line):
                self._bad("bad line", number, as_text(line))
            else:
                self.tally.note("{n} lines are no AIS sentences")
            return
        before, tag, raw, behind = match.groups(b"")
        try:
            sentence = NMEASentenceFactory.produce(tag + raw)
        except (AISBaseException, ValueError, IndexError):
            self._bad("bad line", number, as_text(line))
            return
        if not isinstance(sentence, AISSentence):
            return
        if not sentence.is_valid:
            self._bad("bad checksum", number, as_text(line))
            return
        time = self._time(sentence, as_text(before), as_text(behind))
        if sentence.frag_cnt == 1:
            self._message(number, as_text(line), sentence, time)
        else:
            self._fragment(number, as_text(line), sentence, time)

    def _bad(self, reason: str, number: int, text: str) -> None:
        self.tally.rows += 1
        self.tally.reject(reason, 1, [(number, text)])

    def _wrapper(self, line: bytes) -> None:
        try:
            sentence = NMEASentenceFactory.produce(line)
        except (AISBaseException, ValueError, IndexError):
            return
        if isinstance(sentence, GatehouseSentence):
            self.wrapped = times.parse(sentence.timestamp.isoformat())

    def _time(self, sentence: AISSentence, before: str, behind: str) -> float:
        """When a sentence was received; NaN if the line does not tell."""
        if sentence.tag_block is not None:
            sentence.tag_block.init()
            if sentence.tag_block.is_valid and (stamp := sentence.tag_block.receiver_timestamp):
                return _seconds(times.parse(stamp))
        for text in (behind, before):
            text = text.strip(" \t,;|[]()")
            if not text:
                continue
            if self.time_format is not None:
                return times.formatted(text, self.time_format)
            if found := ISO.search(text):
                return times.parse(found[0])
            if found := EPOCH.findall(text):
                return _seconds(float(found[-1]))
        time, self.wrapped = self.wrapped, np.nan
        return time

    def _fragment(self, number: int, text: str, sentence: AISSentence, time: float) -> None:
        """Keep a part of a message until the others have come; they come in order, or the message is lost."""
        key = (sentence.seq_id, sentence.channel, sentence.talker, sentence.frag_cnt)
        parts = self.open.pop(key, [])
        if sentence.frag_num != len(parts) + 1:
            for part in parts or [(number, text, sentence, time)]:
                self._bad("incomplete message", part[0], part[1])
                break
            parts = []
            if sentence.frag_num != 1:
                return
        parts.append((number, text, sentence, time))
        if len(parts) == sentence.frag_cnt:
            stamped = [part[3] for part in parts if not np.isnan(part[3])]
            whole = AISSentence.assemble_from_iterable([part[2] for part in parts])
            self._message(number, text, whole, stamped[0] if stamped else np.nan)
            return
        self.open[key] = parts
        if len(self.open) > OPEN_MESSAGES:
            first = self.open.pop(next(iter(self.open)))[0]
            self._bad("incomplete message", first[0], first[1])

    def close(self) -> None:
        """The log is at its end."""
        for parts in self.open.values():
            self._bad("incomplete message", parts[0][0], parts[0][1])
        self.open.clear()
        for kind, count in sorted(self.others.items()):
            self.tally.note(f"{{n}} messages of type {kind} hold no position of a ship", count)

    def _message(self, number: int, text: str, sentence: AISSentence, time: float) -> None:
        """Decode a whole message."""
        kind = sentence.ais_id
        if kind not in POSITIONS and kind not in STATIC and kind != BASE_STATION:
            self.others[kind] += 1
            return
        try:
            message: Any = sentence.decode()
        except (AISBaseException, ValueError, IndexError, TypeError):
            self._bad("bad message", number, text)
            return
        if kind == BASE_STATION:
            self.clock = _clock(message, self.clock)
            self.others[kind] += 1
            return
        if kind in STATIC:
            self.static.append(_described(message))
            self.tally.note("{n} static messages describe ships", kind != 19)
        if kind in POSITIONS:
            if np.isnan(time) and not np.isnan(self.clock):
                time = _clocked(self.clock, getattr(message, "second", None))
                self.tally.note("{n} positions are timed by the clock of a base station (message 4)")
            self.positions.append((number, text, message, time))

    def batches(self) -> Iterator[Rows | Static]:
        """What has come together since the last call."""
        if self.static:
            agents = pa.array([known.pop("agent") for known in self.static])
            texts = {n: pa.array([k[n] for k in self.static], pa.string()) for n in TEXTS}
            sizes = {n: np.array([k[n] or np.nan for k in self.static]) for n in ("length", "width")}
            yield Static(agents, texts | sizes)
        if self.positions:
            numbers, texts, messages, stamps = zip(*self.positions, strict=True)

            def values(name: str, far: float = np.nan) -> np.ndarray:
                """A field of all messages; ``far`` is "not available" in the long-range message 27."""
                found = [getattr(m, name, None) for m in messages]
                return np.array(
                    [
                        np.nan if value is None or (value == far and m.msg_type == 27) else float(value)
                        for value, m in zip(found, messages, strict=True)
                    ]
                )

            yield Rows(
                agent=pa.array([int(m.mmsi) for m in messages]),
                time=np.array(stamps, dtype=np.float64),
                position=(values("lon"), values("lat")),
                geodetic=True,
                lines=np.array(numbers),
                text=texts.__getitem__,
                columns=ais.motion(values("speed", far=63), values("course"), values("heading")),
            )
        self.positions, self.static = [], []


def _seconds(stamp: float) -> float:
    """Some receivers write milliseconds."""
    return stamp / 1000 if stamp > 1e11 else stamp


def _clock(message: Any, before: float) -> float:
    """Time of a base station report; the one before it if this one is not set."""
    fields = (message.year, message.month, message.day, message.hour, message.minute, message.second)
    if None in fields or not message.year:
        return before
    time = times.parse("{:04d}-{:02d}-{:02d}T{:02d}:{:02d}:{:02d}".format(*fields))
    return before if np.isnan(time) else time


def _clocked(clock: float, second: int | None) -> float:
    """The time nearest to the clock at which the seconds are ``second`` (0 to 59; others mean "not available")."""
    if second is None or second > 59:
        return clock
    return clock + (second - clock % 60 + 30) % 60 - 30


def _described(message: Any) -> dict[str, Any]:
    """What a static message says of its ship; zeros and empty texts mean "not available"."""
    known: dict[str, Any] = {"agent": int(message.mmsi)}
    for ours, theirs in (("name", "shipname"), ("callsign", "callsign"), ("destination", "destination")):
        known[ours] = getattr(message, theirs, None)
    kind = getattr(message, "ship_type", None)
    known["type"] = str(int(kind)) if kind else None
    for ours, parts in (("length", ("to_bow", "to_stern")), ("width", ("to_port", "to_starboard"))):
        known[ours] = float(sum(getattr(message, part, None) or 0 for part in parts)) or None
    return known
