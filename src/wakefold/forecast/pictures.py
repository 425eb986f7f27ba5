"""Pictures of a scoring: error against horizon, how well what is said is calibrated, the best and the worst answers."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from wakefold.base.types import Floats, Ints
from wakefold.base.wording import duration_text, number_text
from wakefold.forecast import classes
from wakefold.forecast.methods import CONSTANT_VELOCITY
from wakefold.forecast.scores import Scores
from wakefold.model.model import Model
from wakefold.plot.canvas import (
    BACKDROP,
    INK,
    PALE,
    PALETTE,
    box_around,
    draw_lines,
    ground,
    legend_below,
    lines_of,
    styled,
)
from wakefold.plot.canvas import length_text as metres_text

SHOWN = 3  # answers of each kind
MASSES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


def colours(scores: Scores) -> dict[str, str]:
    """A colour for each method, the best first; constant velocity is grey."""
    names = [name for name in scores.methods if name != CONSTANT_VELOCITY]
    return {CONSTANT_VELOCITY: PALE} | {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(names)}


@styled
def horizons(scores: Scores) -> Figure:
    """Mean error and energy score of each method against the horizon, with 90 % intervals over tracks."""
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    asked = np.flatnonzero(scores.asked.asked)
    at, paint = scores.asked.horizons[asked], colours(scores)
    for ax, what, title in zip(figure.subplots(1, 2), ("error", "energy"), ("mean error", "energy score"), strict=True):
        for k, name in enumerate(scores.methods):
            mean, interval = scores.mean(name, what)[asked], scores.interval(name, what)[asked]
            place = at * 1.02 ** (k - (len(scores.judged) - 1) / 2)  # side by side
            ax.plot(place, mean, "-o", color=paint[name], markersize=3, linewidth=1.2, zorder=3)
            ax.vlines(place, *interval.T, color=paint[name], linewidth=1.0, alpha=0.7, zorder=2)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.xaxis.set_major_locator(FixedLocator(at.tolist()))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: duration_text(x)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: number_text(y)))
        ax.yaxis.set_minor_formatter(FuncFormatter(lambda y, _: number_text(y) if f"{y:.0e}"[0] in "25" else ""))
        ax.grid(axis="y", which="both", color=BACKDROP, linewidth=0.5)
        ax.set_title(f"{title}, {scores.unit}")
        ax.set_xlabel("ahead")
    legend_below(figure, _handles(scores, paint), 5)
    return figure


@styled
def calibration(scores: Scores) -> Figure:
    """How often truths lie in regions of a probability; how often the likeliest class is right, half way."""
    told = [name for name in scores.methods if name in scores.classes] if scores.levels else []
    levels = len(scores.levels) if told else 0
    horizons = np.flatnonzero(scores.asked.asked)
    shown = [int(horizons[0]), int(horizons[-1])][: len(horizons)]
    figure = Figure(figsize=(9.0, 7.0 if levels else 4.0), layout="constrained")
    grid = figure.add_gridspec(2 if levels else 1, 6)
    paint = colours(scores)
    for k, h in enumerate(shown):
        ax = figure.add_subplot(grid[0, 3 * k : 3 * k + 3])
        _diagonal(ax)
        for name in scores.methods:
            depth = scores.judged[name].depth[:, h]
            depth = depth[np.isfinite(depth)]
            if len(depth):
                share = [float((depth <= mass).mean()) for mass in MASSES]
                ax.plot(MASSES, share, "-o", color=paint[name], markersize=2.5, linewidth=1.0)
        ax.set_title(f"truths in the region, in {duration_text(scores.asked.horizons[h])}")
        ax.set_xlabel("probability of the region")
    for k in range(min(levels, 3)):
        ax = figure.add_subplot(grid[1, 2 * k : 2 * k + 2])
        _diagonal(ax)
        for name in told:
            sure, right, number = _bins(scores.classes[name][:, 1, k])
            ax.scatter(
                sure,
                right,
                s=4 + 150 * number / number.sum(),
                color=paint[name],
                linewidths=0,
                alpha=0.8,
                clip_on=False,
            )
        ax.set_title(f"likeliest class right, {number_text(scores.levels[k])} {scores.unit}")
        ax.set_xlabel("its probability, half way")
    legend_below(figure, _handles(scores, paint), 5)
    return figure


@styled
def answers(scores: Scores, model: Model, method: str, h: int) -> Figure:
    """The best and the worst answers of a method for the h-th horizon: fixes, samples, and where the agent was."""
    rows = [*_extremes(scores, method, h, best=True), *_extremes(scores, method, h, best=False)]
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    place = model.tracks.projection
    for ax, q in zip(figure.subplots(2, SHOWN).ravel(), rows, strict=False):
        asked, track = scores.asked, int(scores.asked.track[q])
        one = asked.of([track])
        at = int(np.flatnonzero(asked.row[asked.track == track] == asked.row[q])[0])
        samples = scores.again[method](one)[at, h]
        fixes = asked.fixes.points[asked.fixes.offsets[track] : asked.row[q] + 1]
        truth, point = asked.truth[q, h], scores.judged[method].point[q, h]
        until = np.searchsorted(asked.fixes.times_of(track), asked.fixes.times[asked.row[q]] + asked.horizons[h])
        later = asked.fixes[track][len(fixes) - 1 : until]
        low, high = np.quantile(samples, 0.02, axis=0), np.quantile(samples, 0.98, axis=0)
        box = box_around(np.concatenate([[truth, point, fixes[-1], low, high], fixes[-4:]]), 0.08, 0.8)
        ground(ax, box, place, labels=place is None)
        draw_lines(ax, lines_of(model.tracks, box, 800), colors=BACKDROP, linewidths=0.4, zorder=0.4)
        ax.scatter(*samples.T, s=5, color=PALETTE[4], alpha=0.7, linewidths=0, zorder=2)
        ax.plot(*fixes.T, "-o", color=INK, markersize=2, linewidth=1.0, zorder=3)
        ax.plot(*np.vstack([later, truth]).T, color=INK, linewidth=0.8, linestyle=(0, (1, 1.5)), zorder=3)
        ax.scatter(*fixes[-1], s=40, color=INK, edgecolors="white", linewidths=0.8, zorder=4)
        ax.scatter(*truth, s=36, facecolors="none", edgecolors=PALETTE[1], linewidths=1.4, zorder=5)
        ax.scatter(*point, s=30, marker="x", color=PALETTE[0], linewidths=1.4, zorder=5)
        error, gone = scores.judged[method].error[q, h], float(np.linalg.norm(truth - fixes[-1]))
        ax.set_title(f"{metres_text(error, place)} off, {metres_text(gone, place)} on", fontsize=8)
    marks: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "none"}
    handles = [
        Line2D([], [], color=INK, marker="o", markersize=2, linewidth=1, label="fixes so far"),
        Line2D([], [], color=INK, marker="o", markersize=6, linestyle="none", label="the last one"),
        Line2D([], [], color=INK, linewidth=0.8, linestyle=(0, (1, 1.5)), label="where it went"),
        Line2D([], [], color=PALETTE[1], marker="o", label="where it was then", **marks),
        Line2D([], [], color=PALETTE[0], marker="x", label="answer: median of the samples", **marks),
        Line2D([], [], color=PALETTE[4], marker="o", markersize=3, linestyle="none", label="samples"),
    ]
    title = f"{method}, in {duration_text(scores.asked.horizons[h])}: above the best answers, below the worst"
    figure.suptitle(title, x=0.01, ha="left", fontsize=9)
    legend_below(figure, handles, 6)
    return figure


def _handles(scores: Scores, paint: dict[str, str]) -> list[Line2D]:
    names = [*scores.methods, *(["prior"] if "prior" in scores.classes and "prior" in paint else [])]
    return [Line2D([], [], color=paint[name], marker="o", markersize=3, linewidth=1.2, label=name) for name in names]


def _diagonal(ax: Axes) -> None:
    ax.plot([0, 1], [0, 1], color=PALE, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0.5)
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1)
    ax.set_aspect("equal", adjustable="box")


def _bins(found: Floats) -> tuple[Floats, Floats, Ints]:
    """Mean probability of the likeliest class, share right, and number, in the bins that are not empty."""
    rows = found[np.isfinite(found[:, classes.TOP])]
    of = np.minimum((rows[:, classes.TOP] * classes.BINS).astype(int), classes.BINS - 1)
    number = np.bincount(of, minlength=classes.BINS)
    kept = number > 0
    sums = [np.bincount(of, rows[:, what], classes.BINS)[kept] / number[kept] for what in (classes.TOP, classes.HIT)]
    return sums[0], sums[1], number[kept]


def _extremes(scores: Scores, method: str, h: int, best: bool) -> list[int]:
    """The moments of the best or the worst answers, each of another track; the best of agents that went some way."""
    error, asked = scores.judged[method].error[:, h], scores.asked
    gone = np.linalg.norm(asked.truth[:, h] - asked.here, axis=1)
    good = np.isfinite(error)
    if best and good.any():
        good &= gone >= np.median(gone[good])
    worth = np.where(good, error if best else -error, np.inf)
    out: list[int] = []
    for q in np.argsort(worth, kind="stable").tolist():
        if not good[q] or len(out) == SHOWN:
            break
        if asked.track[q] not in asked.track[out]:
            out.append(q)
    return out
