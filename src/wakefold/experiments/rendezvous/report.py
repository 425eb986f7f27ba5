"""The page's part on the rendezvous of two ships: tables, paired differences and one scene of each kind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wakefold import plot
from wakefold.experiments.registry import Claim, Picture, Section, Table
from wakefold.experiments.rendezvous.relational import MET, meeting, phases
from wakefold.experiments.rendezvous.scenes import DT, HARD, KINDS, TOGETHER, Scenes, scenes
from wakefold.experiments.rendezvous.trials import COLLAPSED, EVEN, JUDGED, MODELS, OURS, TAUGHT, THEIRS
from wakefold.experiments.stats import half_width
from wakefold.plot.canvas import INK, PALETTE

SD = 200.0  # metres, of the scenes shown
NAMES = (OURS, EVEN, COLLAPSED, THEIRS, *MODELS)


def section(title: str, by: Mapping[str, list[dict[str, Any]]], folder: Path, seed: int) -> Section:
    """From the results of ``rendezvous.split`` in each condition."""
    n, first = len(next(iter(by.values()))), next(iter(by))
    head = ["", *by]
    scores = [[name, *(_spread([r["f1"][name] for r in f if name in r["f1"]]) for f in by.values())] for name in NAMES]
    errors = [
        [name, *(f"{np.mean([r['error'][name] for r in f]):.1f}" for f in by.values())]
        for name in by[first][0]["error"]
    ]
    tables = [
        Table(f"F1: mean and standard deviation over {n} splits of {TAUGHT} + {JUDGED} scenes", head, scores),
        Table(f"F1 of {OURS}, less that of the others: mean and 95 % interval, paired", head, _differences(by)),
        Table("Error of the position: root mean square, metres, mean over the splits", head, errors),
    ]
    claims = []
    for name in NAMES[2:]:
        mean, low, high = paired([r["f1"][OURS] - r["f1"][name] for r in by[first]])
        published = "almost 20 % higher" if name.startswith("HMM, two-class") else ""
        claims.append(Claim(f"F1, {first}: {OURS}, less {name}", published, f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]"))
    plot.save(_panels(seed), folder / "rendezvous.png")
    caption = (
        "One scene of each kind: where the ships went (what was received is dotted), with lines between them as opaque "
        "as it is probable that they are together; and how probable that they are together, and that they have met. "
        "Grey: when they were together."
    )
    text = [
        "The first experiment of the paper: does an observed pair of ships meet? Scenes are simulated, half of them "
        "positive; hard negatives pass slowly or closely or anchor apart.",
    ]
    return Section(title, text, [Picture(folder / "rendezvous.png", caption, 1100)], claims, tables)


def _spread(values: list[float]) -> str:
    return f"{np.mean(values):.3f} ± {np.std(values):.3f}" if values else ""


def _differences(by: Mapping[str, list[dict[str, Any]]]) -> list[list[str]]:
    rows = []
    for name in NAMES[2:]:
        row = [name]
        for found in by.values():
            away = [r["f1"][OURS] - r["f1"][name] for r in found if name in r["f1"]]
            mean, low, high = paired(away) if away else (0.0, 0.0, 0.0)
            row.append(f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]" if away else "")
        rows.append(row)
    return rows


def paired(differences: list[float]) -> tuple[float, float, float]:
    """Mean of independent differences and its 95 % interval."""
    mean, half = float(np.mean(differences)), half_width(differences)
    return mean, mean - half, mean + half


def _panels(seed: int) -> Figure:
    """The first rendezvous and the first of each hard negative, with what the filter says of them."""
    some = scenes(24, HARD, SD, np.random.default_rng([seed, 2011]), missing=0.3)
    p, _, place = phases(some, SD)
    names = [phase.name for phase in meeting().phases]
    now, met = p[..., names.index("together")], p[..., [names.index(name) for name in MET]].sum(axis=2)
    figure = Figure(figsize=(13, 5.5), layout="constrained")
    axes = figure.subplots(2, 4, gridspec_kw={"height_ratios": [3, 2]})
    for column, name in enumerate(("rendezvous", *HARD)):
        i = int(np.flatnonzero(some.kind == KINDS.index(name))[0])
        _tracks(axes[0, column], some, i, place[i], now[i])
        axes[0, column].set_title(name, fontsize=10, color=INK)
        minutes = np.arange(p.shape[1]) * DT / 60.0
        ax: Axes = axes[1, column]
        ax.fill_between(minutes, 0, some.phase[i] == TOGETHER, color=INK, alpha=0.15, lw=0, step="mid")
        ax.plot(minutes, now[i], color=PALETTE[0], label="together")
        ax.plot(minutes, met[i], color=PALETTE[1], ls="--", label="have met")
        ax.set(ylim=(0, 1.02), xlabel="minutes")
    axes[1, 0].set_ylabel("probability")
    axes[1, 0].legend(frameon=False, fontsize=8)
    return figure


def _tracks(ax: Axes, some: Scenes, i: int, place: np.ndarray, now: np.ndarray) -> None:
    centre = some.truth[i].mean(axis=(0, 1))
    for ship in range(2):
        ax.plot(*((some.seen[i, ship] - centre) / 1000.0).T, ".", color=PALETTE[2 + ship], ms=2, alpha=0.6)
        ax.plot(*((place[ship] - centre) / 1000.0).T, color=PALETTE[2 + ship], lw=1)
    for t in np.flatnonzero(now > 0.02):
        ax.plot(*((place[:, t] - centre) / 1000.0).T, color=PALETTE[0], lw=3, alpha=float(now[t]))
    close = np.linalg.norm(some.truth[i, 0] - some.truth[i, 1], axis=1).argmin()
    x, y = (some.truth[i, :, close].mean(axis=0) - centre) / 1000.0
    ax.set(xlim=(x - 3, x + 3), ylim=(y - 3, y + 3), aspect="equal", xlabel="km")
