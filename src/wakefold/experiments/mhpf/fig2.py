"""Figures 2 and 4 of 2016, 2 of 2017: one report at one level, and what it does to every class of the tree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wakefold import plot
from wakefold.evidence.coarse import CoarseClass
from wakefold.evidence.fix import Fix
from wakefold.experiments.mhpf import datasets
from wakefold.experiments.registry import Claim, Picture, Section, Size, Table, no_jobs
from wakefold.filters.belief import Belief
from wakefold.filters.mhpf import MHPF
from wakefold.model.filtration import Filtration
from wakefold.model.model import learn
from wakefold.plot.canvas import INK, PALE, PALETTE, styled

TITLE = "Figures 2 and 4: a coarse report walks through the tree"
jobs = no_jobs


def report(results: list[Any], size: Size, folder: Path) -> Section:
    tracks = datasets.junction()
    model = learn(tracks, noise="uniform", scale=0.02, sd=0.05, threads=1)
    tree = model.filtration
    named = tree.class_of(range(5, 10), 0.2)  # those who go up and right
    level = 0.5 * float(tree.birth[named] + tree.death[named])
    beliefs: dict[str, Belief] = {}
    for rule in ("gsi2017", "arxiv2016"):
        f = MHPF(model, 1000, rule=rule, likelihood="log", levels="all", seed=size.seed)
        belief = f.start(at="begin")
        for k in range(1, 12):
            belief = f.step(belief, [Fix(tracks[7][k])], dt=1.0)
        beliefs.setdefault("before the report", belief)
        beliefs[f"after it, {rule}"] = f.step(belief, [CoarseClass(named, level=level)], dt=0.0)
    masses = {name: np.array([b.probability(c) for c in range(tree.root + 1)]) for name, b in beliefs.items()}
    plot.save(_trees(tree, masses, named, level), folder / "fig2.png")
    ways = {"up, left": 0, "up, right": 5, "down": 10, "across": 12}
    rows = [
        [way, *(f"{mass[tree.class_at(track, level)]:.3f}" for mass in masses.values())] for way, track in ways.items()
    ]
    return Section(
        TITLE,
        [
            "The tree of the junction. An agent has gone a fifth of the way up the stem; then somebody reports “up, "
            "right” at the level of the dashed line. Classes at that level are weighed by their tree distance to the "
            "one named; children follow their parents in proportion, and parents are the sums of their children, by "
            "construction. "
            "With the papers' −log weight a class at the root's distance keeps weight only as far as that distance "
            "is below the diagonal.",
        ],
        [
            Picture(
                folder / "fig2.png",
                "Classes over the tree, their probability as the area of the mark; the class named is circled.",
                1080,
            )
        ],
        [_raised({name: float(mass[named]) for name, mass in masses.items()})],
        [Table(f"Probability of the classes alive at {level:.2f}", ["class", *masses], rows)],
    )


def _raised(named: dict[str, float]) -> Claim:
    """From the probability of the class named, before the report and after it under each rule."""
    (_, before), *after = named.items()
    return Claim(
        "The report makes the class it names more probable, under either rule",
        "shown in a picture",
        f"{before:.3f} before; " + ", ".join(f"{p:.3f} {name}" for name, p in after),
        "",
        "holds" if all(p > before for _, p in after) else "does not hold",
    )


@styled
def _trees(tree: Filtration, masses: dict[str, np.ndarray], named: int, level: float) -> Figure:
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    axes = figure.subplots(1, len(masses), sharey=True)
    middle = 0.5 * (tree.lo + tree.hi - 1)
    for ax, (name, mass) in zip(axes, masses.items(), strict=True):
        _tree(ax, tree, middle)
        ax.scatter(middle, _height(tree), s=260 * mass, color=PALETTE[0], alpha=0.75, linewidths=0, zorder=3)
        at = (float(middle[named]), float(_height(tree)[named]))
        ax.scatter(*at, s=330, facecolors="none", edgecolors=PALETTE[1], linewidths=1.4, zorder=4)
        ax.axhline(level, color=INK, linewidth=0.8, linestyle=(0, (5, 3)))
        ax.set_title(name)
        ax.set_xticks([])
        ax.spines[["top", "right", "bottom"]].set_visible(False)
    axes[0].set_ylabel("birth (discrete Fréchet distance)")
    return figure


def _height(tree: Filtration) -> np.ndarray:
    """Where a class is drawn: its birth, single tracks at the foot."""
    return np.asarray(tree.birth)


def _tree(ax: Axes, tree: Filtration, middle: np.ndarray) -> None:
    top = float(tree.birth[tree.root])
    for c in range(tree.root):
        parent = int(tree.parent[c])
        ax.plot(
            [middle[c], middle[c], middle[parent]],
            [tree.birth[c], tree.birth[parent], tree.birth[parent]],
            color=PALE,
            lw=0.7,
        )
    ax.set_ylim(-0.05 * top, 1.1 * top)
