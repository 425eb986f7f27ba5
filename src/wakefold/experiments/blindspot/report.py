"""The page's part on three people through a blind spot: table, claims and the four panels of the paper's Figure 3."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from wakefold import plot
from wakefold.experiments.blindspot.scenes import BLIND, DT, SCENES, Walk, walk
from wakefold.experiments.blindspot.trials import NAMES, SAMPLED, Outcome, follow, tracker
from wakefold.experiments.registry import Claim, Picture, Section, Table

COLOURS = ("#1f4e79", "#c0504d", "#5b8c3a")
SHOWN = "pair pauses"
EVERY = (*NAMES, *SAMPLED)
Results = Mapping[str, list[dict[str, Any]]]


def section(title: str, by_scene: Results, folder: Path, seed: int) -> Section:
    """From the results of ``blindspot.run`` for each sort of scene."""
    rows, claims = [], []
    for scene in SCENES:
        found = by_scene[scene]
        error, square = ({n: np.array([r[n][what] for r in found], float) for n in EVERY} for what in ("error", "mse"))
        for name in EVERY:
            e, s = error[name], square[name]
            cells = f"{e.mean():.3f}", f"{s.mean():.3f} ± {s.std():.3f}", f"{np.median(s):.3f}"
            rows.append([scene, name, str(len(found)), *cells])
        if scene != SCENES[-1]:
            published = "the third person keeps its name"
            claims.append(Claim(f"identity errors, {scene}: with relations / without", published, _ratio(error)))
            claims.append(Claim(f"squared error, {scene}: with relations / without", "lower", _ratio(square)))
        else:
            difference = error["relational"].mean() - error["plain"].mean()
            claims.append(Claim(f"identity errors, {scene}: with relations less without", "", f"{difference:+.3f}"))
    head = ["scene", "filter", "scenes", "any identity error", "squared error, m² (mean ± sd)", "median"]
    text = [
        "The second experiment of the paper: a pair walks together, a third person follows, and all of them pass a "
        "blind spot. Detections carry no identities. The plain and the relational filter are the same "
        "Rao-Blackwellised particle filter with the same motion, sensor, association and number of particles; the "
        "plain one knows no relation. Beside them the two with sampled objects, as in the paper, and ten times the "
        "particles.",
        "Intervals: 95 %, from 2,000 draws of the scenes with replacement.",
    ]
    shown = by_scene[SHOWN]
    wrong = {n: np.array([r[n]["error"] for r in shown], dtype=bool) for n in NAMES}
    saved = wrong["plain"] & ~wrong["relational"]
    plot.save(_panels(seed + int(saved.argmax())), folder / "blindspot.png")
    shares = [saved, wrong["plain"] & wrong["relational"], ~wrong["plain"] & wrong["relational"]]
    first, both, second = (f"{100 * x.mean():.0f} %" for x in shares)
    caption = (
        f'The first scene of "{SHOWN}" in which only the plain filter errs, every person in a colour: where they '
        "walked (the blind spot is grey), what each filter believed (a change of colour is an identity error), and how "
        f"probable it was that two walk together. Of {len(shown)} such scenes only the plain filter errs in {first}, "
        f"both in {both}, only the relational one in {second}."
    )
    pictures = [Picture(folder / "blindspot.png", caption)]
    return Section(title, text, pictures, claims, [Table("Identity and position errors", head, rows)])


def _ratio(of: Mapping[str, np.ndarray]) -> str:
    """Ratio of the means and its bootstrap interval over the scenes."""
    plain, ours = of["plain"], of["relational"]
    if not plain.any():
        return "no error without relations"
    drawn = np.random.default_rng(0).integers(0, len(plain), (2000, len(plain)))
    low, high = np.quantile(ours[drawn].mean(axis=1) / np.maximum(plain[drawn].mean(axis=1), 1e-12), [0.025, 0.975])
    return f"{ours.mean() / plain.mean():.2f} [{low:.2f}, {high:.2f}]"


def _panels(seed: int) -> Figure:
    scene = walk(SHOWN, seed)
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    axes = figure.subplots(2, 2)
    outcomes = {name: follow(scene, tracker(name, seed)) for name in NAMES}
    _paths(axes[0, 0], scene.truth, "the truth")
    _paths(axes[0, 1], outcomes["plain"].estimate, "without relations")
    _paths(axes[1, 0], outcomes["relational"].estimate, "with relations")
    _posterior(axes[1, 1], scene, outcomes["relational"])
    return figure


def _paths(ax: Any, paths: np.ndarray, title: str) -> None:
    ax.axvspan(*BLIND, color="#e6e6e6")
    for person, colour in enumerate(COLOURS):
        ax.plot(*paths[:, person].T, color=colour, lw=1.2)
        ax.plot(*paths[-1, person], "o", color=colour, ms=4)
    ax.set(title=title, xlabel="m", ylabel="m", ylim=(-3, 3))


def _posterior(ax: Any, scene: Walk, outcome: Outcome) -> None:
    times = DT * np.arange(len(scene.truth))
    hidden = ((scene.truth[:, :, 0] > BLIND[0]) & (scene.truth[:, :, 0] < BLIND[1])).any(axis=1)
    ax.axvspan(times[hidden].min(), times[hidden].max(), color="#e6e6e6")
    names = outcome.names
    for (i, j), label in (((0, 1), "the pair"), ((0, 2), "first and third"), ((1, 2), "second and third")):
        p = [b.probability("together", int(names[i]), int(names[j])) for b in outcome.scenes]
        ax.plot(times, p, label=label, lw=1.2)
    ax.set(title="probability of walking together", xlabel="s", ylim=(-0.02, 1.02))
    ax.legend(frameon=False, fontsize=8)
