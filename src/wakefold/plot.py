"""Pictures: tracks, the filtration beside its tracks, beliefs over time and level, forecasts, relations, events.

Every function returns a `matplotlib.figure.Figure` of its own: no global state, no display needed, and the same
input gives the same file. Write it with `save`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike, NDArray

from wakefold.filtration import Filtration
from wakefold.plot_belief import Moment, beliefs
from wakefold.plot_events import event
from wakefold.plot_map import (
    BACKDROP,
    INK,
    PALETTE,
    SINGLE,
    SMALL,
    STYLE,
    box_around,
    draw_lines,
    ground,
    length_text,
    lines_of,
    size_of,
    styled,
)
from wakefold.plot_scene import relations
from wakefold.plot_tree import dendrogram
from wakefold.tracks import Tracks
from wakefold.wording import duration_text

__all__ = ["Ahead", "Moment", "beliefs", "event", "filtration", "forecast", "relations", "save", "tracks"]


class Ahead(NamedTuple):
    """A forecast for one horizon.

    Attributes:
        seconds: how far ahead.
        particles: ``(N, 2)`` positions, metres.
        weights: ``(N,)`` sum 1; equal without.
        truth: ``(2,)`` where the agent really was then, where known.
        constant_velocity: ``(2,)`` where it would have been at constant velocity.
    """

    seconds: float
    particles: ArrayLike
    weights: ArrayLike | None = None
    truth: ArrayLike | None = None
    constant_velocity: ArrayLike | None = None


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as the file's ending says (png, svg, pdf); the same figure gives the same bytes."""
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(Path(path).suffix.lower(), {})
    with rc_context(cast(Any, STYLE)):
        figure.savefig(path, metadata=undated)


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
    figure.legend(handles=handles, loc="outside lower center", ncols=min(4, len(handles)))
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
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    return figure
