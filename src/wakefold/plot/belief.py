"""A belief over time and level, after Figure 6 of Hawasly et al. (2016)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from wakefold.base.units import DAY
from wakefold.base.wording import duration_text
from wakefold.model.filtration import Filtration
from wakefold.plot.canvas import (
    BACKDROP,
    INK,
    PALETTE,
    SMALL,
    Box,
    box_around,
    draw_lines,
    ground,
    legend_below,
    length_text,
    lines_of,
    size_of,
    styled,
)
from wakefold.tracks.tracks import Tracks


class Moment(NamedTuple):
    """What was believed at one time, as plain arrays.

    Attributes:
        time: seconds UTC since 1970.
        levels: level (metres) -> (class ids alive there ``(K,)``, their probabilities ``(K,)``).
        estimate: ``(2,)`` estimated position, metres.
        truth: ``(2,)`` true position, where known.
        observed: ``(n, 2)`` all fixes up to this time.
    """

    time: float
    levels: Mapping[float, tuple[ArrayLike, ArrayLike]]
    estimate: ArrayLike | None = None
    truth: ArrayLike | None = None
    observed: ArrayLike | None = None


@styled
def beliefs(
    tracks: Tracks,
    tree: Filtration,
    moments: Sequence[Moment],
    *,
    box: Box | None = None,
    coastline: str | Path | None = None,
) -> Figure:
    """A belief over time (rows, downwards) and level (columns, finest first), after Figure 6 of Hawasly et al. 2016.

    A panel shows the tracks of the classes alive at its level, each class the more strongly coloured the more
    probable it is; dots are the fixes so far, the cross the estimate, the ring the truth.

    Args:
        tracks: those the filtration was built from.
        moments: one per row; all have the same levels.
        box: what to show, metres; without it, all tracks that at a finer level ever belong to a class of 10 % or more.
        coastline: a GeoJSON file, degrees.
    """
    if not moments:
        raise ValueError("no moments to draw")
    levels = sorted(moments[0].levels)
    if any(sorted(moment.levels) != levels for moment in moments):
        raise ValueError("all moments must have the same levels")
    box = box or _belief_box(tracks, tree, moments, levels)
    width, height = size_of(box, 2.0)
    figure = Figure(figsize=(0.8 + width * len(levels), 0.9 + height * len(moments)), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0.01, hspace=0.01)  # type: ignore[union-attr]
    panels = figure.subplots(len(moments), len(levels), squeeze=False)
    lines = lines_of(tracks, box, pixels=800)
    colours = _belief_colours(tree, moments, levels)
    for column, level in enumerate(levels):
        classes = tree.alive(level)
        panels[0, column].set_title(
            f"level {length_text(level, tracks.projection)}\n{len(classes):,} classes", fontsize=8
        )
        for row, moment in enumerate(moments):
            ax = panels[row, column]
            ground(ax, box, tracks.projection, coastline, labels=False)
            draw_lines(ax, lines, colors=BACKDROP, linewidths=0.35, zorder=1)
            ids, probabilities = (np.asarray(values) for values in moment.levels[level])
            # Shades, not transparency: overlapping tracks of an unlikely class would add up to a dark one.
            drawn, shades, widths = [], [], []
            for k in np.argsort(probabilities, kind="stable"):
                members = tree.members(int(ids[k])) if probabilities[k] >= 0.005 else []
                drawn += [lines[i] for i in members]
                shades += [_shade(colours[level][int(ids[k])], float(probabilities[k]))] * len(members)
                widths += [0.6 if len(members) > 3 else 1.2] * len(members)
            draw_lines(ax, drawn, colors=shades, linewidths=widths)
            _marks(ax, moment)
            best = int(np.argmax(probabilities))
            count = len(tree.members(int(ids[best])))
            ax.text(
                0.03,
                0.03,
                f"{probabilities[best]:.0%}  {count:,} track{'s' * (count > 1)}",
                fontsize=6.5,
                transform=ax.transAxes,
                color=INK,
                bbox={"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 1.0},
                zorder=6,
            )
    for row, moment in enumerate(moments):
        panels[row, 0].set_ylabel(_clock(moment.time, moments[0].time), fontsize=7.5)
    legend_below(figure, _belief_legend(moments), 8, handletextpad=0.4)
    return figure


def _belief_box(tracks: Tracks, tree: Filtration, moments: Sequence[Moment], levels: Sequence[float]) -> Box:
    likely: set[int] = set()
    for moment in moments:
        for level in levels[: (len(levels) + 1) // 2]:
            ids, probabilities = (np.asarray(values) for values in moment.levels[level])
            likely.update(*(tree.members(int(c)).tolist() for c in ids[probabilities >= 0.1]))
    places = [tracks[i][:, :2] for i in sorted(likely)]
    for moment in moments:
        places += [np.reshape(p, (-1, 2)) for p in moment[2:] if p is not None]
    return box_around(np.concatenate(places) if places else tracks.points, slimmest=0.8)


def _belief_colours(
    tree: Filtration, moments: Sequence[Moment], levels: Sequence[float]
) -> dict[float, dict[int, str]]:
    """Per level, colours for the nine classes that were ever the most probable; the others are grey.

    From coarse to fine the most probable class inside a coloured one takes over its colour, so a colour can be
    followed from column to column, and no colour comes twice in one.
    """
    out: dict[float, dict[int, str]] = {}
    coarser: dict[int, str] = {}
    for level in reversed(levels):
        highest: dict[int, float] = {}
        for moment in moments:
            ids, probabilities = (np.asarray(values).tolist() for values in moment.levels[level])
            for c, p in zip(ids, probabilities, strict=True):
                highest[c] = max(p, highest.get(c, 0.0))
        ranked = sorted(highest, key=lambda c: (-highest[c], c))
        foremost = ranked[: len(PALETTE)]
        colours: dict[int, str] = {}
        for d, colour in coarser.items():
            heir = next((c for c in foremost if tree.lo[d] <= tree.lo[c] < tree.hi[d]), None)
            if heir is not None:
                colours[heir] = colour
        free = [colour for colour in PALETTE if colour not in colours.values()]
        colours |= dict(zip([c for c in foremost if c not in colours], free, strict=False))
        coarser = colours
        out[level] = {c: colours.get(c, SMALL) for c in ranked}
    return out


def _marks(ax: Axes, moment: Moment) -> None:
    if moment.observed is not None:
        fixes = np.reshape(moment.observed, (-1, 2))
        ax.plot(*fixes.T, "-o", color="black", linewidth=0.4, markersize=1.8, markeredgewidth=0, zorder=4)
    if moment.truth is not None:
        ax.scatter(*np.asarray(moment.truth), s=45, facecolors="none", edgecolors="black", linewidths=0.9, zorder=5)
    if moment.estimate is not None:
        ax.scatter(*np.asarray(moment.estimate), s=32, marker="x", color="#d00000", linewidths=1.2, zorder=5)


def _belief_legend(moments: Sequence[Moment]) -> list[Line2D]:
    shades = [(0.05, "5 %"), (0.25, "25 %"), (0.5, "50 %"), (1.0, "100 %")]
    handles = [Line2D([], [], color=_shade(PALETTE[0], p), linewidth=3, label=label) for p, label in shades]
    marks = [
        ("observed", "fixes so far", {"marker": ".", "color": "black", "markersize": 4}),
        ("estimate", "estimate", {"marker": "x", "color": "#d00000", "markersize": 5}),
        ("truth", "truth", {"marker": "o", "color": "black", "markerfacecolor": "none", "markersize": 6}),
    ]
    for name, label, look in marks:
        if any(getattr(moment, name) is not None for moment in moments):
            handles.append(Line2D([], [], linestyle="none", label=label, **look))
    return handles


def _shade(colour: str, probability: float) -> tuple[float, float, float]:
    """The colour laid over the backdrop; by the square root, as a class of 5 % must still be seen."""
    share = np.sqrt(probability)
    red, green, blue = (1 - share) * np.array(to_rgb(BACKDROP)) + share * np.array(to_rgb(colour))
    return float(red), float(green), float(blue)


def _clock(time: float, start: float) -> str:
    moment = datetime.fromtimestamp(time, UTC)
    elapsed = f"+{duration_text(time - start)}" if time > start else "start"
    return f"{moment:%d %b %H:%M}\n{elapsed}" if time > DAY else elapsed
