"""A picture of forecasts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike

from wakefold.base.wording import duration_text
from wakefold.plot.canvas import (
    BACKDROP,
    INK,
    PALETTE,
    box_around,
    draw_lines,
    ground,
    legend_below,
    lines_of,
    size_of,
    styled,
)
from wakefold.tracks.tracks import Tracks


class Ahead(NamedTuple):
    """A forecast for one horizon.

    Attributes:
        seconds: how far ahead.
        particles: ``(N, 2)`` positions, metres.
        weights: ``(N,)`` sum 1; equal if not given.
        truth: ``(2,)`` where the agent really was then, where known.
        constant_velocity: ``(2,)`` where it would have been at constant velocity.
    """

    seconds: float
    particles: ArrayLike
    weights: ArrayLike | None = None
    truth: ArrayLike | None = None
    constant_velocity: ArrayLike | None = None


@styled
def forecast(
    tracks: Tracks,
    history: ArrayLike,
    ahead: Sequence[Ahead],
    *,
    truth: ArrayLike | None = None,
    coastline: str | Path | None = None,
) -> Figure:
    """Particles ahead in time, with the truth and constant velocity beside them.

    Args:
        tracks: past traffic, drawn as backdrop; its plane is the picture's.
        history: ``(n, 2)`` fixes up to now, metres.
        ahead: one per horizon.
        truth: ``(n, 2)`` the true path from now on, where known.
        coastline: a GeoJSON file, degrees.
    """
    if not ahead:
        raise ValueError("no horizons to draw")
    past = np.reshape(np.asarray(history, dtype=np.float64), (-1, 2))
    path = np.empty((0, 2)) if truth is None else np.reshape(np.asarray(truth, dtype=np.float64), (-1, 2))
    places = [past, path]
    for item in ahead:
        places += [
            np.reshape(p, (-1, 2)) for p in (item.particles, item.truth, item.constant_velocity) if p is not None
        ]
    box = box_around(np.concatenate(places), margin=0.15)
    figure = Figure(figsize=size_of(box, 6.4, room=(0.6, 0.7)), layout="constrained")
    ax = figure.subplots()
    ground(ax, box, tracks.projection, coastline)
    draw_lines(ax, lines_of(tracks, box), colors=BACKDROP, linewidths=0.4, zorder=1)
    ax.plot(*past.T, "-o", color="black", linewidth=1.0, markersize=2.5, zorder=3)
    ax.plot(*path.T, color="black", linewidth=1.0, linestyle=(0, (1, 1.5)), zorder=3)
    handles = [Line2D([], [], color="black", marker="o", markersize=2.5, linewidth=1, label="fixes so far")]
    if len(path):
        handles.append(Line2D([], [], color="black", linewidth=1, linestyle=(0, (1, 1.5)), label="truth"))
    for k, item in enumerate(ahead):
        colour = PALETTE[k % len(PALETTE)]
        cloud = np.reshape(np.asarray(item.particles, dtype=np.float64), (-1, 2))
        weights = np.full(len(cloud), 1 / len(cloud)) if item.weights is None else np.asarray(item.weights)
        sizes = np.clip(10 * len(cloud) * weights, 1.0, 40.0)
        ax.scatter(*cloud.T, s=sizes, color=colour, alpha=0.45, linewidths=0, zorder=2)
        dot: dict[str, Any] = {"marker": "o", "markersize": 4, "linestyle": "none"}
        handles.append(Line2D([], [], color=colour, label=f"in {duration_text(item.seconds)}", **dot))
        # A white rim keeps the marks apart from a cloud of their own colour.
        mark: dict[str, Any] = {
            "linewidths": 1.4,
            "zorder": 5,
            "path_effects": [withStroke(linewidth=3.5, foreground="white")],
        }
        if item.truth is not None:
            ax.scatter(*np.asarray(item.truth), s=60, facecolors="none", edgecolors=colour, **mark)
        if item.constant_velocity is not None:
            ax.scatter(
                *np.asarray(item.constant_velocity),
                s=40,
                marker="s",
                facecolors="none",
                edgecolors=colour,
                **mark,
            )
        ax.scatter(*(weights @ cloud), s=45, marker="x", color=colour, **mark)
    hollow: dict[str, Any] = {"color": INK, "linestyle": "none", "markerfacecolor": "none"}
    handles.append(Line2D([], [], marker="x", markersize=5, label="mean", **hollow))
    if any(item.truth is not None for item in ahead):
        handles.append(Line2D([], [], marker="o", markersize=7, label="truth then", **hollow))
    if any(item.constant_velocity is not None for item in ahead):
        handles.append(Line2D([], [], marker="s", markersize=6, label="constant velocity", **hollow))
    legend_below(figure, handles, 5)
    return figure
