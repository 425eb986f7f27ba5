"""Figure 7b of 2016, 4b of 2017: time to come near the true class and stay, with reports only after a lead-in."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

from wakefold.experiments.mhpf import grid
from wakefold.experiments.mhpf.grid import NAMING, NOISE
from wakefold.experiments.mhpf.scenarios import Setting
from wakefold.experiments.registry import Job, Section, Size

TITLE = "Figure 7b: time to convergence, 13 tracks, fixes only at the beginning"
KAPPA, LEAD = (0.30, 0.75), (0.05, 0.075)
OUT = [Setting("common", "out", kappa, 0.01, coarse=1.0, lead_in=lead) for lead, kappa in product(LEAD, KAPPA)]
SETTINGS = [s._replace(truth=truth) for truth in ("out", "in") for s in OUT]
COLUMNS = {"truth": NOISE["truth"], "lead-in": lambda s: f"{s.lead_in:.1%}", "κ": NOISE["κ"]}


def jobs(size: Size) -> list[Job]:
    return grid.jobs(SETTINGS, NAMING, size)


def report(results: list[Any], size: Size, folder: Path) -> Section:
    found = grid.found(SETTINGS, NAMING, results)
    return Section(
        TITLE,
        [
            "Fixes (ψ = 1 %) for the first 5 or 7.5 % of the trial, then a report at every step and nothing else. The "
            "score is the share of the trial after which the excess tree distance of the most probable track, averaged "
            "over five steps, stays within 33 % of the range; a run that never gets there counts as 1. BL1 is given "
            "nothing at all after the lead-in, BL1+coarse is.",
        ],
        [
            grid.chart(
                found,
                SETTINGS,
                NAMING,
                "converged",
                "share of the trial until convergence",
                folder / "fig7b.png",
                "Time to convergence with 95 % intervals over scenarios.",
                COLUMNS,
            )
        ],
        grid.claims_below(found, OUT, "converged", "Four settings", "MHPF sooner than BL1 in all four, p = 0.02", 0.05),
        [
            grid.score_table(found, SETTINGS, NAMING, "converged", "Share of the trial until convergence", COLUMNS),
            grid.score_table(found, SETTINGS, NAMING, "excess", "Excess tree distance", COLUMNS),
        ],
    )
