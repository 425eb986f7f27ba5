"""Position records in batches, as readers hand them over, before any rule is applied."""

# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

Floats = NDArray[np.float64]


NUMBER = r"^\s*[+-]?(\d{1,30}\.?\d{0,30}|\.\d{1,30})([eE][+-]?\d{1,2})?\s*$"
"""What is taken for a number where the parser found something that is none."""


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
        attributes: per-row values of what belongs to the agent: text, bytes, integers or floats. The last value of
            an agent that is not empty is kept.
    """

    agent: str | pa.Array
    time: Floats | None
    position: Sequence[Floats]
    geodetic: bool
    lines: NDArray[np.integer]
    text: Callable[[int], str]
    columns: Mapping[str, NDArray[np.floating]] = field(default_factory=dict)
    attributes: Mapping[str, pa.Array] = field(default_factory=dict)

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
            attributes={name: values.filter(chosen) for name, values in self.attributes.items()},
        )


@dataclass
class Static:
    """What is said of agents apart from their positions: names ``(n,)`` and attributes ``(n,)`` as in ``Rows``."""

    agent: pa.Array
    attributes: Mapping[str, pa.Array]


class Latest:
    """The last value of each agent that is not empty, over batches of rows."""

    def __init__(self) -> None:
        self._values = np.empty(0, dtype=object)
        self._numbers = True

    def add(self, codes: NDArray[np.int32], values: pa.Array, good: NDArray[np.bool_]) -> None:
        """Take up the values ``(n,)`` of the good rows, whose agents are ``codes``."""
        self._numbers &= pa.types.is_floating(values.type)
        known = ~values.is_null(nan_is_null=True).to_numpy(zero_copy_only=False) & good
        if is_text(values):
            known &= pc.fill_null(pc.greater(pc.binary_length(values), 0), False).to_numpy(zero_copy_only=False)
        rows = np.flatnonzero(known)
        if not len(rows):
            return
        agents = int(codes[rows].max()) + 1
        if agents > len(self._values):
            self._values = np.concatenate([self._values, np.full(2 * agents - len(self._values), None, dtype=object)])
        last = np.full(agents, -1, dtype=np.int64)
        last[codes[rows]] = rows  # of repeated codes numpy keeps the last
        changed = np.flatnonzero(last >= 0)
        self._values[changed] = values.take(pa.array(last[changed])).to_pylist()

    def of(self, codes: NDArray[np.integer]) -> NDArray[Any]:
        """``(m,)`` values of agents: float64 with NaN if floats were given, else text with ""."""
        known = [self._values[c] if c < len(self._values) else None for c in codes]
        if self._numbers:
            return np.array([np.nan if value is None else value for value in known], dtype=np.float64)
        return np.array(["" if value is None else as_text(value) for value in known], dtype=np.str_)


def is_text(values: pa.Array) -> bool:
    """Whether an array holds strings or bytes."""
    kind = values.type
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


def to_numbers(values: pa.Array, to: pa.DataType) -> pa.Array:
    """Texts that are numbers as such, null for the others."""
    good = pc.if_else(pc.match_substring_regex(values, NUMBER), values, None)
    return pc.ascii_trim_whitespace(good.cast(pa.string())).cast(to)
