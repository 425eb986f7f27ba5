"""Pedestrians of the Edinburgh Informatics Forum: Matlab text, ``TRACK.R<k>=[[x y t];[x y t];...];`` on a line.

x and y are pixels of an overhead image, 24.7 mm on the floor each; t counts frames, about 9 in a second.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from wakefold.io.records import Rows, as_text
from wakefold.io.report import Tally
from wakefold.io.source import LONGEST_TRAJECTORY, Source

METRES_PER_PIXEL = 0.0247
FRAMES_PER_SECOND = 9.0
TRACK = re.compile(r"TRACK\.R(\d+)\s*=\s*\[(.*?)\]?\s*;?", re.DOTALL)
NUMBER = r"(-?\d{1,9}(?:\.\d{0,9})?)"
POINT = re.compile(rf"\[\s*{NUMBER}[\s,]+{NUMBER}[\s,]+{NUMBER}\s*\]")


def read(source: Source, tally: Tally) -> Iterator[Rows]:
    """One batch for each track, named by its number; a row is a point."""
    for number, line in source.lines(LONGEST_TRAJECTORY):
        text = as_text(line)
        source.afford(3 * text.count(";"))
        match = TRACK.fullmatch(text)
        if match is None:
            if not text.startswith(("%", "Properties.")):
                tally.rows += 1
                tally.reject("bad line", 1, [(number, text)])
            continue
        points = []
        for piece in filter(None, match[2].split(";")):
            if found := POINT.fullmatch(piece.strip()):
                points.append(found.groups())
            else:
                tally.rows += 1
                tally.reject("bad line", 1, [(number, piece)])
        if points:
            x, y, frame = np.array(points, dtype=np.float64).T
            yield Rows(
                agent=match[1],
                time=frame / FRAMES_PER_SECOND,
                position=(x * METRES_PER_PIXEL, y * METRES_PER_PIXEL),
                geodetic=False,
                lines=np.full(len(points), number),
                text=lambda row, points=points: " ".join(points[row]),
            )
