"""Figure 7a of 2016, 4a of 2017: tree distance of the likeliest class to the truth, reports half of the time."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from wakefold.experiments import grid
from wakefold.experiments.grid import METHODS, NOISE
from wakefold.experiments.registry import Job, Section, Size
from wakefold.experiments.scenarios import Setting

TITLE = "Figure 7a: distance of the likeliest class, 13 tracks, coarse reports half of the time"
KAPPA, PSI = (0.30, 0.50, 0.75), (0.01, 0.05)
OUT = [Setting("common", "out", kappa, psi, coarse=0.5) for psi, kappa in product(PSI, KAPPA)]
SETTINGS = [s._replace(truth=truth) for truth in ("out", "in") for s in OUT]


def jobs(size: Size) -> list[Job]:
    return grid.jobs(SETTINGS, METHODS, size)


def report(results: list[Any], size: Size, folder: Path) -> Section:
    found = grid.found(SETTINGS, METHODS, results)
    named = [m for m in METHODS if m.filter != "bl2"]
    panels = [
        (f"truth {NOISE['truth'](s)}, ψ = {s.psi:.0%}", [s._replace(kappa=k) for k in KAPPA])
        for s in SETTINGS
        if s.kappa == KAPPA[0]
    ]
    return Section(
        TITLE,
        [
            "A fix at every step and, half of the time, a report that names the class nearest to ten points around "
            "the agent. The score is the tree distance from the most probable track to the true one, averaged over "
            "time, and its excess over the best attainable: with the truth left out of the model even the nearest "
            "track is some distance away. The dynamics' noise of 30 to 75 % of the diagonal at every step moves a "
            "particle across the whole domain, so nothing but the reports tells the classes apart: BL1, which is not "
            "given them, knows next to nothing, and BL1+coarse, which is, does as well as MHPF.",
        ],
        [
            grid.chart(
                found,
                panels,
                named,
                "excess",
                "excess tree distance (unit square)",
                folder / "fig7a.png",
                "Excess tree distance of the most probable track, with 95 % intervals over scenarios.",
            )
        ],
        grid.claims_below(found, OUT, "distance", "Six settings", "MHPF below BL1 in all six, p = 0.004", 0.05),
        [
            grid.score_table(found, SETTINGS, named, "distance", "Tree distance", NOISE),
            grid.score_table(found, SETTINGS, named, "excess", "Excess over the best attainable", NOISE),
            grid.score_table(found, SETTINGS, METHODS, "mse", "Mean squared error of the position", NOISE),
        ],
    )
