"""KML, and KMZ, which is a zip of it: ``gx:Track``, points with a time stamp, and lines, which have no times.

A track has the name of its placemark. Points with a ``TimeStamp`` are the track of the folder that they lie in, or of
the document, if their own names are all different.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from wakefold.io import times
from wakefold.io.formats.objects import moment_of
from wakefold.io.formats.xml import elements
from wakefold.io.records import Rows, identity
from wakefold.io.report import Tally
from wakefold.io.source import Source

BATCH = 50_000
PLACE = re.compile(r"\S+")
UNTIMED = "{n} places without a time stamp are no tracks"
FOLDERS = ("Folder", "Document")


def read(source: Source, tally: Tally, time_format: str | None) -> Iterator[Rows]:
    """A batch for each track and line, and batches of points; a row is a position, its line its place in the file."""
    reader = _Reader(source, tally, time_format)
    for tag, element, above in elements(source, tally, reader.begin):
        yield from reader.end(tag, element, above)
    yield from reader.points()


class _Reader:
    def __init__(self, source: Source, tally: Tally, time_format: str | None) -> None:
        self.source, self.tally, self.time_format = source, tally, time_format
        self.names = [""]  # of the document and folders that we are in
        self.count = 0
        self.found: list[tuple[str, str, float, tuple[float, float], int]] = []  # name, folder, time, place, row
        self.name, self.moment, self.point = "", None, None
        self.when, self.places = array("d"), array("d")  # of a track: longitude, latitude, longitude, ...

    def begin(self, tag: str) -> None:
        if tag in FOLDERS:
            self.names.append("")
        elif tag == "Placemark":
            self.name, self.moment, self.point = "", None, None
        elif tag in ("Track", "LineString"):
            self.when, self.places = array("d"), array("d")

    def end(self, tag: str, element: Any, above: list[str]) -> Iterator[Rows]:
        parent = above[-1] if above else ""
        text = (element.text or "").strip()
        if tag == "name" and parent == "Placemark":
            self.name = text
        elif tag == "name" and parent in FOLDERS:
            self.names[-1] = text
        elif tag in FOLDERS:
            self.names.pop()
        elif tag == "when" and parent == "Track":
            self.when.append(moment_of(text, self.time_format))
        elif tag == "when" and parent == "TimeStamp":
            self.moment = moment_of(text, self.time_format)
        elif tag == "coord" and parent == "Track":
            self.places.extend(_place(text.split()))
        elif tag == "coordinates" and parent == "Point":
            self.point = _place(text.split(","))
        elif tag == "coordinates" and parent == "LineString":
            self.source.afford(2 * text.count(","))
            self.places = array("d")
            for match in PLACE.finditer(text):
                self.places.extend(_place(match[0].split(",")))
        elif tag in ("Track", "LineString") and self.places:
            yield self._track(tag == "Track")
        elif tag == "Placemark" and self.point is not None:
            if self.moment is None:
                self.tally.note(UNTIMED)
            else:
                self.count += 1
                folder = next((name for name in reversed(self.names) if name), "")
                self.found.append((self.name, folder, self.moment, self.point, self.count))

    def _track(self, timed: bool) -> Rows:
        n = len(self.places) // 2
        time = np.full(n, np.nan)
        if len(self.when) == n:  # else nobody knows which are whose
            time[:] = self.when
        lon, lat = np.frombuffer(self.places, dtype=np.float64).reshape(-1, 2).T
        lines = np.arange(self.count + 1, self.count + n + 1)
        self.count += n
        name = self.name or next((name for name in reversed(self.names) if name), "") or "track"
        return Rows(
            agent=identity(name),
            time=time if timed else None,
            position=(lon, lat),
            geodetic=True,
            lines=lines,
            text=lambda row: f"{lon[row]:.10g} {lat[row]:.10g}",
        )

    def points(self) -> Iterator[Rows]:
        """The points with a time stamp, all at the end, as their names tell then which of them make a track."""
        own = len({point[0] for point in self.found if point[0]})
        by_name = 0 < own <= len(self.found) // 2
        for lo in range(0, len(self.found), BATCH):
            names, folders, moments, places, lines = zip(*self.found[lo : lo + BATCH], strict=True)
            lon, lat = np.array(places, dtype=np.float64).T
            agents = names if by_name else [folder or "track" for folder in folders]
            yield Rows(
                agent=pa.array([identity(agent) for agent in agents], pa.string()),
                time=np.array(moments, dtype=np.float64),
                position=(lon, lat),
                geodetic=True,
                lines=np.array(lines),
                text=lambda row, places=places: f"{places[row][0]} {places[row][1]}",
            )


def _place(parts: Sequence[str]) -> tuple[float, float]:
    pair = [times.number(part) for part in parts[:2]]
    return (pair[0], pair[1]) if len(pair) == 2 else (np.nan, np.nan)
