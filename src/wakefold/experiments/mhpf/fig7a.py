"""Figure 7a of 2016, 4a of 2017: tree distance of the likeliest class to the truth, reports half of the time."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from wakefold.experiments.mhpf import grid
from wakefold.experiments.mhpf.grid import CALIBRATED, NAMING, NOISE
from wakefold.experiments.mhpf.scenarios import Setting
from wakefold.experiments.registry import Claim, Job, Section, Size
from wakefold.experiments.stats import half_width, p_text, wilcoxon

TITLE = "Figure 7a: distance of the likeliest class, 13 tracks, coarse reports half of the time"
KAPPA, PSI = (0.30, 0.50, 0.75), (0.01, 0.05)
OUT = [Setting("common", "out", kappa, psi, coarse=0.5) for psi, kappa in product(PSI, KAPPA)]
SETTINGS = [s._replace(truth=truth) for truth in ("out", "in") for s in OUT]
FOLLOWERS = [m for m in NAMING if m.filter != "bl1"]  # those who take reports


def jobs(size: Size) -> list[Job]:
    return [
        *grid.jobs(SETTINGS, NAMING, size),
        *grid.jobs(_wrong(), FOLLOWERS, size),
        *grid.jobs(_without(), [CALIBRATED], size),
    ]


def _wrong() -> list[Setting]:
    """Three reports in ten name any other class; no filter is told."""
    return [s._replace(wrong=0.3) for s in OUT]


def _without() -> list[Setting]:
    """No reports."""
    return [s._replace(coarse=0.0) for s in OUT]


def report(results: list[Any], size: Size, folder: Path) -> Section:
    every, wrong = len(SETTINGS) * len(NAMING), len(OUT) * len(FOLLOWERS)
    found = grid.found(SETTINGS, NAMING, results[:every])
    found |= grid.found(_wrong(), FOLLOWERS, results[every : every + wrong])
    found |= grid.found(_without(), [CALIBRATED], results[every + wrong :])
    return Section(
        TITLE,
        [
            "A fix at every step and, half of the time, a report that names the class nearest to ten points around "
            "the agent. The score is the tree distance from the most probable track to the true one, averaged over "
            "time, and its excess over the best attainable: with the truth left out of the model even the nearest "
            "track is some distance away. The dynamics' noise of 30 to 75 % of the diagonal at every step moves a "
            "particle across the whole domain, so under the -log weight nothing but the reports tells the classes "
            "apart: BL1, which is not given them, knows next to nothing, and BL1+coarse, which is, does as well as "
            "MHPF or better. With the matched likelihood, fixes of 1 % tell them apart without any report.",
        ],
        [
            grid.chart(
                found,
                SETTINGS,
                NAMING,
                "excess",
                "excess tree distance (unit square)",
                folder / "fig7a.png",
                "Excess tree distance of the most probable track, with 95 % intervals over scenarios.",
                NOISE,
            )
        ],
        [
            *grid.claims_below(found, OUT, "distance", "Six settings", "MHPF below BL1 in all six, p = 0.004", 0.05),
            grid.claim_calibrated(found, OUT, "excess", "excess", 0.6),
            _unharmed(found),
        ],
        [
            grid.score_table(found, SETTINGS, NAMING, "distance", "Tree distance", NOISE),
            grid.score_table(found, SETTINGS, NAMING, "excess", "Excess over the best attainable", NOISE),
            grid.score_table(found, _wrong(), FOLLOWERS, "excess", "Excess with 30 % of the reports wrong", NOISE),
            grid.score_table(found, _without(), [CALIBRATED], "excess", "Excess without any report", NOISE),
            grid.score_table(found, SETTINGS, NAMING, "mse", "Mean squared error of the position", NOISE),
        ],
    )


def _unharmed(found: grid.Found) -> Claim:
    """Reports of which some are wrong must do no harm."""
    told, untold = (
        np.mean([grid.means(found, s, CALIBRATED, "excess") for s in settings], axis=0)
        for settings in (_wrong(), _without())
    )
    change = (told - untold) / untold.mean()
    bound = float(change.mean()) + half_width(change)
    return Claim(
        "calibrated, 30 % of the reports wrong and nobody told: excess no worse than without any (upper bound of the "
        "difference at most 2 %)",
        "not tried",
        f"{change.mean():+.0%}, upper 95 % bound {bound:+.1%}",
        p_text(wilcoxon(told, untold)),
        grid.HOLDS if bound <= 0.02 else grid.FAILS,
    )
