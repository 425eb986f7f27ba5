"""What the commands say of a file of tracks or of a model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wakefold.base.wording import counted, number_text
from wakefold.io import read_tracks
from wakefold.model.model import load
from wakefold.tracks.projection import dated
from wakefold.tracks.tracks import Tracks

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.model.model import Model


def about(path: Path, settings: dict[str, Any], progress: Callable[[int, int], None]) -> tuple[str, dict[str, Any]]:
    """What a file of tracks, or the directory of a model, holds: for people, and in plain types for JSON.

    Args:
        settings: of ``read_tracks``.

    Raises:
        ReadError, StoreError: it is neither.
    """
    if path.is_dir():
        model = load(path)
        facts = {"path": str(path), "kind": "model", **model_facts(model), **_extent(model.tracks)}
        return "\n".join([f"{path}: {model!r}", *_said(facts), level_table(model.filtration)]), facts
    tracks, report = read_tracks(path, **settings, progress=progress)
    facts = {"path": str(path), "kind": "tracks", "tracks": len(tracks), "points": len(tracks.points)}
    facts |= _extent(tracks) | {"report": report.to_dict()}
    return "\n".join([str(report), *_said(facts)]), facts


def _extent(tracks: Tracks) -> dict[str, Any]:
    """Who, when, where, how far."""
    low, high = tracks.points.min(axis=0), tracks.points.max(axis=0)
    out: dict[str, Any] = {
        "agents": len(np.unique(tracks.attributes.get("agent", tracks.ids))),
        "time": [float(tracks.times.min()), float(tracks.times.max())],
        "geodetic": tracks.projection is not None,
        "dated": dated(tracks.projection, float(tracks.times.min())),
        "area": {"low": low.tolist(), "high": high.tolist()},
        "median": {
            "points": float(np.median(tracks.lengths)),
            "metres": float(np.median(tracks.length)),
            "seconds": float(np.median(tracks.duration)),
            "spacing": _finite(tracks.median_spacing),
            "interval": _finite(tracks.median_interval),
        },
    }
    if tracks.projection is not None:
        east, north = tracks.projection.to_geodetic(tracks.points).T
        west, last = _arc(east)
        out["area"] = {"west": west, "south": north.min(), "east": last, "north": north.max()}
        out["area"] = {name: round(float(value), 6) for name, value in out["area"].items()}
    return out


def _arc(lon: np.ndarray) -> tuple[float, float]:
    """West and east end of the shortest arc that holds all longitudes, degrees within -180..180.

    Where it crosses the antimeridian its west end is the greater number, as in the boxes of GeoJSON (RFC 7946, 5.2).
    """
    lon = np.unique(lon)
    gaps = np.diff(lon, append=lon[0] + 360.0)
    widest = int(np.argmax(gaps))
    return float(lon[(widest + 1) % len(lon)]), float(lon[widest])


def _said(facts: dict[str, Any]) -> list[str]:
    """The same in lines."""
    area, middle, (begin, end) = facts["area"], facts["median"], facts["time"]
    if facts["geodetic"]:
        where = f"{_span(area, 'south', 'north', 'NS')}, {_span(area, 'west', 'east', 'EW')}"
    else:
        spans = zip("xyz", area["low"], area["high"], strict=False)
        where = ", ".join(f"{axis} {low:.6g}..{high:.6g}" for axis, low, high in spans)
    if facts["dated"]:
        clock = [str(np.datetime64(round(t), "s")).replace("T", " ") for t in (begin, end)]
        when = f"{clock[0]} to {clock[1]} UTC"
    else:
        when = f"{begin:.6g} to {end:.6g} s"
    metre = "m" if facts["geodetic"] else "units"  # of a plane that may be in anything
    steps = ""
    if middle["interval"] is not None:
        steps = f"; a point every {number_text(middle['interval'], 4)} s or {number_text(middle['spacing'], 4)} {metre}"
    tracks, agents, points = (counted(facts[what], what[:-1]) for what in ("tracks", "agents", "points"))
    return [
        f"  {tracks} of {agents}, {points}",
        f"  when   {when}",
        f"  where  {where}",
        f"  median track: {number_text(middle['metres'], 4)} {metre} in {number_text(middle['seconds'], 4)} s, "
        f"{middle['points']:,.0f} points{steps}",
    ]


def _span(area: dict[str, float], low: str, high: str, sides: str) -> str:
    """``123.1000°W..75.7000°W``."""
    return "..".join(f"{abs(area[end]):.4f}°{sides[area[end] < 0]}" for end in (low, high))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def level_rows(tree: Filtration) -> list[dict[str, Any]]:
    """A useful handful of levels and what the tree looks like there."""
    rows = []
    for level in dict.fromkeys([0.0, *map(float, tree.levels()), float(tree.birth[tree.root])]):
        sizes = np.diff(tree.cuts(level))
        row = {"classes": len(sizes), "largest": int(sizes.max()), "single": int((sizes == 1).sum())}
        rows.append({"level": level, **row})
    return rows


def model_facts(model: Model) -> dict[str, Any]:
    """A model in plain types, ready for JSON."""
    tracks, tree, dynamics = model.tracks, model.filtration, model.dynamics
    place = tracks.projection
    return {
        "tracks": len(tracks),
        "points": len(tracks.points),
        "classes": len(tree.birth),
        "linkage": tree.linkage,
        "plane": None if place is None else {"lon": place.lon, "lat": place.lat},
        "epsilon": dynamics.epsilon,
        "noise": {"kind": dynamics.noise, "scale": dynamics.scale},
        "sd": model.sd,
        "levels": level_rows(tree),
    }


def level_table(tree: Filtration) -> str:
    """``level_rows`` for people."""
    lines = [f"{'level (m)':>12}{'classes':>9}{'largest':>9}{'single tracks':>15}"]
    for row in level_rows(tree):
        lines.append(f"{number_text(row['level'], 6):>12}{row['classes']:>9,}{row['largest']:>9,}{row['single']:>15,}")
    return "\n".join(lines)
