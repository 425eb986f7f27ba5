"""Geolife ``.plt``: six lines of header, then latitude, longitude, 0, altitude, day serial, date, time of day (GMT)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PurePath

import numpy as np

from wakefold.io import times
from wakefold.io.records import Rows, as_text
from wakefold.io.report import Tally
from wakefold.io.source import Source

HEADER = 6
FIELDS = 7


def read(source: Source, tally: Tally) -> Iterator[Rows]:
    """One batch: a file is a track, named as the file is."""
    lines: list[int] = []
    rows: list[tuple[float, float, float]] = []
    texts: list[str] = []
    for number, line in source.lines():
        cells = as_text(line).split(",")
        if number <= HEADER:
            continue
        if len(cells) != FIELDS:
            tally.rows += 1
            tally.reject("bad line", 1, [(number, as_text(line))])
            continue
        lines.append(number)
        rows.append((times.number(cells[1]), times.number(cells[0]), times.day(cells[5]) + times.of_day(cells[6])))
        texts.append(as_text(line))
    if rows:
        lon, lat, time = np.array(rows).T
        yield Rows(
            agent=PurePath(source.name).stem or "track",
            time=time,
            position=(lon, lat),
            geodetic=True,
            lines=np.array(lines),
            text=texts.__getitem__,
        )
