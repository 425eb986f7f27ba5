"""Positions written as text: degrees with letters, minutes and seconds, decimal commas, WKT, hexadecimal WKB."""

# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
from __future__ import annotations

import re
import struct
from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from wakefold.base.types import Floats
from wakefold.io import times
from wakefold.io.records import as_text, to_numbers

LETTERS = {"lon": "EW", "lat": "NS"}
_PART = r"(\d{1,3}(?:[.,]\d{1,20})?)"
_DEGREES = re.compile(
    rf"([NSEWO])?\s*([+-])?\s*{_PART}\s*(?:°|º|deg|d|:|\s)?\s*"
    rf"(?:{_PART}\s*(?:'|′|’|min|m|:|\s)?\s*(?:{_PART}\s*(?:\"|″|”|''|sec|s)?)?)?\s*([NSEWO])?",
    re.IGNORECASE,
)
_PACKED = re.compile(r"(\d{2,3})(\d\d\.\d{1,20})\s*([NSEW])", re.IGNORECASE)
"""As receivers write them: 4631.191N, 00731.5E."""
_POINT = re.compile(
    r"(?:SRID=(\d{1,6});)?\s*POINT\s*(?:Z|M|ZM)?\s*\(\s*(\S+)\s+(\S+)(?:\s+\S+){0,2}\s*\)", re.IGNORECASE
)
_HEX = re.compile(r"(?:\\x)?([0-9A-Fa-f]{42,108})")
DEGREES = (0, 4326)
"""SRIDs of longitude and latitude; 0 is none."""


def degrees(text: str, axis: str) -> float:
    """Degrees of 46.5198, 46,5198, 46.5198N, N 46 31.19, 46°31'11.5"N, 4631.191N; NaN of what is none.

    Args:
        axis: "lon" or "lat": the other one's letters are none.
    """
    text = text.strip()
    number = times.number(text)
    if number == number:
        return number
    letters = LETTERS[axis]
    if (match := _PACKED.fullmatch(text)) and match[3].upper() in letters:
        size = int(match[1]) + float(match[2]) / 60 if float(match[2]) < 60 else np.nan
        return -size if match[3].upper() in "SW" else size
    match = _DEGREES.fullmatch(text)
    if match is None or (match[1] and match[6]):
        return np.nan
    letter = (match[1] or match[6] or "").upper()
    if (letter and letter not in letters) or (letter and match[2]):
        return np.nan
    parts = [float(part.replace(",", ".")) for part in match.group(3, 4, 5) if part]
    if any(part >= 60 for part in parts[1:]) or any(part % 1 for part in parts[:-1]):
        return np.nan
    size = sum(part / 60**k for k, part in enumerate(parts))
    return -size if letter in ("S", "W") or match[2] == "-" else size


def to_degrees(values: pa.Array, axis: str, comma: bool) -> Floats:
    """``(n,)`` degrees of texts or bytes; NaN for those that are none."""
    plain = to_numbers(values, pa.float64(), comma).to_numpy(zero_copy_only=False)
    left = np.flatnonzero(np.isnan(plain))
    if len(left):
        plain = plain.copy()
        plain[left] = [degrees(as_text(value), axis) for value in values.take(pa.array(left)).to_pylist()]
    return plain


def is_point(text: str) -> bool:
    """Whether a text is a point in WKT or hexadecimal WKB."""
    return bool(_POINT.fullmatch(text.strip())) or (bool(_HEX.fullmatch(text.strip())) and point(text)[2] >= 0)


def point(text: str) -> tuple[float, float, int]:
    """x, y and SRID (0 without, -1 if it is no point) of WKT, EWKT, or hexadecimal WKB or EWKB."""
    text = text.strip()
    if match := _POINT.fullmatch(text):
        return times.number(match[2]), times.number(match[3]), int(match[1] or 0)
    if match := _HEX.fullmatch(text):
        try:
            return well_known(bytes.fromhex(match[1]))
        except (ValueError, struct.error):
            pass
    return np.nan, np.nan, -1


def well_known(raw: bytes) -> tuple[float, float, int]:
    """x, y and SRID of a point in well-known binary, also extended.

    Raises:
        ValueError, struct.error: it is none.
    """
    order = "<" if raw[:1] == b"\x01" else ">"
    (kind,) = struct.unpack_from(f"{order}I", raw, 1)
    srid, at = 0, 5
    if kind & 0x20000000:
        (srid,) = struct.unpack_from(f"{order}I", raw, 5)
        at = 9
    if (kind & 0x0FFFFFFF) % 1000 != 1:
        raise ValueError("not a point")
    x, y = struct.unpack_from(f"{order}dd", raw, at)
    return x, y, srid


def to_points(texts: Sequence[str]) -> tuple[Floats, Floats, set[int]]:
    """x and y ``(n,)`` of texts, NaN where they are no points, and the SRIDs met."""
    found = [point(text) for text in texts]
    x, y = np.array([p[0] for p in found], dtype=np.float64), np.array([p[1] for p in found], dtype=np.float64)
    return x, y, {p[2] for p in found if p[2] >= 0}
