"""The filtration for other programs: classes of a level as GeoJSON, merges as a linkage matrix, the tree as Newick.

The path "-" is standard output.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wakefold.base.files import opened

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.tracks.tracks import Tracks


def write_classes(tracks: Tracks, tree: Filtration, level: float, path: Path) -> None:
    """The classes alive at a level as GeoJSON (RFC 7946): a feature for each, the largest first, its tracks as lines.

    Longitudes run on past 180 degrees along a track that crosses the antimeridian.

    Raises:
        ValueError: the tracks are planar, which GeoJSON does not know.
    """
    if tracks.projection is None:
        raise ValueError("GeoJSON holds longitude and latitude, and these tracks are planar")
    places = [np.round(tracks.projection.to_geodetic(points), 6) for points in tracks]
    classes = tree.alive(level)
    sizes = tree.hi[classes] - tree.lo[classes]
    with opened(path) as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for count, c in enumerate(classes[np.argsort(-sizes, kind="stable")].tolist()):
            members = sorted(tree.members(c).tolist())
            properties: dict[str, Any] = {"class": c, "level": level, "tracks": len(members)}
            properties |= {"birth": float(tree.birth[c])}
            if np.isfinite(tree.death[c]):  # the root does not die
                properties["death"] = float(tree.death[c])
            properties["members"] = [str(tree.ids[i]) for i in members]
            lines = [_line(places[i]) for i in members]
            geometry = {"type": "MultiLineString", "coordinates": lines}
            feature = {"type": "Feature", "properties": properties, "geometry": geometry}
            file.write((",\n" if count else "\n") + json.dumps(feature, allow_nan=False, ensure_ascii=False))
        file.write("\n]}\n")


def write_linkage(tree: Filtration, path: Path) -> None:
    """The merges as scipy writes them: an array if the name ends in .npy, otherwise CSV with a header."""
    z = tree.linkage_matrix()
    if path.suffix == ".npy":
        np.save(path, z)
        return
    rows = [f"{int(a)},{int(b)},{height!r},{int(size)}\n" for a, b, height, size in z.tolist()]
    with opened(path) as file:
        file.write("left,right,height,tracks\n" + "".join(rows))


def write_newick(tree: Filtration, path: Path) -> None:
    """One line of Newick."""
    with opened(path) as file:
        file.write(tree.newick() + "\n")


def _line(lonlat: np.ndarray) -> list[list[float]]:
    line = np.column_stack([np.unwrap(lonlat[:, 0], period=360.0), lonlat[:, 1]]).round(6).tolist()
    return line if len(line) > 1 else line * 2  # a line needs two positions
