"""Tracktable ``.traj`` text: one trajectory a line.

``*T*,<uuid>,<domain>,<points>,<k>`` and k triples of name, type, value; then
``*P*,<domain>,<d>,<has id>,<has time>,<m>`` and m pairs of name and type; then for each point object id, time (UTC), d
coordinates (longitude first) and m properties. Files of before Tracktable 1.0 have no uuid. The cells are CSV; the
domain is terrestrial (or, of old, generic: both in degrees), cartesian2d or cartesian3d. The file's own cutting into
trajectories is kept.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from wakefold.io import times
from wakefold.io.records import Rows, as_text
from wakefold.io.report import Tally
from wakefold.io.source import LONGEST_TRAJECTORY, Source

DOMAINS = ("terrestrial", "cartesian2d", "cartesian3d", "generic")
REAL = "1"
"""Tracktable's number for the type of a property that is a number (2 is text, 3 a time)."""


def read(source: Source, tally: Tally, time_format: str | None) -> Iterator[Rows]:
    """One batch for each line, named ``<object id>#<n>``, n counting the trajectories of the object from 1."""
    counts: Counter[str] = Counter()
    for number, line in source.lines(LONGEST_TRAJECTORY):
        text = as_text(line)
        source.afford(text.count(","))
        try:
            rows, missing = _trajectory(number, text, time_format)
        except (ValueError, IndexError, csv.Error):
            rows, missing = None, True
        if missing:
            tally.rows += 1
            tally.reject("bad line", 1, [(number, text)])
        if rows is not None:
            counts[str(rows.agent)] += 1
            rows.agent = f"{rows.agent}#{counts[str(rows.agent)]}"
            yield rows


def _trajectory(number: int, text: str, time_format: str | None) -> tuple[Rows | None, bool]:
    """The points of a line, under the object's id, and whether the line ends before its last point.

    Raises:
        ValueError, IndexError: not a trajectory.
    """
    cells = next(csv.reader([text]))
    if cells[0] != "*T*":
        raise ValueError("no trajectory")
    at = 2 if cells[1] in DOMAINS else 3  # without or with a uuid
    uuid, domain, declared = cells[1] if at == 3 else "", cells[at - 1], int(cells[at])
    at += 2 + 3 * int(cells[at + 1])
    if cells[at] != "*P*":
        raise ValueError("no point header")
    dim, has_id, has_time, properties = (int(cell) for cell in cells[at + 2 : at + 6])
    if dim not in (2, 3) or declared < 1 or not has_time:
        raise ValueError("not points in time")
    names, types = cells[at + 6 : at + 6 + 2 * properties : 2], cells[at + 7 : at + 6 + 2 * properties : 2]
    at += 6 + 2 * properties
    width = has_id + has_time + dim + properties
    count = len(cells[at:]) // width
    if len(cells) - at > declared * width:
        raise ValueError("more points than declared")
    if cut := len(cells) - at < declared * width:
        count = (len(cells) - at - 1) // width  # the last cell may be cut as well
    if count < 1:
        return None, True

    def column(offset: int) -> list[str]:
        return cells[at + offset : at + count * width : width]

    name = cells[at] if has_id and cells[at] else uuid or f"line {number}"
    columns = {
        names[i]: np.array([times.number(cell) for cell in column(has_id + 1 + dim + i)])
        for i in range(properties)
        if types[i] == REAL
    }
    rows = Rows(
        agent=name,
        time=times.from_text(pa.array(column(has_id), pa.string()), time_format),
        position=[np.array([times.number(cell) for cell in column(has_id + 1 + i)]) for i in range(dim)],
        geodetic=domain in ("terrestrial", "generic") and dim == 2,
        lines=np.full(count, number),
        text=lambda row: ",".join(cells[at + row * width : at + (row + 1) * width]),
        columns=columns,
        attributes={key: pa.array([value] * count) for key, value in (("agent", name), ("uuid", uuid))},
    )
    return rows, cut
