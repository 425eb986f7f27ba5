# pyright: reportAttributeAccessIssue=false
# (pyarrow.compute makes its functions when it is imported)
"""Any table, delimited text, Parquet or GeoParquet, whose columns are named by the caller or by themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from wakefold.io.sniff import plain

OBVIOUS: dict[str, tuple[str, ...]] = {
    "track": ("track", "trackid", "trajectoryid", "trajid", "segmentid"),
    "agent": ("agent", "agentid", "mmsi", "id", "objectid", "pedid", "pedestrianid", "vesselid"),
    "time": ("time", "t", "timestamp", "datetime", "basedatetime"),
    "lon": ("lon", "longitude", "lng", "long"),
    "lat": ("lat", "latitude"),
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "sog": ("sog",),
    "cog": ("cog",),
    "heading": ("heading",),
    "name": ("name", "vesselname"),
    "callsign": ("callsign",),
    "type": ("type", "vesseltype", "shiptype"),
    "destination": ("destination",),
    "length": ("length",),
    "width": ("width",),
}
"""What a column is, by its name as ``sniff.plain`` makes it; the first name that is there counts."""


def obvious(names: Sequence[str]) -> dict[str, str] | None:
    """Which column is what by name alone; None if there is no agent or no position among them."""
    by_plain: dict[str, str] = {}
    for name in names:
        by_plain.setdefault(plain(name), name)
    found = {
        ours: next(by_plain[their] for their in theirs if their in by_plain)
        for ours, theirs in OBVIOUS.items()
        if any(their in by_plain for their in theirs)
    }
    return found if complete(found) else None


def complete(columns: Mapping[str, str | int]) -> bool:
    """Whether columns say who and where."""
    there = columns.keys()
    return bool({"track", "agent"} & there) and ({"lon", "lat"} <= there or {"x", "y"} <= there)
