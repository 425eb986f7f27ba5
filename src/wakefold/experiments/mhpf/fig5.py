"""Figure 5 of 2016, 3 (left) of 2017: the data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import Circle

from wakefold import plot
from wakefold.experiments.mhpf import datasets
from wakefold.experiments.registry import Picture, Section, Size, no_jobs
from wakefold.model.filtration import Filtration
from wakefold.plot.canvas import BACKDROP, INK, PALETTE, ground, styled

TITLE = "Figure 5: the data"
jobs = no_jobs


def report(results: list[Any], size: Size, folder: Path) -> Section:
    plot.save(_picture(), folder / "fig5.png")
    return Section(
        TITLE,
        [
            "The papers drew theirs with a mouse in the unit square and did not release them. Ours are generated "
            "(mhpf.datasets, seed 0): 33 ways around obstacles between general starts and goals, and 13 tracks "
            "with a common start and a common end. Points are 0.02 apart, one step of time from each to the next.",
        ],
        [
            Picture(
                folder / "fig5.png", "Left: configuration space with obstacles. Right: common ends. Dots: starts.", 900
            )
        ],
    )


@styled
def _picture() -> Figure:
    figure = Figure(figsize=(9.2, 4.8), layout="constrained")
    for ax, name in zip(figure.subplots(1, 2), ("configuration_space", "common_ends"), strict=True):
        tracks = getattr(datasets, name)()
        tree = Filtration.fit(tracks, threads=1)
        ground(ax, (0.0, 0.0, 1.0, 1.0))
        if name == "configuration_space":
            for x, y, radius in datasets.OBSTACLES:
                ax.add_patch(Circle((x, y), radius, facecolor=BACKDROP, edgecolor="none", zorder=0))
        for k, c in enumerate(tree.alive(0.15).tolist()):
            members = tree.members(c)
            for i in members:
                colour = PALETTE[k % len(PALETTE)] if len(members) > 1 else "#7d8891"
                ax.plot(*tracks[int(i)].T, color=colour, linewidth=0.9)
        ax.scatter(*tracks.points[tracks.offsets[:-1]].T, s=9, color=INK, zorder=3, linewidths=0)
        ax.set_title(f"{len(tracks)} tracks, {len(tracks.points):,} points; colours: classes at level 0.15")
    return figure
