"""The filtration beside its tracks, and its dendrogram, readable for many hundreds of tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.model.filtration import Filtration
from wakefold.plot.canvas import (
    INK,
    PALE,
    PALETTE,
    SINGLE,
    SMALL,
    box_around,
    draw_lines,
    ground,
    legend_below,
    length_text,
    lines_of,
    size_of,
    styled,
)
from wakefold.tracks.projection import Projection
from wakefold.tracks.tracks import Tracks


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


@styled
def filtration(
    tracks: Tracks, tree: Filtration, level: float | None = None, *, coastline: str | Path | None = None
) -> Figure:
    """The tracks coloured by class at one level, beside the dendrogram cut there.

    The nine largest classes have colours, smaller ones are dark grey and single tracks pale.

    Args:
        tracks: those the filtration was built from.
        level: metres; where it is not given, the one of ``tree.levels()`` whose coloured classes say most about a track
            (have the largest entropy).
        coastline: a GeoJSON file, degrees.
    """
    if level is None:
        level = _telling_level(tree)
    alive = tree.alive(level)
    sizes = tree.hi[alive] - tree.lo[alive]
    colours = _class_colours(alive, sizes)
    box = box_around(tracks.points)
    width, height = size_of(box, 5.0, room=(0.6, 1.0))
    figure = Figure(figsize=(width + 5.2, height), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[width, 5.2])

    ground(left, box, tracks.projection, coastline)
    lines = lines_of(tracks, box)
    # Single tracks lowest, then small classes, then the coloured ones, the largest below the smaller.
    for k in np.lexsort((-sizes, sizes > 1, np.isin([colours[c] for c in alive.tolist()], PALETTE))):
        c = int(alive[k])
        single = colours[c] == SINGLE
        members = [lines[i] for i in tree.members(c)]
        draw_lines(left, members, colors=colours[c], linewidths=0.4 if single else 0.8, alpha=0.75)
    left.set_title(f"{len(tracks):,} tracks in {len(alive):,} classes at level {length_text(level, tracks.projection)}")

    dendrogram(right, tree, level, colours, tracks.projection)
    largest = [c for c in alive[np.argsort(-sizes, kind="stable")].tolist() if colours[c] in PALETTE]
    entries = [(colours[c], 2.0, f"class {c}: {tree.hi[c] - tree.lo[c]:,} tracks") for c in largest]
    small, single = (np.array([colours[c] == grey for c in alive.tolist()]) for grey in (SMALL, SINGLE))
    if small.any():
        entries.append((SMALL, 1.5, f"{small.sum():,} smaller classes: {sizes[small].sum():,} tracks"))
    if single.any():
        entries.append((SINGLE, 1.0, f"{single.sum():,} single tracks"))
    handles = [Line2D([], [], color=colour, linewidth=width, label=label) for colour, width, label in entries]
    legend_below(figure, handles, 4)
    return figure


def _telling_level(tree: Filtration) -> float:
    def entropy(level: float) -> float:
        share = np.sort(np.diff(tree.cuts(level)))[::-1][: len(PALETTE)] / len(tree)
        return float(-(share * np.log(share)).sum())

    return max((float(level) for level in tree.levels()), key=entropy, default=0.0)


def _class_colours(classes: NDArray[np.int64], sizes: NDArray[np.int64]) -> dict[int, str]:
    """Colours for the largest classes of two tracks or more; equal sizes by rank, so a picture is repeatable."""
    out = {int(c): SMALL if size > 1 else SINGLE for c, size in zip(classes, sizes, strict=True)}
    largest = np.argsort(-sizes, kind="stable")[: len(PALETTE)]
    for k, colour in zip(largest, PALETTE, strict=False):
        if sizes[k] > 1:
            out[int(classes[k])] = colour
    return out
