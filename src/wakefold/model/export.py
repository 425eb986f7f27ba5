"""The filtration for other programs: classes of a level as GeoJSON, merges as a linkage matrix, the tree as Newick.

The path "-" is standard output.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wakefold.base.files import opened
from wakefold.tracks.projection import cut_at_seam

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.tracks.tracks import Tracks


def write_classes(tracks: Tracks, tree: Filtration, level: float, path: Path) -> None:
    """The classes alive at a level as GeoJSON (RFC 7946): a feature for each, the largest first, its tracks as lines.

    A track that crosses the antimeridian is cut there (RFC 7946, 3.1.9).

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
            lines = [part for i in members for part in _lines(places[i])]
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


def _lines(lonlat: np.ndarray) -> list[list[list[float]]]:
    parts = [np.round(part, 6).tolist() for part, _ in cut_at_seam(lonlat)]
    return [part if len(part) > 1 else part * 2 for part in parts]  # a line needs two positions
