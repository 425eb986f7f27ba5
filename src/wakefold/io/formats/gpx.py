"""GPX 1.0 and 1.1: each ``trkseg`` and each ``rte`` is a track under its ``name``; read as a stream, without DTDs."""

from __future__ import annotations

from array import array
from collections.abc import Iterator

import numpy as np

from wakefold.io import times
from wakefold.io.formats.xml import elements, tag_of
from wakefold.io.records import Rows
from wakefold.io.report import Tally
from wakefold.io.source import Source

WAYPOINTS = "the file holds {n} waypoints, which are no track or route"


def read(source: Source, tally: Tally, time_format: str | None) -> Iterator[Rows]:
    """One batch for each segment or route; a row is a point, its line its place among the points of the file.

    A file that breaks off, or is no XML from somewhere on, yields what came before, and a "bad line".
    """
    points = _Points()
    name, count, tracks = "", 0, 0

    def begun(tag: str) -> None:
        nonlocal tracks, name
        if tag in ("trk", "rte"):
            tracks += 1
            name = f"track {tracks}"

    for tag, element, above in elements(source, tally, begun):
        if tag == "name" and above and above[-1] in ("trk", "rte"):
            name = (element.text or "").strip() or name
        elif tag in ("trkpt", "rtept"):
            count += 1
            moment = next((child.text or "" for child in element if tag_of(child) == "time"), None)
            points.add(element.get("lon", ""), element.get("lat", ""), moment, count, time_format)
        elif tag == "wpt":
            tally.note(WAYPOINTS)
        elif tag in ("trkseg", "rte") and len(points.lon):
            yield points.rows(name)
            points = _Points()
    if len(points.lon):
        yield points.rows(name)


class _Points:
    """The points of a track: four numbers each."""

    def __init__(self) -> None:
        self.lon, self.lat, self.time, self.place = array("d"), array("d"), array("d"), array("q")
        self.timed = False

    def add(self, lon: str, lat: str, moment: str | None, place: int, form: str | None) -> None:
        self.lon.append(times.number(lon))
        self.lat.append(times.number(lat))
        text = (moment or "").strip()
        self.time.append(times.parse(text) if form is None else times.formatted(text, form))
        self.place.append(place)
        self.timed |= moment is not None

    def rows(self, name: str) -> Rows:
        lon, lat, time = (np.frombuffer(values, dtype=np.float64) for values in (self.lon, self.lat, self.time))

        def text(row: int) -> str:
            return f"{lon[row]:.10g} {lat[row]:.10g} {f'{time[row]:.3f} s' if time[row] == time[row] else 'no time'}"

        return Rows(
            agent=name,
            time=time if self.timed else None,
            position=(lon, lat),
            geodetic=True,
            lines=np.frombuffer(self.place, dtype=np.int64),
            text=text,
        )
