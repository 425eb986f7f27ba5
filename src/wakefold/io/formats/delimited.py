"""Delimited text by blocks of lines: typed, on two threads, and lenient where a block does not parse.

A record is a line. Each block goes through pyarrow's parser with the types wanted; a block it refuses, or in which
records and lines do not agree (blank lines, a stray quote), is cleaned and, if need be, read as text whose good values
are converted one by one, so that one bad line costs itself only.
"""

from __future__ import annotations

import csv
import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from wakefold.io import coordinates, times
from wakefold.io.records import SAMPLED, as_text, decoded, to_numbers
from wakefold.io.report import ReadError
from wakefold.io.source import HEAD, Source

THREADS = 2
DELIMITERS = ",;\t|"

TOP = 50
"""Lines that may stand before a header."""
COMMENTS = (b"#", b"//", b"%", b"--")

Kind = Literal["integer", "float", "float32", "lon", "lat", "text", "time"]
TYPES = {"integer": pa.int64(), "float": pa.float64(), "float32": pa.float32(), "text": pa.binary()}
TYPES |= {"lon": pa.float64(), "lat": pa.float64()}


@dataclass(frozen=True)
class Layout:
    """How a delimited text is laid out.

    Attributes:
        names: of its columns; "0", "1", ... without a header.
        delimiter: one of comma, semicolon, tab, bar; a space stands for any run of white space.
        header: number of the header's line, 0 without one.
        comma: numbers have a decimal comma.
    """

    names: tuple[str, ...]
    delimiter: str
    header: int
    comma: bool = False


@dataclass
class Block:
    """A parsed block.

    Attributes:
        columns: ``(n,)`` arrays: floats (NaN where empty or unreadable) for numbers and times (seconds), arrow arrays
            of bytes for text and of integers (or bytes, where some are not) for integers.
        lines: ``(n,)`` line numbers.
        bad: lines that are no records: number and text.
        raw: the block itself; ``first`` is the number of its first line.
    """

    columns: dict[str, pa.Array | NDArray[np.floating]]
    lines: NDArray[np.int64]
    bad: list[tuple[int, str]]
    raw: bytes
    first: int

    def text(self, row: int) -> str:
        """The line that a row came from."""
        return as_text(self.raw.split(b"\n")[self.lines[row] - self.first])

    def floats(self, name: str) -> NDArray[np.floating]:
        """A column of numbers or times."""
        return np.asarray(self.columns[name])

    def doubles(self, name: str) -> NDArray[np.float64]:
        """A column of numbers or times, float64."""
        return np.asarray(self.columns[name], dtype=np.float64)


def layout(head: bytes, header: bool = True, is_header: Callable[[Sequence[str]], bool] | None = None) -> Layout:
    """Delimiter and column names from the first line that is a header.

    That is the first one among the first ``TOP`` whose names ``is_header`` knows, else the first that is neither
    blank, nor a comment, nor ``sep=;``, which states the delimiter.
    """
    lines, first, stated = head.split(b"\n"), -1, None
    for number, raw in enumerate(lines):
        line = raw.strip()
        if not line:
            continue
        if stated is None and (match := re.fullmatch(rb"\"?sep=(.)\"?", raw.strip(b" \r"), re.IGNORECASE)):
            stated = match[1].decode("latin-1")
            continue
        note = line.startswith(COMMENTS)
        if header and is_header is not None and is_header(_cells(as_text(line), stated)[1]):
            first = number
            break
        first = number if first < 0 and not note else first
        if (not header or is_header is None) and first >= 0:
            break
        if number >= TOP:
            break
    first = max(first, 0)
    delimiter, cells = _cells(as_text(lines[first]), stated)
    if not header:
        return _with_commas(head, Layout(tuple(str(i) for i in range(len(cells))), delimiter, first))
    return _with_commas(head, Layout(tuple(cell.strip() for cell in cells), delimiter, first + 1))


def _cells(line: str, delimiter: str | None) -> tuple[str, list[str]]:
    """The delimiter of a line, if none is stated, and its cells."""
    if delimiter is None or delimiter not in line:
        delimiter = max(DELIMITERS, key=line.count)
    if line.count(delimiter) == 0:
        delimiter = " "
    try:
        return delimiter, line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter))
    except (csv.Error, StopIteration):
        return delimiter, line.split(delimiter)


