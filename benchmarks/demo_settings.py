"""How the settings of the demo were chosen: learn on 1-6 December, score on the voyages of 7 December.

``python -m benchmarks.demo_settings [--quick]`` prints errors in metres for every setting. 8 December is not read.
"""

from __future__ import annotations

import itertools
import sys

import numpy as np

from wakefold import demo
from wakefold.demo_scores import constant_velocity, errors, nearest_track, particle
from wakefold.filters.mhpf import MHPF

EPSILONS, SCALES, SDS = (300.0, 500.0), (8.0, 15.0), (25.0, 50.0, 100.0)  # metres, m/sqrt(s), metres


def main(quick: bool = False) -> None:
    """Print the table; ``quick`` takes ten voyages and one setting."""
    every = demo.week()
    past = every.filter(time=(None, "2020-12-07"))
    held_out = every.filter(time=("2020-12-07", None))
    if quick:
        held_out = held_out.select(np.arange(10))
    print(f"{len(past):,} voyages of 1-6 December, {len(held_out):,} of 7 December\n")
    print("| method | between fixes | in 5 min | in 15 min |\n|---|---|---|---|")

    def row(name: str, method) -> None:
        found = errors(method, held_out).values()
        cells = [f"{off.mean():,.0f} ({np.median(off):,.0f})" for off in found]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)

    row("constant velocity", constant_velocity)
    row("nearest track", nearest_track(past.resample(spacing=demo.SPACING)))
    settings = list(itertools.product(EPSILONS, SCALES, SDS))
    for epsilon, scale, sd in settings[:1] if quick else settings:
        model = demo.teach(past, epsilon, scale)
        filter = MHPF(model, demo.PARTICLES, levels=[], seed=demo.SEED)
        row(f"MHPF, epsilon {epsilon:g}, scale {scale:g}, sd {sd:g}", particle(filter, sd))


if __name__ == "__main__":
    main(quick="--quick" in sys.argv)
