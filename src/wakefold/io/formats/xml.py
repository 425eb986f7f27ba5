"""XML as a stream: elements as they end, without DTDs, and in little memory whatever the file holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from xml.etree.ElementTree import Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

from wakefold.io.report import Tally
from wakefold.io.source import Source

DEEPEST = 100
MOST_PARTS = 20_000
"""Elements that may be held at once: a point has a few."""


def elements(
    source: Source, tally: Tally, begun: Callable[[str], None] | None = None
) -> Iterator[tuple[str, Any, Any]]:
    """Each element as it ends: its tag, itself, and the tags that it stands in, from the top.

    What was read is forgotten as soon as it was handed over, but for the parts of an element named in ``KEPT``. A file
    that breaks off, or is no XML from somewhere on, ends there, with a "bad line".

    Args:
        begun: called with the tag of each element as it begins.
    """
    above: list[Element] = []
    tags: list[str] = []
    held = 0
    stream: Any = source
    try:
        for event, element in iterparse(stream, events=("start", "end"), forbid_dtd=True):
            if event == "start":
                above.append(element)
                tags.append(tag_of(element))
                held += 1
                if begun is not None:
                    begun(tags[-1])
                if len(above) > DEEPEST or held > MOST_PARTS:
                    raise ValueError(f"over {MOST_PARTS:,} parts in an element, or {DEEPEST} elements in one another")
                continue
            above.pop()
            tag = tags.pop()
            yield tag, element, tags
            if not KEPT.intersection(tags):  # nobody will ask for what is in it
                element.clear()
                if above:
                    above[-1].clear()
                held = len(above)
    except (ParseError, DefusedXmlException, ValueError, IndexError) as error:
        if type(error).__name__ == "ReadError":
            raise
        tally.rows += 1
        line = error.position[0] if isinstance(error, ParseError) else 0
        tally.reject("bad line", 1, [(line, f"the XML cannot be read from here on: {error}")])


KEPT = frozenset({"trkpt", "rtept", "wpt", "Point", "TimeStamp", "TimeSpan"})


def tag_of(element: Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""
