"""Figure 3 of 2016, 1 (right) of 2017: when classes merge, so do the regions of the plane nearest to them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from wakefold import plot
from wakefold.experiments.mhpf import datasets
from wakefold.experiments.registry import Claim, Picture, Section, Size, no_jobs
from wakefold.model.filtration import Filtration
from wakefold.plot.canvas import INK, PALETTE, draw_lines, ground, styled
from wakefold.tracks.tracks import Tracks

TITLE = "Figure 3: regions of classes merge with them"
ACROSS = 400  # cells
jobs = no_jobs


def report(results: list[Any], size: Size, folder: Path) -> Section:
    tracks = datasets.common_ends()
    tree = Filtration.fit(tracks, threads=1)
    levels = [0.0, 0.15, 0.235, 0.245]
    regions = [_region(tracks, tree, b) for b in levels]
    plot.save(_picture(tracks, tree, levels, regions), folder / "fig3.png")
    return Section(
        TITLE,
        [
            "Every place belongs to the class that has the nearest track point: a union of Voronoi cells. As the "
            "level rises classes merge, their regions merge, and their probabilities add up: by construction, as "
            "classes are nested."
        ],
        [Picture(folder / "fig3.png", "Regions of the classes of 13 tracks at four levels.", 1080)],
        [
            Claim(
                "Merging classes is merging regions",
                "shown in a picture",
                ", ".join(f"{len(np.unique(r))} regions at level {b:g}" for b, r in zip(levels, regions, strict=True)),
            )
        ],
    )


def _region(tracks: Tracks, tree: Filtration, level: float) -> np.ndarray:
    """Rank of the first track of the class at each cell of a grid, (rows, columns)."""
    from scipy.spatial import KDTree

    at = (np.arange(ACROSS) + 0.5) / ACROSS
    places = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    _, rows = KDTree(tracks.points).query(places)
    rank = tree.rank[np.repeat(np.arange(len(tracks)), tracks.lengths)][rows]
    cuts = tree.cuts(level)
    return cuts[np.searchsorted(cuts, rank, side="right") - 1].reshape(ACROSS, ACROSS)


@styled
def _picture(tracks: Tracks, tree: Filtration, levels: list[float], regions: list[np.ndarray]) -> Figure:
    figure = Figure(figsize=(2.7 * len(levels), 2.9), layout="constrained")
    colours = ListedColormap([*PALETTE, "#cccccc", "#8c6d31", "#e7969c", "#5254a3"])
    for ax, level, region in zip(figure.subplots(1, len(levels)), levels, regions, strict=True):
        ground(ax, (0.0, 0.0, 1.0, 1.0), labels=False)
        ax.imshow(region, origin="lower", extent=(0, 1, 0, 1), cmap=colours, vmin=0, vmax=12, alpha=0.45, zorder=0)
        draw_lines(ax, list(tracks), colors=INK, linewidths=0.6)
        ax.set_title(f"level {level:.3f}: {len(tree.alive(level))} classes")
    return figure
