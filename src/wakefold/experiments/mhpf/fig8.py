"""Figure 8 of 2016: density of tanker traffic, and the classes of the walks over it at one level."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from wakefold import plot
from wakefold.experiments.mhpf import datasets
from wakefold.experiments.mhpf.rasters import TANKERS, traffic
from wakefold.experiments.registry import Picture, Section, Size, no_jobs
from wakefold.model.filtration import Filtration
from wakefold.plot.canvas import PALETTE, SINGLE, draw_lines, ground, styled
from wakefold.tracks.tracks import Tracks

TITLE = "Figure 8: density of traffic and classes of 194 walks over it"
LEVEL = 14.0  # cells; the paper's is 70 of its units
jobs = no_jobs


def report(results: list[Any], size: Size, folder: Path) -> Section:
    raster, starts = traffic(size.tankers)
    tracks = datasets.walks(raster, starts)
    tree = Filtration.fit(tracks, threads=1)
    level = LEVEL * raster.cell
    plot.save(_picture(raster, tracks, tree, level), folder / "fig8.png")
    sizes = np.sort(np.diff(tree.cuts(level)))[::-1]
    return Section(
        TITLE,
        [
            "The paper's raster was traffic density published by MarineCadastre; 194 random walks over it prefer "
            "denser cells and seldom turn. "
            + (
                "Ours is synthetic, so that anybody can check what follows from it: ports on a northern coast, three "
                "ways to the sea, lanes of differing use (mhpf.datasets, seed 0). With --raster it is counted "
                "from a file of tracks."
                if size.tankers == TANKERS
                else "This one was counted from the file given by --raster; walks start from its nine busiest places."
            ),
        ],
        [Picture(folder / "fig8.png", f"Left: density. Right: the walks, classes at level {level:g} in colour.", 1080)],
        notes=[
            f"{len(sizes)} classes at level {level:g}: the largest hold {', '.join(map(str, sizes[:5]))} walks, "
            f"{int((sizes == 1).sum())} walks are alone."
        ],
    )


@styled
def _picture(raster: datasets.Raster, tracks: Tracks, tree: Filtration, level: float) -> Figure:
    figure = Figure(figsize=(11.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    rows, columns = raster.density.shape
    x0, y0 = raster.origin.tolist()
    box = (x0, y0, x0 + columns * raster.cell, y0 + rows * raster.cell)
    for ax in (left, right):
        ground(ax, box)
    left.imshow(raster.density, origin="lower", extent=(box[0], box[2], box[1], box[3]), cmap="Blues", aspect="equal")
    left.set_title("traffic density (logarithmic)")
    alive = tree.alive(level)
    sizes = tree.hi[alive] - tree.lo[alive]
    order = np.argsort(-sizes, kind="stable")
    for place, k in reversed(list(enumerate(order.tolist()))):
        coloured = place < len(PALETTE) and sizes[k] > 1
        lines = [tracks[int(i)] for i in tree.members(int(alive[k]))]
        draw_lines(right, lines, colors=PALETTE[place] if coloured else SINGLE, linewidths=0.7 if coloured else 0.4)
    right.set_title(f"{len(tracks)} walks in {len(alive)} classes at level {level:g}")
    return figure
