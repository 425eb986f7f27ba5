"""Figure 9 of 2016: tree distance of the likeliest class to the truth among the tankers."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from wakefold.experiments import grid
from wakefold.experiments.grid import METHODS, NOISE
from wakefold.experiments.registry import Job, Section, Size
from wakefold.experiments.scenarios import Setting

TITLE = "Figure 9: distance of the likeliest class, 194 tankers, coarse reports half of the time"
KAPPA, PSI = (0.10, 0.20, 0.30), (0.10, 0.20)
OUT = [Setting("tankers", "out", kappa, psi, coarse=0.5) for psi, kappa in product(PSI, KAPPA)]
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
            "As in Figure 7a, with 194 walks over the raster of Figure 8 and five scenarios. With five pairs no p "
            "can be below 0.0625; the paper gives 0.1.",
        ],
        [
            grid.chart(
                found,
                panels,
                named,
                "excess",
                "excess tree distance (cells are 5 wide)",
                folder / "fig9.png",
                "Excess tree distance of the most probable track, with 95 % intervals over scenarios.",
            )
        ],
        grid.claims_below(found, OUT, "distance", "Six settings", "MHPF below BL1, p = 0.1", 0.1),
        [
            grid.score_table(found, SETTINGS, named, "distance", "Tree distance", NOISE),
            grid.score_table(found, SETTINGS, named, "excess", "Excess over the best attainable", NOISE),
            grid.score_table(found, SETTINGS, METHODS, "mse", "Mean squared error of the position", NOISE),
        ],
    )
