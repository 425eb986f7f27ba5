"""A picture of several objects and what they are to each other: tracks, relations as edges, posteriors over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from wakefold.plot.canvas import INK, PALETTE, styled

FAINT = 0.05  # edges less probable are not drawn
CURVES = 8  # pairs that get a name in the legend


class Drawn(Protocol):
    """What is drawn of a ``Scene``: objects with ``ids`` and ``position``, pairs with their ``probability``."""

    @property
    def model(self) -> Any: ...
    @property
    def time(self) -> float: ...
    def tracks(self) -> Any: ...
    def relations(self, name: str, /) -> Any: ...


@styled
def relations(scenes: Sequence[Drawn], name: str | None = None, *, every: int = 1, at_least: float = 0.5) -> Figure:
    """Where objects went and what they were to each other: paths with edges, beside each pair's probability over time.

    An edge joins two objects at a moment; it is as opaque as the relation was probable then. Which way an asymmetric
    relation goes is told by the order of names beside its curve only.

    Args:
        scenes: beliefs one after the other, as ``RelationalFilter.step`` returns them.
        name: of a relation; by default the model's first.
        every: edges are drawn for each such moment, and for the last.
        at_least: pairs whose relation never gets so probable have no curve.

    Raises:
        ValueError: no scenes, or no such relation.
    """
    if not scenes:
        raise ValueError("relations: no scenes to draw")
    if every < 1:
        raise ValueError(f"relations: every must be at least 1, got {every}")
    model = scenes[-1].model
    if name is None and not model.relations:
        raise ValueError("relations: the model has no relation to draw")
    wanted = name if name is not None else model.relations[0].name
    paths: dict[Any, list[np.ndarray]] = {}
    lines, opacity = [], []
    curves: dict[tuple[Any, Any], list[tuple[float, float]]] = {}
    for k, scene in enumerate(scenes):
        tracks = scene.tracks()
        at = dict(zip(tracks.ids.tolist(), tracks.position, strict=True))
        for i, place in at.items():
            paths.setdefault(i, []).append(place)
        table = scene.relations(wanted)
        shown = k % every == 0 or k == len(scenes) - 1
        for a, b, p in zip(table.first.tolist(), table.second.tolist(), table.probability.tolist(), strict=True):
            curves.setdefault((a, b), []).append((scene.time, p))
            if shown and p > FAINT and a in at and b in at:
                lines.append([at[a], at[b]])
                opacity.append(to_rgba(INK, 0.8 * p))
    figure = Figure(figsize=(10.0, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (i, places), colour in zip(paths.items(), _colours(len(paths)), strict=True):
        left.plot(*np.array(places).T, color=colour, linewidth=1.2, zorder=2)
        left.plot(*places[-1], "o", color=colour, markersize=4, zorder=3)
        left.annotate(str(i), places[-1], xytext=(4, 4), textcoords="offset points", fontsize=8, color=colour)
    left.add_collection(LineCollection(lines, colors=opacity, linewidths=1.0, zorder=1), autolim=False)
    left.set_aspect("equal", adjustable="datalim")
    left.set(xlabel="m", ylabel="m", title="paths; edges as opaque as the relation is probable")
    likely = {pair: c for pair, c in curves.items() if max(p for _, p in c) >= at_least}
    likely = dict(sorted(likely.items(), key=lambda item: -max(p for _, p in item[1])))
    for k, ((a, b), curve) in enumerate(likely.items()):
        label = f"{a}, {b}" if k < CURVES else None
        right.plot(*np.array(curve).T, linewidth=1.2, color=PALETTE[k % len(PALETTE)], label=label)
    right.set(ylim=(-0.02, 1.02), xlabel="s", title=f"probability of {wanted!r}")
    if likely:
        right.legend(fontsize=8, title=None if len(likely) <= CURVES else f"{CURVES} of {len(likely)} pairs")
    else:
        right.text(0.5, 0.5, f"no pair reaches {at_least:g}", ha="center", transform=right.transAxes)
    return figure


def _colours(count: int) -> list[str]:
    return [PALETTE[k % len(PALETTE)] for k in range(count)]
