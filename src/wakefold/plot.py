"""Pictures: tracks, the filtration beside its tracks, a belief over time and level, a forecast.

Every function returns a `matplotlib.figure.Figure` of its own: no global state, no display needed, and the same
input gives the same file. Write it with `save`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike, NDArray

from wakefold.filtration import Filtration
from wakefold.plot_map import BACKDROP, INK, PALETTE, STYLE, Box, ground, length_text
from wakefold.plot_tree import dendrogram
from wakefold.tracks import Tracks

Floats = NDArray[np.float64]
P = ParamSpec("P")
SMALL, SINGLE = "#6b7780", "#c4cbd0"  # classes without a colour of their own, and single tracks


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


def _styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with rc_context(cast(Any, STYLE)):
            return draw(*args, **kwargs)

    return styled


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as the file's ending says (png, svg, pdf); the same figure gives the same bytes."""
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(Path(path).suffix.lower(), {})
    with rc_context(cast(Any, STYLE)):
        figure.savefig(path, metadata=undated)


@_styled
def tracks(tracks: Tracks, *, coastline: str | Path | None = None) -> Figure:
    """All tracks, with their starts (dots)."""
    box = _box(tracks.points)
    figure = Figure(figsize=_size(box, 6.0, room=(0.6, 0.5)), layout="constrained")
    ax = figure.subplots()
    ground(ax, box, tracks.projection, coastline)
    opacity = float(np.clip(30 / max(len(tracks), 1), 0.1, 0.8))
    ax.add_collection(LineCollection(_lines(tracks, box), colors=PALETTE[0], linewidths=0.6, alpha=opacity))
    starts = tracks.points[tracks.offsets[:-1], :2]
    ax.scatter(*starts.T, s=4, color=PALETTE[1], linewidths=0, alpha=0.7, zorder=3)
    ax.set_title(f"{len(tracks):,} tracks, {len(tracks.points):,} points")
    return figure


@_styled
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
    box = _box(tracks.points)
    width, height = _size(box, 5.0, room=(0.6, 1.0))
    figure = Figure(figsize=(width + 5.2, height), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[width, 5.2])

    ground(left, box, tracks.projection, coastline)
    lines = _lines(tracks, box)
    # Single tracks lowest, then small classes, then the coloured ones, the largest below the smaller.
    for k in np.lexsort((-sizes, sizes > 1, np.isin([colours[c] for c in alive.tolist()], PALETTE))):
        c = int(alive[k])
        single = colours[c] == SINGLE
        left.add_collection(
            LineCollection(
                [lines[i] for i in tree.members(c)], colors=colours[c], linewidths=0.4 if single else 0.8, alpha=0.75
            )
        )
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


@_styled
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
    width, height = _size(box, 2.0)
    figure = Figure(figsize=(0.8 + width * len(levels), 0.9 + height * len(moments)), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02, wspace=0.01, hspace=0.01)  # type: ignore[union-attr]
    panels = figure.subplots(len(moments), len(levels), squeeze=False)
    lines = _lines(tracks, box, pixels=800)
    colours = _belief_colours(tree, moments, levels)
    for column, level in enumerate(levels):
        classes = tree.alive(level)
        panels[0, column].set_title(
            f"level {length_text(level, tracks.projection)}\n{len(classes):,} classes", fontsize=8
        )
        for row, moment in enumerate(moments):
            ax = panels[row, column]
            ground(ax, box, tracks.projection, coastline, labels=False)
            ax.add_collection(LineCollection(lines, colors=BACKDROP, linewidths=0.35, zorder=1))
            ids, probabilities = (np.asarray(values) for values in moment.levels[level])
            # Shades, not transparency: overlapping tracks of an unlikely class would add up to a dark one.
            drawn, shades, widths = [], [], []
            for k in np.argsort(probabilities, kind="stable"):
                members = tree.members(int(ids[k])) if probabilities[k] >= 0.005 else []
                drawn += [lines[i] for i in members]
                shades += [_shade(colours[level][int(ids[k])], float(probabilities[k]))] * len(members)
                widths += [0.6 if len(members) > 3 else 1.2] * len(members)
            ax.add_collection(LineCollection(drawn, colors=shades, linewidths=widths, zorder=2))
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
    figure.legend(handles=_belief_legend(moments), loc="outside lower center", ncols=8, handletextpad=0.4)
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
    return _box(np.concatenate(places) if places else tracks.points, slimmest=0.8)


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


