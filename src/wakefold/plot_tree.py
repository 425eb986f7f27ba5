"""The dendrogram of a filtration, readable for many hundreds of tracks."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from wakefold.filtration import Filtration
from wakefold.plot_map import INK, PALE, length_text
from wakefold.projection import Projection

Floats = NDArray[np.float64]


def dendrogram(
    ax: Axes, tree: Filtration, level: float, colours: dict[int, str], projection: Projection | None
) -> None:
    """Every class as an upright from its birth to its death over the middle of its ranks, siblings joined by a bar.

    Single tracks hang just below the class they join, not from zero: with hundreds of them the tree would be a wall.
    """
    positive = tree.gaps[tree.gaps > 0]
    top = float(tree.birth[tree.root]) or 1.0
    logarithmic = len(positive) > 0 and top > 20 * np.quantile(positive, 0.05)
    floor = float(positive.min()) / 2 if logarithmic else 0.0
    ceiling = top * (1.3 if logarithmic else 1.05)
    middle = (tree.lo + tree.hi - 1) / 2
    above = np.clip(tree.death, floor, ceiling)
    below = np.maximum(tree.birth, floor)
    leaves = slice(0, len(tree))
    below[leaves] = np.maximum(floor, above[leaves] / 1.2 if logarithmic else above[leaves] - 0.02 * top)
    cut = np.clip(level, below, above)

    # Up to the cut a class has the colour of the class it belongs to at this level.
    alive = np.array(list(colours))
    home = alive[np.searchsorted(tree.lo[alive], tree.lo, side="right") - 1]
    shade = np.array([colours[int(c)] for c in home])
    under, over = tree.birth <= level, tree.death > level
    inner = np.arange(len(tree), len(middle))
    first, last = np.full(len(middle), np.inf), np.full(len(middle), -np.inf)
    np.minimum.at(first, tree.parent[: tree.root], middle[: tree.root])
    np.maximum.at(last, tree.parent[: tree.root], middle[: tree.root])

    def draw(x0: Floats, y0: Floats, x1: Floats, y1: Floats, colour: str | list[str], width: float) -> None:
        ends = np.stack([np.stack([x0, y0], axis=1), np.stack([x1, y1], axis=1)], axis=1)
        ax.add_collection(LineCollection(list(ends), colors=colour, linewidths=width))

    upper, lower = inner[~under[inner]], inner[under[inner]]
    draw(first[upper], below[upper], last[upper], below[upper], PALE, 0.4)
    draw(middle[over], cut[over], middle[over], above[over], PALE, 0.4)
    draw(first[lower], below[lower], last[lower], below[lower], shade[lower].tolist(), 0.8)
    draw(middle[under], below[under], middle[under], cut[under], shade[under].tolist(), 0.6)
    ax.axhline(max(level, floor), color=INK, linewidth=0.9, linestyle=(0, (5, 3)))
    # A strip along the foot of the tree: which ranks belong to which class.
    foot = ax.get_xaxis_transform()
    for c in alive.tolist():
        corner, width = (float(tree.lo[c]) - 0.5, -0.03), float(tree.hi[c] - tree.lo[c])
        ax.add_patch(Rectangle(corner, width, 0.02, color=colours[c], linewidth=0, clip_on=False, transform=foot))
    ax.set_xlim(-0.5, len(tree) - 0.5)
    if logarithmic:
        ax.set_yscale("log")
    ax.set_ylim(floor, ceiling)
    ax.yaxis.set_major_formatter(lambda height, _: length_text(height, projection))
    ax.tick_params(axis="x", pad=10, length=0)
    ax.set_xlabel("tracks in the order of the tree")
    ax.set_ylabel("discrete Fréchet distance at which classes join")
    ax.spines[["top", "right", "bottom"]].set_visible(False)
    ax.set_title("the tree of classes, cut at this level")
