"""Which format a file has, by its first bytes and never by its name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from wakefold.io.columns import is_table
from wakefold.io.formats import delimited, jsonl
from wakefold.io.formats.ais import DMA, MARINECADASTRE
from wakefold.io.records import as_text, plain
from wakefold.io.report import ReadError, listed, some
from wakefold.io.source import HEAD, Source

NMEA = re.compile(rb"[!$](AB|AD|AI|AN|AR|AS|AT|AX|BS|SA)VD[MO],\d", re.IGNORECASE)
MOVING = re.compile(rb'"(Moving\w*Point|MovingGeometryCollection|temporalGeometry)"')
FORMATS = {
    "marinecadastre": "MarineCadastre CSV",
    "dma": "Danish Maritime Authority CSV",
    "nmea": "NMEA AIVDM log",
    "table": "CSV",
    "parquet": "Parquet",
    "jsonl": "JSON lines",
    "geojson": "GeoJSON",
    "mfjson": "MF-JSON",
    "gpx": "GPX",
    "kml": "KML",
    "geopackage": "GeoPackage",
    "plt": "Geolife .plt",
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
    if not text and len(head) >= HEAD:
        raise ReadError(f"{source.name}: the first {HEAD:,} bytes are blank")
    if not text:
        raise ReadError(f"{source.name}: the file is empty")
    if found := _by_first_bytes(head, text):
        return found
    if re.search(rb"^[ \t]*(TRACK|Properties)\.R\d+\s*=\s*\[", head, re.MULTILINE):
        return "edinburgh"
    if text.startswith((b"{", b"[", b"\x1e")):
        if jsonl.is_rows(text, columns):
            return "jsonl"
        if not text.startswith(b"["):
            return "mfjson" if MOVING.search(head) else "geojson"
    if NMEA.search(head):
        return "nmea"
    if b"\0" in text.split(b"\n")[0]:
        raise ReadError(_unknown(source.name, "binary data"))
    if len(head) >= HEAD and b"\n" not in text:
        raise ReadError(f"{source.name}: the first line is longer than {HEAD:,} bytes, which no header of a table is")
    names = delimited.layout(head, is_header=_is_header if columns is None else None).names
    if columns is None:
        if kind := _ais(names):
            return kind
        if not is_table(names):
            line = as_text(text.split(b"\n")[0])
            raise ReadError(_unknown(source.name, f"text that begins {line[:60]!r}", names))
    return "table"


def _by_first_bytes(head: bytes, text: bytes) -> str | None:
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"SQLite format 3\0"):
        return "geopackage"
    if text.startswith(b"<"):
        found = re.search(rb"<(?:\w+:)?(gpx|kml)[\s>]", head)
        return found[1].decode() if found else None
    if text.startswith(b"*T*"):
        return "traj"
    return "plt" if text.startswith(b"Geolife trajectory") else None


def _ais(names: Sequence[str]) -> str | None:
    """Which of the formats of AIS has these columns."""
    there = {plain(name) for name in names}
    if any(want <= there for want in MARINECADASTRE):
        return "marinecadastre"
    return "dma" if there >= DMA and "typeofmobile" in there else None


def _is_header(names: Sequence[str]) -> bool:
    return _ais(names) is not None or is_table(names)


def _unknown(name: str, seen: str, names: Sequence[str] = ()) -> str:
    columns = f"; its columns would be {some(names)}" if len(names) > 1 else ""
    return (
        f"{name}: no known format ({seen}{columns}); accepted are {listed(list(FORMATS.values()))}, "
        "plain or .gz, .zst, .zip; give columns={...} (--columns) for a table with other names"
    )