@_styled
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
    box = _box(np.concatenate(places), margin=0.15)
    figure = Figure(figsize=_size(box, 6.4, room=(0.6, 0.7)), layout="constrained")
    ax = figure.subplots()
    ground(ax, box, tracks.projection, coastline)
    ax.add_collection(LineCollection(_lines(tracks, box), colors=BACKDROP, linewidths=0.4, zorder=1))
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
        handles.append(
            Line2D(
                [], [], color=colour, marker="o", markersize=4, linestyle="none", label=f"in {_duration(item.seconds)}"
            )
        )
        if item.truth is not None:
            ax.scatter(*np.asarray(item.truth), s=60, facecolors="none", edgecolors=colour, linewidths=1.4, zorder=5)
        if item.constant_velocity is not None:
            ax.scatter(
                *np.asarray(item.constant_velocity),
                s=40,
                marker="s",
                facecolors="none",
                edgecolors=colour,
                linewidths=1.4,
                zorder=5,
            )
        ax.scatter(*(weights @ cloud), s=45, marker="x", color=colour, linewidths=1.4, zorder=5)
    hollow: dict[str, Any] = {"color": INK, "linestyle": "none", "markerfacecolor": "none"}
    handles.append(Line2D([], [], marker="x", markersize=5, label="mean", **hollow))
    if any(item.truth is not None for item in ahead):
        handles.append(Line2D([], [], marker="o", markersize=7, label="truth then", **hollow))
    if any(item.constant_velocity is not None for item in ahead):
        handles.append(Line2D([], [], marker="s", markersize=6, label="constant velocity", **hollow))
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    return figure


def _lines(tracks: Tracks, box: Box, pixels: int = 3000) -> list[Floats]:
    """Every track as a line ``(n, 2)`` for a picture of ``box``, without the points that no one could see."""
    x0, y0, x1, y1 = box
    return [p[:, :2] for p in tracks.simplify(max(x1 - x0, y1 - y0) / pixels)]


def _box(points: ArrayLike, margin: float = 0.03, slimmest: float = 0.3) -> Box:
    """What shows all points, with a margin, widened until the shorter side is at least ``slimmest`` of the longer."""
    places = np.asarray(points, dtype=np.float64)
    if not len(places):
        raise ValueError("there is nothing to draw")
    if places.shape[1] < 2:
        raise ValueError("a picture needs two coordinates, these tracks have one")
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    longest = float((high - low).max()) or 1.0
    half = np.maximum((high - low) / 2, longest * slimmest / 2) + longest * margin
    middle = (low + high) / 2
    return (*(middle - half).tolist(), *(middle + half).tolist())


def _size(box: Box, longest: float, room: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
    """Width and height in inches: the longer side of ``box`` takes ``longest``, the labels around it ``room``."""
    scale = longest / max(box[2] - box[0], box[3] - box[1])
    return (box[2] - box[0]) * scale + room[0], (box[3] - box[1]) * scale + room[1]


def _shade(colour: str, probability: float) -> tuple[float, float, float]:
    """The colour laid over the backdrop; by the square root, as a class of 5 % must still be seen."""
    share = np.sqrt(probability)
    red, green, blue = (1 - share) * np.array(to_rgb(BACKDROP)) + share * np.array(to_rgb(colour))
    return float(red), float(green), float(blue)


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.2g} min" if seconds < 600 else f"{seconds / 60:.0f} min"


def _clock(time: float, start: float) -> str:
    moment = datetime.fromtimestamp(time, UTC)
    elapsed = f"+{_duration(time - start)}" if time > start else "start"
    return f"{moment:%d %b %H:%M}\n{elapsed}" if time > 86400 else elapsed
