"""A picture of all tracks on the map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from wakefold.plot.ahead import Ahead, forecast
from wakefold.plot.belief import Moment, beliefs
from wakefold.plot.canvas import (
    PALETTE,
    box_around,
    draw_lines,
    ground,
    lines_of,
    save,
    size_of,
    styled,
)
from wakefold.plot.events import event
from wakefold.plot.scene import relations
from wakefold.plot.tree import filtration
from wakefold.tracks.tracks import Tracks

__all__ = ["Ahead", "Moment", "beliefs", "event", "filtration", "forecast", "relations", "save", "tracks"]


@styled
def tracks(tracks: Tracks, *, coastline: str | Path | None = None) -> Figure:
    """All tracks, with their starts (dots)."""
    box = box_around(tracks.points)
    figure = Figure(figsize=size_of(box, 6.0, room=(0.6, 0.5)), layout="constrained")
    ax = figure.subplots()
    ground(ax, box, tracks.projection, coastline)
    opacity = float(np.clip(30 / max(len(tracks), 1), 0.1, 0.8))
    draw_lines(ax, lines_of(tracks, box), colors=PALETTE[0], linewidths=0.6, alpha=opacity)
    starts = tracks.points[tracks.offsets[:-1], :2]
    ax.scatter(*starts.T, s=4, color=PALETTE[1], linewidths=0, alpha=0.7, zorder=3)
    ax.set_title(f"{len(tracks):,} tracks, {len(tracks.points):,} points")
    return figure
