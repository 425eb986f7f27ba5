"""Which format a file has, by its first bytes and never by its name."""

from __future__ import annotations

import re
from collections.abc import Mapping

from wakefold.io.formats import delimited
from wakefold.io.formats.ais import DMA, MARINECADASTRE
from wakefold.io.formats.delimited import plain
from wakefold.io.records import as_text
from wakefold.io.report import ReadError, listed
from wakefold.io.source import Source

NMEA = re.compile(rb"[!$](AB|AD|AI|AN|AR|AS|AT|AX|BS|SA)VD[MO],\d", re.IGNORECASE)
FORMATS = {
    "marinecadastre": "MarineCadastre CSV",
    "dma": "Danish Maritime Authority CSV",
    "nmea": "NMEA AIVDM log",
    "table": "CSV",
    "parquet": "Parquet",
    "geojson": "GeoJSON",
    "mfjson": "MF-JSON",
    "gpx": "GPX",
    "traj": "Tracktable .traj",
    "edinburgh": "Edinburgh forum tracks",
}
"""Names of the formats, and what they are called."""


def sniff(source: Source, columns: Mapping[str, str | int] | None) -> str:
    """The key in ``FORMATS`` of what a source holds.

    Args:
        columns: given by the caller for a table; then a text that is nothing else is a table.

    Raises:
        ReadError: it is nothing known; says what was seen and what is accepted.
    """
    head = source.head
    text = head.lstrip()
    if not text:
        raise ReadError(f"{source.name}: the file is empty")
    if head.startswith(b"PAR1"):
        return "parquet"
    if text.startswith(b"<") and re.search(rb"<(\w+:)?gpx[\s>]", head):
        return "gpx"
    if text.startswith((b"{", b"\x1e")):
        moving = rb'"(MovingPoint|MovingGeometryCollection|temporalGeometry)"'
        return "mfjson" if re.search(moving, head) else "geojson"
    if text.startswith(b"*T*"):
        return "traj"
    if re.search(rb"^[ \t]*(TRACK|Properties)\.R\d+\s*=\s*\[", head, re.MULTILINE):
        return "edinburgh"
    if NMEA.search(head):
        return "nmea"
    if b"\0" in text.split(b"\n")[0]:
        raise ReadError(_unknown(source.name, "binary data"))
    names = {plain(name) for name in delimited.layout(head).names}
    if columns is None:
        if any(want <= names for want in MARINECADASTRE):
            return "marinecadastre"
        if names >= DMA and "typeofmobile" in names:
            return "dma"
        from wakefold.io.formats.tables import is_table

        if not is_table(delimited.layout(head).names):
            line = as_text(text.split(b"\n")[0])
            raise ReadError(_unknown(source.name, f"text that begins {line[:60]!r}"))
    return "table"


def _unknown(name: str, seen: str) -> str:
    return (
        f"{name}: no known format ({seen}); accepted are {listed(list(FORMATS.values()))}, "
        "plain or .gz, .zst, .zip; give columns={...} (--columns) for a table with other names"
    )
