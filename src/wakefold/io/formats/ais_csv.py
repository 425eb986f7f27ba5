"""AIS as CSV: MarineCadastre (United States, both generations of names) and the Danish Maritime Authority.

MarineCadastre 2015 to 2024 has ``MMSI,BaseDateTime,LAT,LON,...``, from 2025 ``mmsi,base_date_time,longitude,...``;
columns are found by name, in any order and spelling (``TranscieverClass``), and others are passed over. Speeds are in
knots; times are UTC, day first in the Danish files, whose ``Type of mobile`` tells ships from shore stations.
"""

# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from wakefold.io import clock, times
from wakefold.io.formats import ais, delimited
from wakefold.io.records import Rows, as_text, plain
from wakefold.io.report import ReadError, Tally
from wakefold.io.source import Source

FIELDS: dict[str, tuple[tuple[str, ...], delimited.Kind]] = {
    "agent": (("mmsi",), "integer"),
    "time": (("basedatetime",), "time"),
    "lon": (("lon", "longitude"), "lon"),
    "lat": (("lat", "latitude"), "lat"),
    "sog": (("sog",), "float32"),
    "cog": (("cog",), "float32"),
    "heading": (("heading",), "float32"),
    "name": (("vesselname", "name"), "text"),
    "callsign": (("callsign",), "text"),
    "type": (("vesseltype",), "float32"),
    "destination": (("destination",), "text"),
    "length": (("length",), "float32"),
    "width": (("width",), "float32"),
}
DANISH: dict[str, tuple[tuple[str, ...], delimited.Kind]] = {
    **FIELDS,
    "time": (("timestamp",), "time"),
    "type": (("shiptype",), "text"),
    "mobile": (("typeofmobile",), "text"),
}
"""Our name, the names in the files (as ``sniff.plain`` makes them), and the kind of value."""
ATTRIBUTES = ("name", "callsign", "type", "destination", "length", "width")
DMA_TIME = "%d/%m/%Y %H:%M:%S"
FIXED = pa.array([b"Base Station", b"AtoN"])
NOTHING = pa.array([b"Unknown", b"Undefined"])
"""What the Danish files write where nothing is known."""


def read(source: Source, tally: Tally, danish: bool, time_format: str | None) -> Iterator[Rows]:
    """Batches of rows of a MarineCadastre or (``danish``) Danish Maritime Authority file."""
    layout = delimited.layout(source.head, is_header=_is_header)
    names = [plain(name) for name in layout.names]
    wanted: dict[str, tuple[int, delimited.Kind]] = {}
    for ours, (theirs, kind) in (DANISH if danish else FIELDS).items():
        position = next((names.index(name) for name in theirs if name in names), None)
        if position is not None:
            wanted[ours] = (position, kind)
    missing = {"agent", "time", "lon", "lat"} - wanted.keys()
    if missing:
        raise ReadError(f"{source.name}: an AIS table without {', '.join(sorted(missing))}")
    if time_format is None:
        where = wanted["time"][0]
        values = delimited.sample(source.head, layout)[where]
        if danish and any(times.formatted(value, DMA_TIME) == times.formatted(value, DMA_TIME) for value in values):
            time_format = DMA_TIME
        else:
            time_format, notes = clock.form_of(source.name, layout.names[where], values)
            tally.decided(notes)
    for block in delimited.read(source, layout, wanted, time_format):
        tally.rows += len(block.bad)
        tally.reject("bad line", len(block.bad), block.bad)
        yield from _rows(block, tally, danish)


def _is_header(names: Sequence[str]) -> bool:
    there = {plain(name) for name in names}
    return there >= ais.DMA or any(want <= there for want in ais.MARINECADASTRE)


def _rows(block: delimited.Block, tally: Tally, danish: bool) -> Iterator[Rows]:
    n = len(block.lines)
    if not n:
        return
    nothing = np.full(n, np.nan, dtype=np.float32)
    motion = (block.floats(name) if name in block.columns else nothing for name in ("sog", "cog", "heading"))
    rows = Rows(
        agent=_mmsi(block.columns["agent"]),
        time=block.doubles("time"),
        position=(block.doubles("lon"), block.doubles("lat")),
        geodetic=True,
        lines=block.lines,
        text=block.text,
        columns=ais.motion(*motion),
        whole_turn=False,
        attributes={
            name: _attribute(name, block.columns[name], danish) for name in ATTRIBUTES if name in block.columns
        },
    )
    if "mobile" in block.columns:
        fixed = pc.is_in(block.columns["mobile"], FIXED).to_numpy(zero_copy_only=False)
        tally.rows += int(fixed.sum())
        tally.reject("fixed station", int(fixed.sum()), rows.named(np.flatnonzero(fixed)))
        rows = rows.where(~fixed)
    yield rows


def _mmsi(values: pa.Array) -> pa.Array:
    """Identities as the parser gives them, or, of a block in which some are no numbers, as text in the same form."""
    if pa.types.is_integer(values.type):
        return values
    texts = [as_text(value) for value in values.to_pylist()]
    return pa.array([str(int(text)) if text.isdecimal() else text for text in texts], pa.string())


def _attribute(name: str, values: pa.Array | np.ndarray, danish: bool) -> pa.Array | np.ndarray:
    """Sizes with 0 (not available) as NaN; type codes as text; texts without the Danish words for nothing."""
    if isinstance(values, np.ndarray):
        known = np.where((values > 0) & (values < 1e6), values, np.nan)
        return pa.array(known, from_pandas=True).cast(pa.int32(), safe=False) if name == "type" else known
    return pc.if_else(pc.is_in(values, NOTHING), b"", values) if danish else values
