"""A picture of an event: where the ships went, how far apart and how fast they were, how probable it was."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wakefold.base.units import HOUR, KNOT
from wakefold.plot.canvas import INK, PALE, PALETTE, box_around, ground, styled
from wakefold.tracks.projection import dated

if TYPE_CHECKING:
    from wakefold.tracks.projection import Projection

AROUND = HOUR  # seconds before and after that are shown
EDGES = 60  # lines between the two ships
SHORTEST = 400.0  # metres: of the side of the map


class Episode(Protocol):
    """What is drawn of an ``Event``: its probability ``chance`` at ``times``, and the whole."""

    @property
    def kind(self) -> str: ...
    @property
    def agents(self) -> tuple[str, ...]: ...
    @property
    def begin(self) -> float: ...
    @property
    def end(self) -> float: ...
    @property
    def probability(self) -> float: ...
    @property
    def times(self) -> NDArray[np.float64]: ...
    @property
    def chance(self) -> NDArray[np.float64]: ...


class Among(Protocol):
    """What is drawn of ``Found``: where ships were, moment by moment, and berths ``(B, 2)``."""

    @property
    def moments(self) -> Any: ...
    @property
    def berths(self) -> NDArray[np.float64]: ...


@styled
def event(
    found: Among, event: Episode, projection: Projection | None = None, *, coastline: str | Path | None = None
) -> Figure:
    """One event: the ships' paths an hour before and after (thin) and during it, beside distance, speed, probability.

    A line joins two ships at moments of the event; it is as opaque as the relation was probable. Squares are berths.

    Args:
        found: what the event is among.
        event: of ``found.events``.
        projection: of the tracks.
        coastline: a GeoJSON file, degrees.
    """
    m = found.moments
    paths = []
    for name in event.agents:
        agent = int(np.flatnonzero(m.names == name)[0])
        times = np.asarray(m.time(m.frame))
        rows = np.flatnonzero((m.agent == agent) & (times >= event.begin - AROUND) & (times <= event.end + AROUND))
        paths.append((name, times[rows], m.position[rows], np.linalg.norm(m.velocity[rows], axis=1) / KNOT))
    during = [(t >= event.begin) & (t <= event.end) for _, t, _, _ in paths]
    places = np.concatenate([p[d] for (_, _, p, _), d in zip(paths, during, strict=True)])
    box = _square(places)
    panels = 3 if len(paths) > 1 else 2
    figure = Figure(figsize=(10.5, 5.0), layout="constrained")
    left, right = cast(Any, figure.subfigures(1, 2))
    ax = left.subplots()
    ground(ax, box, projection, coastline)
    if len(found.berths):
        ax.scatter(*found.berths.T, s=14, marker="s", facecolors="none", edgecolors=PALE, linewidths=0.7, zorder=1)
    for (name, times, points, _), inside, colour in zip(paths, during, PALETTE, strict=False):
        for lo, hi in _pieces(times):
            ax.plot(*points[lo:hi].T, color=colour, linewidth=0.6, alpha=0.6, zorder=2)
        ax.plot(*points[inside].T, "-o", color=colour, linewidth=1.6, markersize=1.8, zorder=3, label=name)
    if len(paths) > 1:
        _draw_edges(ax, event, [(t, p) for _, t, p, _ in paths])
    ax.legend(loc="upper left")
    span = (event.end - event.begin) / 60
    ax.set_title(f"{event.kind}, {span:.0f} min, probability {event.probability:.2f}")

    def minutes(times: NDArray[np.float64]) -> NDArray[np.float64]:
        return (times - event.begin) / 60

    rows = right.subplots(panels, 1, sharex=True)
    for panel in rows:
        panel.axvspan(0.0, span, color="#eef2f5", zorder=0)
    if len(paths) > 1:
        clock, ours, theirs = np.intersect1d(paths[0][1], paths[1][1], return_indices=True)
        away = np.linalg.norm(paths[0][2][ours] - paths[1][2][theirs], axis=1)
        rows[0].plot(minutes(clock), np.maximum(away, 1.0), color=INK, linewidth=1)
        rows[0].set_yscale("log")
        rows[0].set_ylabel("distance (m)")
    for (_, times, _, speed), colour in zip(paths, PALETTE, strict=False):
        rows[-2].plot(minutes(times), speed, color=colour, linewidth=1)
    rows[-2].set_ylabel("speed (kn)")
    rows[-2].set_ylim(bottom=0)
    rows[-1].plot(minutes(event.times), event.chance, color=INK, linewidth=1)
    rows[-1].set_ylim(-0.02, 1.02)
    rows[-1].set_ylabel("probability")
    begun = f"{event.begin:.6g} s"
    if dated(projection, event.begin):
        begun = str(np.datetime64(round(event.begin), "s")).replace("T", " ") + " UTC"
    rows[-1].set_xlabel(f"minutes from {begun}")
    return figure


def _draw_edges(ax: Axes, event: Episode, paths: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> None:
    keep = np.unique(np.linspace(0, len(event.times) - 1, EDGES).astype(int))
    lines, colours = [], []
    for t, p in zip(event.times[keep], event.chance[keep], strict=True):
        ends = [points[times == t] for times, points in paths]
        if all(len(end) for end in ends):
            lines.append(np.concatenate(ends))
            colours.append(to_rgba(INK, 0.7 * float(p)))
    ax.add_collection(LineCollection(lines, colors=colours, linewidths=0.6, zorder=2.5), autolim=False)


def _pieces(times: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Where a path is not interrupted."""
    if len(times) < 2:
        return [(0, len(times))]
    cuts = np.flatnonzero(np.diff(times) > 1.5 * np.diff(times).min()) + 1
    edges = [0, *cuts.tolist(), len(times)]
    return list(pairwise(edges))


def _square(places: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """A square around places that is no smaller than ``SHORTEST``."""
    x0, y0, x1, y1 = box_around(places, margin=0.25, slimmest=1.0)
    half = max((x1 - x0) / 2, SHORTEST / 2)
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half