def _with_commas(head: bytes, layout: Layout) -> Layout:
    """The layout, with a decimal comma where columns of the first rows hold numbers with one."""
    columns = sample(head, layout)
    if layout.delimiter == " " or not any(columns):
        return layout
    comma = re.compile(r"[+-]?\d{1,15},\d{1,15}([eE][+-]?\d\d?)?")
    known = ([value for value in column if value.strip()] for column in columns)
    return replace(layout, comma=any(values and all(map(comma.fullmatch, values)) for values in known))


def sample(head: bytes, layout: Layout) -> list[list[str]]:
    """Texts of the first rows by column, as many of each; rows of another number of fields are left out."""
    lines = head.split(b"\n")
    if len(head) >= HEAD:
        lines.pop()  # may be cut off
    out: list[list[str]] = [[] for _ in layout.names]
    for raw in lines[layout.header : layout.header + SAMPLED]:
        line = as_text(raw)
        if line and not line.startswith("#"):
            cells = _cells(line, layout.delimiter)[1] if layout.delimiter != " " else line.split()
            if len(cells) == len(out):
                for column, cell in zip(out, cells, strict=True):
                    column.append(cell.strip())
    return out


def read(
    source: Source, layout: Layout, wanted: Mapping[str, tuple[int, Kind]], time_format: str | None = None
) -> Iterator[Block]:
    """Blocks of the wanted columns, given by position and kind, in the order of the file.

    Args:
        time_format: see ``times``.
    """
    parse = _Parser(layout, wanted, time_format)
    pending: deque[Future[Block]] = deque()
    with ThreadPoolExecutor(THREADS) as pool:
        for first, raw, count in source.blocks():
            if first <= layout.header:
                skip = layout.header + 1 - first
                first, raw, count = layout.header + 1, b"".join(raw.split(b"\n", skip)[skip:]), count - skip
            if not raw:
                continue
            if not pending:
                parse.learn_times(raw)
            pending.append(pool.submit(parse, first, raw, count))
            if len(pending) > THREADS:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


