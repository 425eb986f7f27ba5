"""What matters: update rule, likelihood, estimate, linkage and the radius of the dynamics."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from wakefold.experiments.mhpf import grid
from wakefold.experiments.mhpf.grid import BL1, BL1_COARSE
from wakefold.experiments.mhpf.scenarios import Setting
from wakefold.experiments.mhpf.simulate import Method
from wakefold.experiments.registry import Job, Section, Size, Table
from wakefold.experiments.stats import mean_text

TITLE = "Ablation: rule, likelihood, estimate, linkage and ε"
SETTINGS = [
    Setting("common", "out", 0.05, 0.05, coarse=0.5, linkage=linkage, epsilon=epsilon)
    for linkage, epsilon in product(("single", "complete"), ("default", "near", "wide"))
]
LIKELIHOODS = ("log", "gaussian", "student")
RUN = [
    *(Method("mhpf", likelihood, rule) for likelihood, rule in product(LIKELIHOODS, ("arxiv2016", "gsi2017"))),
    *(method._replace(likelihood=likelihood) for method in (BL1, BL1_COARSE) for likelihood in LIKELIHOODS),
]
EPSILON = {"default": "median death of a track", "near": "2 × spacing", "wide": "half the root's birth"}


def jobs(size: Size) -> list[Job]:
    return grid.jobs(SETTINGS, RUN, size, stack=True)


def report(results: list[Any], size: Size, folder: Path) -> Section:
    found = grid.found(SETTINGS, RUN, results)
    rows = []
    for method, setting in product(RUN, SETTINGS):
        stack = mean_text(grid.means(found, setting, method, "mse_stack")) if method.filter == "mhpf" else "–"
        rows.append(
            [
                method.name,
                setting.linkage,
                EPSILON[setting.epsilon],
                mean_text(grid.means(found, setting, method, "mse")),
                stack,
                mean_text(grid.means(found, setting, method, "distance")),
                mean_text(grid.means(found, setting, method, "excess")),
            ]
        )
    head = ["method", "linkage", "ε", "MSE, base", "MSE, stack", "tree distance", "excess"]
    return Section(
        TITLE,
        [
            "13 tracks, truth left out, κ = ψ = 5 %, a fix at every step and reports half of the time. Tree "
            "distances under single and complete linkage are heights of different trees, so compare excesses within "
            "a linkage only.",
        ],
        tables=[Table("Mean ± half the 95 % interval over scenarios", head, rows)],
    )
