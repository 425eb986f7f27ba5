"""Figure 6 of 2016, 3 (right) of 2017: the belief over time and level."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from wakefold import plot
from wakefold.evidence.fix import Fix
from wakefold.experiments.mhpf.scenarios import Scenario, Setting, chosen
from wakefold.experiments.registry import Claim, Picture, Section, Size, no_jobs
from wakefold.filters.mhpf import MHPF

TITLE = "Figure 6: the belief over time and level"
SETTING = Setting("ways", "out", 0.02, 0.01)
jobs = no_jobs


def report(results: list[Any], size: Size, folder: Path) -> Section:
    # The longest of the scenarios' tracks that has a near relative, so that there is something to converge to.
    scenarios = [Scenario(SETTING, truth) for truth in chosen("ways", 10, size.seed)]
    scenario = max((s for s in scenarios if s.away.min() < 0.2), key=lambda s: len(s.path), default=scenarios[0])
    tree = scenario.model.filtration
    levels = [0.0, *np.quantile(tree.birth[len(tree) : tree.root], [0.2, 0.55]).tolist(), float(tree.birth[tree.root])]
    f = MHPF(scenario.model, size.particles, rule="arxiv2016", likelihood="log", levels=levels, seed=size.seed)
    belief, fixes, moments, distances = f.start(at="begin"), [], [], []
    steps = len(scenario.path) - 1
    shown = {max(1, round(share * steps)) for share in (0.05, 0.3, 0.6, 1.0)}
    for k, observed in enumerate(scenario.observations(size.seed, 0), start=1):
        assert observed.fix is not None
        fixes.append(observed.fix)
        belief = f.step(belief, [Fix(observed.fix)], dt=1.0)
        distances.append(float(scenario.away[belief.map()]))
        if k in shown:
            tables = {b: belief.level(b) for b in levels}
            answers = {b: (t.classes, t.probability) for b, t in tables.items()}
            moments.append(plot.Moment(float(k), answers, belief.mean(), scenario.path[k], np.array(fixes)))
    box = (0.0, 0.0, 1.0, 1.0)
    plot.save(plot.beliefs(scenario.model.tracks, tree, moments, box=box), folder / "fig6.png")
    early, late = np.mean(distances[: steps // 4]), np.mean(distances[-(steps // 4) :])
    return Section(
        TITLE,
        [
            "One run in the configuration space, fixes only (κ = 2 %, ψ = 1 %, truth left out of the model). Rows "
            "are times, columns levels of the tree, the finest on the left; the stronger a class's colour, the more "
            "probable it is.",
        ],
        [Picture(folder / "fig6.png", "Belief of MHPF (arxiv2016, log) at four times and four levels.", 860)],
        [
            Claim(
                "The likeliest class comes nearer to the truth over time",
                "shown in a picture of one run",
                f"tree distance {early:.3f} in the first quarter, {late:.3f} in the last (one run; best attainable "
                f"{scenario.away.min():.3f})",
            )
        ],
    )
