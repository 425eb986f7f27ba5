"""Position records in batches, as readers hand them over, before any rule is applied."""

# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.base.wording import escaped

NUMBER = r"^\s*[+-]?(\d{1,30}\.?\d{0,30}|\.\d{1,30})([eE][+-]?\d{1,2})?\s*$"
"""What is taken for a number where the parser found something that is none."""

FLOATED = re.compile(r"\d{1,15}\.\d*([eE]\+?\d\d?)?|\d{1,15}[eE]\+\d\d?")
EXPONENT = re.compile(r"(\d)(?:\.(\d*))?[eE]\+?(\d\d?)")
SAMPLED = 300
"""First rows of a table, whose values say what its columns are."""
PAIRED = "\x01"
"""Between an agent and its track, where both name a track; in no name of its own."""
LONGEST_TEXT = 200
"""Characters of a text that is kept of an agent: all have the room of the longest."""
MERGE = 200_000
"""Values put aside before they are merged."""


@dataclass
class Rows:
    """A batch of position records.

    Attributes:
        agent: one name for all rows (they are then a track of their own), or one per row, integers, text or bytes.
        time: ``(n,)`` seconds, NaN where unreadable; None when the data have no times at all.
        position: lon and lat in degrees, or x, y (and z): arrays ``(n,)``, NaN where unreadable.
        geodetic: whether ``position`` is lon and lat.
        lines: ``(n,)`` line or row numbers in the file, from 1.
        text: the text of a row, for the report.
        columns: per-point values ``(n,)``.
        attributes: per-row values of what belongs to the agent: numpy floats are numbers, arrow arrays text. The last
            value of an agent that is not empty is kept.
        whole_turn: longitudes may be beyond 180 degrees, as 0..360; in AIS, where 181 is none, they may not.
    """

    agent: str | pa.Array
    time: Floats | None
    position: Sequence[Floats]
    geodetic: bool
    lines: NDArray[np.integer]
    text: Callable[[int], str]
    columns: Mapping[str, NDArray[np.floating]] = field(default_factory=dict)
    attributes: Mapping[str, NDArray[np.floating] | pa.Array] = field(default_factory=dict)
    whole_turn: bool = True

    def named(self, rows: NDArray[np.integer]) -> Iterator[tuple[int, str]]:
        """Line number and text of some rows, for the report."""
        return ((int(self.lines[row]), self.text(int(row))) for row in rows)

    def where(self, mask: NDArray[np.bool_]) -> Rows:
        """The rows of the mask ``(n,)``."""
        if mask.all():
            return self
        index, chosen = np.flatnonzero(mask), pa.array(mask)
        return Rows(
            agent=self.agent if isinstance(self.agent, str) else self.agent.filter(chosen),
            time=None if self.time is None else self.time[mask],
            position=[p[mask] for p in self.position],
            geodetic=self.geodetic,
            lines=self.lines[mask],
            text=lambda row: self.text(int(index[row])),
            columns={name: values[mask] for name, values in self.columns.items()},
            attributes={name: _take(values, index) for name, values in self.attributes.items()},
            whole_turn=self.whole_turn,
        )


@dataclass
class Static:
    """What is said of agents apart from their positions: names ``(n,)`` and attributes ``(n,)`` as in ``Rows``."""

    agent: pa.Array
    attributes: Mapping[str, NDArray[np.floating] | pa.Array]