class _Parser:
    """Parses one block after the other; has no state that a block changes, so blocks may be parsed in parallel."""

    def __init__(self, layout: Layout, wanted: Mapping[str, tuple[int, Kind]], time_format: str | None) -> None:
        self.layout, self.wanted, self.time_format = layout, wanted, time_format
        self.time_type: pa.DataType | None = None

    def learn_times(self, raw: bytes) -> None:
        """Take the arrow type of times from the first values."""
        where = [position for position, kind in self.wanted.values() if kind == "time"]
        if self.time_type is None and where:
            delimiter = None if self.layout.delimiter == " " else self.layout.delimiter.encode()
            cells = [line.split(delimiter) for line in raw[: 1 << 14].split(b"\n")[:100]]
            values = [as_text(c[where[0]]).strip('"') for c in cells if len(c) > where[0]]
            self.time_type = times.arrow_type(values, self.time_format)

    def __call__(self, first: int, raw: bytes, count: int) -> Block:
        if self.layout.delimiter != " " and _plain(raw):
            try:
                table, bad = self._typed(raw)
                if len(table) + len(bad) == count:
                    return self._block(first, raw, np.arange(first, first + count), table, bad)
            except pa.ArrowInvalid:
                pass
        clean, numbers, broken = self._cleaned(first, raw)
        if not len(numbers):
            return self._block(first, raw, numbers, None, [], broken)
        try:
            table, bad = self._typed(clean)
        except pa.ArrowInvalid:
            table, bad = self._typed(clean, as_bytes=True)
        if len(table) + len(bad) != len(numbers):
            raise ReadError(f"lines {first} to {first + count - 1} cannot be told apart into records")
        return self._block(first, raw, numbers, table, bad, broken)

    def _typed(self, raw: bytes, as_bytes: bool = False) -> tuple[pa.Table, list[int]]:
        """The wanted columns, and which records (from 0) have the wrong number of fields."""
        bad: list[int] = []

        def skip(row: pyarrow.csv.InvalidRow) -> str:
            bad.append(row.number - 1)
            return "skip"

        kinds = {str(position): kind for position, kind in self.wanted.values()}
        types = {
            name: pa.binary() if as_bytes else self.time_type if kind == "time" else TYPES[kind]
            for name, kind in kinds.items()
        }
        table = pyarrow.csv.read_csv(
            pa.BufferReader(raw),
            pyarrow.csv.ReadOptions(
                use_threads=False,
                block_size=len(raw) + 1,
                column_names=[str(i) for i in range(len(self.layout.names))],
            ),
            pyarrow.csv.ParseOptions(
                delimiter="," if self.layout.delimiter == " " else self.layout.delimiter, invalid_row_handler=skip
            ),
            pyarrow.csv.ConvertOptions(
                column_types=types,
                include_columns=list(types),
                timestamp_parsers=times.parsers(self.time_format),
                decimal_point="," if self.layout.comma else ".",
                check_utf8=False,
            ),
        )
        return table, bad

    def _cleaned(self, first: int, raw: bytes) -> tuple[bytes, NDArray[np.int64], list[tuple[int, str]]]:
        """The lines that can be records, joined, with their numbers; and those with a quote left open."""
        lines, numbers, broken = [], [], []
        whole = _closed("," if self.layout.delimiter == " " else self.layout.delimiter)
        for number, line in enumerate(raw.split(b"\n"), first):
            line = line.rstrip(b"\r").replace(b"\r", b" ")
            if not line.strip() or line.startswith(b"#"):
                continue
            if not line.isascii():
                line = decoded(line).encode()
            if self.layout.delimiter == " ":
                line = b",".join(line.replace(b",", b" ").split())
            if b'"' in line and not whole.fullmatch(line):
                broken.append((number, as_text(line)))
            else:
                lines.append(line)
                numbers.append(number)
        return b"\n".join(lines) + b"\n", np.array(numbers, dtype=np.int64), broken

    def _block(
        self,
        first: int,
        raw: bytes,
        numbers: NDArray[np.int64],
        table: pa.Table | None,
        bad: Sequence[int],
        broken: Sequence[tuple[int, str]] = (),
    ) -> Block:
        """Numbers as numpy arrays, values that do not convert as NaN."""
        columns: dict[str, pa.Array | NDArray[np.floating]] = {}
        for name, (position, kind) in self.wanted.items():
            if table is None:
                columns[name] = pa.array([], TYPES[kind]) if kind in ("integer", "text") else np.empty(0)
                continue
            chunked = table.column(str(position))
            values = chunked.chunk(0) if chunked.num_chunks == 1 else pa.concat_arrays(chunked.chunks)
            lenient = pa.types.is_binary(values.type)
            if kind == "time" and lenient:
                columns[name] = times.from_text(values, self.time_format)
            elif kind == "time":
                columns[name] = times.from_arrow(values, self.time_format)
            elif kind in ("lon", "lat") and lenient:
                columns[name] = coordinates.to_degrees(values, kind, self.layout.comma)
            elif kind in ("float", "float32", "lon", "lat"):
                numeric = to_numbers(values, TYPES[kind], self.layout.comma) if lenient else values
                columns[name] = numeric.to_numpy(zero_copy_only=False)
            else:
                columns[name] = values
        lines = numbers
        if bad:
            text = raw.split(b"\n")
            wrong = [(int(numbers[i]), text[numbers[i] - first].strip()) for i in bad]
            broken = [
                *broken,
                *((n, decoded(line)) for n, line in wrong if line and not line.startswith(b"#")),
            ]  # blanks, comments
            lines = np.delete(numbers, bad)
        return Block(columns, lines, sorted(broken), raw, first)


def _closed(delimiter: str) -> re.Pattern[bytes]:
    """Lines that end outside quotes, as pyarrow reads them: a quote counts at the beginning of a field only."""
    d = re.escape(delimiter)
    field = rf'(?:"(?:[^"]|"")*+"[^{d}]*+|[^"{d}][^{d}]*+|)'
    return re.compile(f"{field}(?:{d}{field})*+".encode())


def _plain(raw: bytes) -> bool:
    """Whether the parser can take a block as it is: UTF-8, and no carriage return apart from a line's end."""
    if b"\r" in raw and raw.count(b"\r") != raw.count(b"\r\n"):
        return False
    if not raw.isascii():
        try:
            raw.decode()
        except UnicodeDecodeError:
            return False
    return True
