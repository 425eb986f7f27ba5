"""GPX 1.0 and 1.1: each ``trkseg`` and each ``rte`` is a track under its ``name``; read as a stream, without DTDs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

from wakefold.io import times
from wakefold.io.records import Rows
from wakefold.io.report import Tally
from wakefold.io.source import Source


class _Point(NamedTuple):
    lon: float
    lat: float
    time: float
    place: int
    text: str


def read(source: Source, tally: Tally) -> Iterator[Rows]:
    """One batch for each segment or route; a row is a point, its line its place among the points of the file.

    A file that breaks off, or is no XML from somewhere on, yields what came before, and a "bad line".
    """
    above: list[Element] = []
    points: list[_Point] = []
    name, count, tracks = "", 0, 0
    stream: Any = source
    try:
        for event, element in iterparse(stream, events=("start", "end"), forbid_dtd=True):
            tag = _tag(element)
            if event == "start":
                above.append(element)
                if tag in ("trk", "rte"):
                    tracks += 1
                    name = f"track {tracks}"
                continue
            above.pop()
            if tag == "name" and above and _tag(above[-1]) in ("trk", "rte"):
                name = (element.text or "").strip() or name
            elif tag in ("trkpt", "rtept"):
                count += 1
                points.append(_point(element, count))
                above[-1].clear()  # the points that were read need no memory
            elif tag in ("trkseg", "rte") and points:
                yield _rows(name, points)
                points = []
    except (ParseError, DefusedXmlException, ValueError, IndexError) as error:
        if points:
            yield _rows(name, points)
        tally.rows += 1
        line = error.position[0] if isinstance(error, ParseError) else 0
        tally.reject("bad line", 1, [(line, f"the XML cannot be read from here on: {error}")])


def _tag(element: Element) -> str:
    return element.tag.rpartition("}")[2]


def _point(element: Element, place: int) -> _Point:
    moment = next((child.text or "" for child in element if _tag(child) == "time"), None)
    lon, lat = element.get("lon", ""), element.get("lat", "")
    time = np.nan if moment is None else times.parse(moment.strip())
    return _Point(times.number(lon), times.number(lat), time, place, f"{lon} {lat} {moment or 'no time'}")


def _rows(name: str, points: list[_Point]) -> Rows:
    lon, lat, time = (np.array([point[i] for point in points]) for i in range(3))
    return Rows(
        agent=name,
        time=time if any(not point.text.endswith("no time") for point in points) else None,
        position=(lon, lat),
        geodetic=True,
        lines=np.array([point.place for point in points]),
        text=lambda row: points[row].text,
    )
