"""Figure 1 of both papers: the classes of the Y-junction by rising birth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from wakefold import plot
from wakefold.experiments.mhpf import datasets
from wakefold.experiments.registry import Claim, Picture, Section, Size, no_jobs
from wakefold.model.filtration import Filtration
from wakefold.plot.canvas import BACKDROP, PALETTE, draw_lines, ground, styled
from wakefold.tracks.tracks import Tracks

TITLE = "Figure 1: classes of a Y-junction by birth"
UNIT = (0.0, 0.0, 1.0, 1.0)
jobs = no_jobs


def report(results: list[Any], size: Size, folder: Path) -> Section:
    tracks = datasets.junction()
    tree = Filtration.fit(tracks, threads=1)
    plot.save(_births(tracks, tree), folder / "fig1.png")
    # The ways through the junction: up and left, up and right, down, across. Between which births are they the level?
    ways = [range(5), range(5, 10), range(10, 12), range(12, 14)]
    parts = [
        set(map(frozenset, (tree.members(c).tolist() for c in tree.alive(b)))) == set(map(frozenset, ways))
        for b in sorted(tree.birth)
    ]
    stays = [b for b, right in zip(sorted(tree.birth), parts, strict=True) if right]
    ends = min((b for b in sorted(tree.birth) if stays and b > stays[-1]), default=0.0)
    return Section(
        TITLE,
        [
            "14 walks through a Y-junction, clustered by single linkage under the discrete Fréchet distance. A panel "
            "for each class that is born, the class in colour, all other tracks pale."
        ],
        [Picture(folder / "fig1.png", "Each class at its birth b, in the order of births.", 1000)],
        [
            Claim(
                "The tree groups the walks by their way through the junction",
                "shown in a picture",
                f"exactly the four ways form the levels from {stays[0]:.3f} to {ends:.3f}"
                if stays
                else "no level does",
                "",
                "holds" if stays else "does not hold",
            )
        ],
    )


@styled
def _births(tracks: Tracks, tree: Filtration) -> Figure:
    inner = range(len(tree), tree.root + 1)
    columns = 5
    rows = -(-len(inner) // columns)
    figure = Figure(figsize=(columns * 1.8, rows * 1.95), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    lines = list(tracks)
    for ax, c in zip(axes, inner, strict=False):
        ground(ax, UNIT, labels=False)
        draw_lines(ax, lines, colors=BACKDROP, linewidths=0.7)
        draw_lines(ax, [lines[i] for i in tree.members(c)], colors=PALETTE[c % len(PALETTE)], linewidths=1.1)
        ax.set_title(f"b = {tree.birth[c]:.3f}: {tree.hi[c] - tree.lo[c]} tracks", fontsize=8)
    for ax in axes[len(inner) :]:
        ax.set_axis_off()
    return figure
