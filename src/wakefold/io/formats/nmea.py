"""Logs of AIS sentences (NMEA 0183 ``!AIVDM``), decoded by pyais.

A sentence may have a tag block before it (``\\c:1609459200*5A\\``: seconds since 1970), a time before it or behind its
checksum (``nmea_times``), or a Gatehouse line ahead of it. Where a position has none of these, a clock in the log (base
stations' message 4, or RMC and ZDA of the own ship) gives the minute and the message itself the second.

Rows are the messages that report a position (1, 2, 3, 18, 19, 27), and whatever is damaged. Static messages (5, 19, 24)
give the attributes of ships; other messages are counted in a note.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from pyais.exceptions import AISBaseException
from pyais.messages import AISSentence, GatehouseSentence, NMEASentenceFactory

from wakefold.io import times
from wakefold.io.formats import ais
from wakefold.io.formats.nmea_times import Beside, Stamps, beside, clock_of, clocked, in_seconds
from wakefold.io.records import Rows, Static, as_text
from wakefold.io.report import Tally
from wakefold.io.source import Source

POSITIONS = (1, 2, 3, 18, 19, 27)
STATIC = (5, 19, 24)
BASE_STATION = 4
LINE = re.compile(rb"([^!\\]*)(\\[^\\]*\\)?\s*(![A-Z]{2}VD[MO],[^*!]*\*[0-9A-F]{2})(.*)", re.IGNORECASE | re.DOTALL)
"""What stands before, a tag block, the sentence, what stands behind."""
SENTENCE = re.compile(rb"VD[MO],", re.IGNORECASE)
SENDER = re.compile(r"(?<!\w)r(\w{3,15})(?!\w)")
"""The station behind a sentence of the US Coast Guard."""
TEXTS = ("name", "callsign", "type", "destination")
BATCH = 50_000
OPEN_MESSAGES = 1000
"""Messages of several sentences that may be unfinished at once; a receiver has ten numbers for them."""
LONGEST_MESSAGE = 60.0
"""Seconds from the first part of a message to the last: they come within seconds, and numbers come again."""
AHEAD = 1000
"""Positions before the first clock of a log that are timed by it."""
LONGEST = 4096
"""Bytes of a line: a sentence has 82, and what is written beside it some hundred."""
STEP = 15.0
"""Seconds by which a message may set the clock on."""


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


class _Part(NamedTuple):
    """One sentence of a message of several."""

    number: int
    text: str
    sentence: AISSentence
    beside: Beside
    clock: float

    @property
    def near(self) -> float:
        return self.beside.near if self.beside.near == self.beside.near else self.clock


class _Log:
    """What is remembered from line to line."""

    def __init__(self, tally: Tally, time_format: str | None) -> None:
        self.tally, self.time_format = tally, time_format
        self.positions: list[tuple[int, str, Any, Beside]] = []  # line number, its text, message, time
        self.static: list[dict[str, Any]] = []
        self.open: dict[tuple[Any, ...], list[_Part]] = {}
        self.senders: dict[tuple[Any, ...], str | None] = {}  # of whom the last part without a sender may be
        self.stamps = Stamps(tally)
        self.clock, self.clocks = np.nan, ""
        self.wrapped = np.nan  # the time of a Gatehouse line, for the sentence that follows it
        self.others: Counter[int] = Counter()

    def take(self, number: int, line: bytes) -> None:
        """Take up one line of the log."""
        if len(line) > LONGEST:
            self._bad("bad line", number, as_text(line[:LONGEST]))
            return
        match = LINE.fullmatch(line)
        if match is None:
            if line.startswith(b"$PGHP"):
                self._wrapper(line)
            elif SENTENCE.search(line):
                self._bad("bad line", number, as_text(line))
            elif (time := clock_of(line)) == time:
                self._set_clock(time, "RMC and ZDA sentences")
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
        time, sender = self._beside(sentence, as_text(before), as_text(behind))
        if sentence.frag_cnt == 1:
            self._message(number, as_text(line), sentence, time)
        else:
            self._fragment(_Part(number, as_text(line), sentence, time, self.clock), sender)

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

    def _beside(self, sentence: AISSentence, before: str, behind: str) -> tuple[Beside, str | None]:
        """What the line tells of when a sentence was received, and by which station."""
        station = SENDER.search(behind)
        sender = station[1] if station else None
        if sentence.tag_block is not None:
            sentence.tag_block.init()
            if sentence.tag_block.is_valid:
                sender = sentence.tag_block.source_station or sender
                if stamp := sentence.tag_block.receiver_timestamp:
                    time = times.parse(stamp)
                    return Beside(in_seconds(time) or time), sender
        found = beside(before, behind, self.time_format)
        if found.near != found.near and self.time_format is None:
            found = Beside(self.wrapped)
            self.wrapped = np.nan
        return found, sender

    def _fragment(self, part: _Part, sender: str | None) -> None:
        """Keep a part of a message until the others have come; they come in order and soon, or the message is lost."""
        sentence = part.sentence
        base = (sentence.seq_id, sentence.channel, sentence.talker, sentence.frag_cnt)
        key = (*base, self.senders.get(base) if sender is None and sentence.frag_num > 1 else sender)
        if key not in self.open and (*base, None) in self.open:
            key = (*base, None)
        parts = self.open.pop(key, [])
        late = bool(parts) and abs(part.near - parts[0].near) > LONGEST_MESSAGE  # NaN is not
        if sentence.frag_num != len(parts) + 1 or late:
            for lost in parts or [part]:
                self._bad("incomplete message", lost.number, lost.text)
                break
            if sentence.frag_num != 1:
                if parts and late:
                    self._bad("incomplete message", part.number, part.text)
                return
            parts = []
        parts.append(part)
        if len(parts) == sentence.frag_cnt:
            stamped = [one.beside for one in parts if one.beside.near == one.beside.near]
            whole = AISSentence.assemble_from_iterable([one.sentence for one in parts])
            self._message(part.number, part.text, whole, stamped[0] if stamped else Beside())
            return
        if sentence.frag_num == 1:
            self.senders[base] = sender
        self.open[key] = parts
        if len(self.open) > OPEN_MESSAGES:
            first = self.open.pop(next(iter(self.open)))[0]
            self._bad("incomplete message", first.number, first.text)

    def _set_clock(self, time: float, clocks: str) -> None:
        """A clock was read. The positions before the first one of a log are timed by it, back from it."""
        if np.isnan(self.clock):
            at = time
            for k in range(len(self.positions) - 1, max(len(self.positions) - AHEAD, 0) - 1, -1):
                number, text, message, found = self.positions[k]
                if found.near != found.near:
                    at = clocked(at, _second(message))
                    self.positions[k] = number, text, message, Beside(at)
                    self.tally.note(f"{{n}} positions are timed by {clocks}")
        self.clock, self.clocks = time, clocks

    def close(self) -> None:
        """The log is at its end."""
        for parts in self.open.values():
            self._bad("incomplete message", parts[0].number, parts[0].text)
        self.open.clear()
        for kind, count in sorted(self.others.items()):
            self.tally.note(f"{{n}} messages of type {kind} hold no position of a ship", count)

    def _message(self, number: int, text: str, sentence: AISSentence, found: Beside) -> None:
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
        if kind != BASE_STATION and getattr(message, "mmsi", None) is None:  # cut off before it
            self._bad("bad message", number, text)
            return
        if kind == BASE_STATION:
            if not np.isnan(time := _clock(message)):
                self._set_clock(time, "the clock of a base station (message 4)")
            self.others[kind] += 1
            return
        if kind in STATIC:
            self.static.append(_described(message))
            self.tally.note("{n} static messages describe ships", kind != 19)
        if kind in POSITIONS:
            if found.near != found.near and not np.isnan(self.clock):
                time = clocked(self.clock, _second(message))
                found = Beside(time)
                if 0 < time - self.clock <= STEP:  # the clock goes on, so that it may be heard rarely
                    self.clock = time
                self.tally.note(f"{{n}} positions are timed by {self.clocks}")
            self.positions.append((number, text, message, found))

    def batches(self) -> Iterator[Rows | Static]:
        """What has come together since the last call."""
        if self.static:
            agents = pa.array([known.pop("agent") for known in self.static])
            texts = {n: pa.array([k[n] for k in self.static], pa.string()) for n in TEXTS}
            sizes = {n: np.array([k[n] or np.nan for k in self.static]) for n in ("length", "width")}
            yield Static(agents, texts | sizes)
        if self.positions:
            numbers, texts, messages, found = zip(*self.positions, strict=True)
            stamps = self.stamps.resolve([(one, _second(m)) for one, m in zip(found, messages, strict=True)])

            def values(name: str, far: float = np.nan) -> np.ndarray:
                """A field of all messages; ``far`` is "not available" in the long-range message 27."""
                fields = [getattr(m, name, None) for m in messages]
                return np.array(
                    [
                        np.nan if value is None or (value == far and m.msg_type == 27) else float(value)
                        for value, m in zip(fields, messages, strict=True)
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
                whole_turn=False,
            )
        self.positions, self.static = [], []


def _second(message: Any) -> float:
    """The second of the minute at which a position was found; NaN if the message does not tell (60 and more)."""
    second = getattr(message, "second", None)
    return float(second) if second is not None and second <= 59 else np.nan


def _clock(message: Any) -> float:
    """Time of a base station report; NaN if it is not set."""
    fields = (message.year, message.month, message.day, message.hour, message.minute, message.second)
    if None in fields or not message.year:
        return np.nan
    return times.parse("{:04d}-{:02d}-{:02d}T{:02d}:{:02d}:{:02d}".format(*fields))


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
