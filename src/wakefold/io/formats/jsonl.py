"""JSON lines: an object a line, whose keys are the columns of a table; also an array of such objects."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from wakefold.io.columns import Columns, is_table
from wakefold.io.formats.objects import BATCH, WEIGHT, Objects, Thing
from wakefold.io.records import Rows, as_text, decoded
from wakefold.io.report import Tally
from wakefold.io.source import Source

MOST_BYTES = 2 << 30
"""Of an array, which is held in memory as text."""
_DECODER = json.JSONDecoder()


def is_rows(text: bytes, columns: Columns | None) -> bool:
    """Whether a text begins with an object whose keys are columns, and not with GeoJSON."""
    line = decoded((text[:1] == b"[" and text[1:].lstrip()) or text.split(b"\n")[0])
    try:
        first = _DECODER.raw_decode(line.lstrip("\x1e \t"))[0]
    except (ValueError, RecursionError):
        return False
    if not isinstance(first, dict) or {"coordinates", "geometry", "features", "temporalGeometry"} & first.keys():
        return False
    return is_table(list(first)) or bool(columns and first.keys() & set(columns.values()))


def read(source: Source, tally: Tally, columns: Columns | None, time_format: str | None) -> Iterator[Rows]:
    """Batches of rows, an object each; a line that is none is a bad line."""
    objects = Objects(source.name, tally, columns, time_format, geometry=False)
    things: list[Thing] = []
    for number, value, text in _array(source) if source.head.lstrip().startswith(b"[") else _lines(source):
        if isinstance(value, dict):
            things.append(Thing(number, value))
        else:
            tally.rows += 1
            tally.reject("bad line", 1, [(number, text)])
        if len(things) >= BATCH:
            yield objects.rows(things)
            things = []
    if things:
        yield objects.rows(things)


def _lines(source: Source) -> Iterator[tuple[int, Any, str]]:
    for number, line in source.lines():
        text = as_text(line).lstrip("\x1e")
        try:
            yield number, json.loads(text), text
        except (ValueError, RecursionError):
            yield number, None, text


def _array(source: Source) -> Iterator[tuple[int, Any, str]]:
    """Elements of an array; what follows damage is one bad line."""
    text = decoded(source.whole(MOST_BYTES, WEIGHT))
    at, line, counted = text.index("[") + 1, 1, 0
    while True:
        while at < len(text) and text[at] in " \t\r\n,":
            at += 1
        if at >= len(text) or text[at] == "]":
            return
        line, counted = line + text.count("\n", counted, at), at
        try:
            value, end = _DECODER.raw_decode(text, at)
        except (ValueError, RecursionError):
            yield line, None, text[at : at + 1000]
            return
        yield line, value, text[at : at + 1000]
        at = end