class Latest:
    """The last value of each agent that is not empty, over batches of rows.

    The last values of each batch are put aside, and merged when they have become many.
    """

    def __init__(self) -> None:
        self._codes: list[NDArray[np.integer]] = []
        self._values: list[NDArray[np.floating] | pa.Array] = []
        self._room = 0
        self._numbers = True

    def add(
        self,
        codes: NDArray[np.int32],
        values: NDArray[np.floating] | pa.Array,
        good: NDArray[np.bool_],
        last: NDArray[np.integer],
    ) -> None:
        """Take up the values ``(n,)`` of the good rows, whose agents are ``codes`` and whose ``last_rows`` are given.

        Most often these alone have to be looked at.
        """
        empty = self._add_rows(codes, values, last)
        if len(empty):
            lacking = np.zeros(int(codes.max()) + 1, dtype=bool)
            lacking[codes[empty]] = True
            self._add_rows(codes, values, np.flatnonzero(lacking[codes] & good))

    def _add_rows(
        self, codes: NDArray[np.int32], values: NDArray[np.floating] | pa.Array, rows: NDArray[np.integer]
    ) -> NDArray[np.integer]:
        """Take up the values of some rows, rising; returns the rows that are empty."""
        values = _take(values, rows)
        if isinstance(values, np.ndarray):
            known = ~np.isnan(values)
        else:
            self._numbers = False
            values = values.cast(pa.binary() if is_text(values) else pa.string()).cast(pa.binary())
            values = values.fill_null(b"") if values.null_count else values
            known = np.diff(np.frombuffer(values.buffers()[1], dtype=np.int32)[values.offset :][: len(values) + 1]) > 0
        full = np.flatnonzero(known)
        if len(full):
            changed, where = _last(codes[rows[full]])
            self._codes.append(changed)
            self._values.append(_take(values, full[where]))
            if sum(map(len, self._codes)) > self._room:
                self._merge()
                self._room = max(MERGE, 8 * len(self._codes[0]))
        return rows[~known]

    def _merge(self) -> None:
        changed, where = _last(np.concatenate(self._codes))
        if self._numbers:
            merged = np.concatenate(self._values)
        else:
            merged = pa.concat_arrays([_as_bytes(values) for values in self._values])
        self._codes, self._values = [changed], [_take(merged, where)]

    def of(self, codes: NDArray[np.integer]) -> NDArray[Any]:
        """``(m,)`` values of agents: float64 with NaN if only numbers were given, else text with ""."""
        known: dict[int, Any] = {}
        if self._codes:
            self._merge()
            known = dict(zip(self._codes[0].tolist(), self._values[0].tolist(), strict=True))
        if self._numbers:
            return np.array([known.get(code, np.nan) for code in codes.tolist()], dtype=np.float64)
        return np.array([escaped(as_text(known.get(code)))[:LONGEST_TEXT] for code in codes.tolist()], dtype=np.str_)


def _take(values: NDArray[np.floating] | pa.Array, where: NDArray[np.integer]) -> NDArray[np.floating] | pa.Array:
    return values[where] if isinstance(values, np.ndarray) else values.take(pa.array(where))


def _as_bytes(values: NDArray[np.floating] | pa.Array) -> pa.Array:
    return pa.array(values).cast(pa.string()).cast(pa.binary()) if isinstance(values, np.ndarray) else values


def last_rows(codes: NDArray[np.int32], good: NDArray[np.bool_]) -> NDArray[np.integer]:
    """The last of the good rows ``(n,)`` of each agent, rising."""
    rows = np.flatnonzero(good)
    return np.sort(rows[_last(codes[rows])[1]]) if len(rows) else rows


def _last(codes: NDArray[np.integer]) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """The codes that occur, ascending, and where each occurs last."""
    last = np.full(int(codes.max()) + 1, -1, dtype=np.int64)
    last[codes] = np.arange(len(codes))  # of repeated codes numpy keeps the last
    changed = np.flatnonzero(last >= 0)
    return changed, last[changed]


def is_text(values: pa.Array) -> bool:
    """Whether an array holds strings or bytes."""
    return is_text_type(values.type)


def is_text_type(kind: pa.DataType) -> bool:
    """Whether a type is that of strings or bytes."""
    return any(t(kind) for t in (pa.types.is_string, pa.types.is_large_string, pa.types.is_binary))


def as_text(value: Any) -> str:
    """Text of a value from a file, trimmed. Bytes are UTF-8 or else Latin-1: AIS files hold names in either."""
    if isinstance(value, bytes):
        value = decoded(value)
    return "" if value is None else str(value).replace("\0", "").strip()


def decoded(raw: bytes) -> str:
    """Text of bytes that are UTF-8 or else Latin-1."""
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def to_numbers(values: pa.Array, to: pa.DataType, comma: bool = False) -> pa.Array:
    """Texts that are numbers as such, with a decimal comma if so stated; null for the others."""
    if comma:
        texts = [as_text(value) for value in values.to_pylist()]
        values = pa.array([text.replace(",", ".", 1) if "." not in text else text for text in texts], pa.string())
    good = pc.if_else(pc.match_substring_regex(values, NUMBER), values, None)
    return pc.ascii_trim_whitespace(good.cast(pa.string())).cast(to)


def plain(name: str) -> str:
    """A column name without case, spaces, underscores and the like."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def identity(value: Any) -> str:
    """Name of an agent; whole numbers that were made floats on their way (``367000140.0``, or as spreadsheets write
    them ``3.6700014E+08``) without fraction and exponent."""
    text = escaped(as_text(value))
    return str(int(float(text))) if FLOATED.fullmatch(text) and float(text) % 1 == 0 else text


def rounded(value: Any) -> bool:
    """Whether the name of an agent is a number with an exponent that has fewer digits than it stands for."""
    match = EXPONENT.fullmatch(as_text(value))
    return match is not None and FLOATED.fullmatch(match[0]) is not None and len(match[2] or "") < int(match[3])
