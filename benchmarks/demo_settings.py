"""How the settings of the demo were chosen: learn on 1-6 December, score on the voyages of 7 December.

``python -m benchmarks.demo_settings [--quick]`` prints errors in metres for every setting. 8 December is not read.
"""

from __future__ import annotations

import sys

import numpy as np

from wakefold.base.parallel import thread_map
from wakefold.evidence.fix import Fix
from wakefold.experiments.harbour import demo
from wakefold.filters.mhpf import MHPF
from wakefold.forecast.rivals import constant_velocity, nearest_track, particle
from wakefold.forecast.scores import Method, errors, questions
from wakefold.tracks.tracks import Tracks

SCALES, SDS = (8.0, 15.0), (25.0, 50.0, 100.0)  # m/sqrt(s), metres


DEPLETIONS = (0.0009, 0.01)  # with 500 particles: no class is redrawn at random, or five in each step
TOO_FAR = 1000.0  # metres


def astray(filter: MHPF, sd: float, voyages: Tracks) -> float:
    """Share of the fixes after which the most probable past voyage is nowhere within a kilometre of the ship."""
    past = filter.model.tracks

    def one(i: int) -> list[bool]:
        points, times = voyages[i], voyages.times_of(i)
        belief, out = filter.start(fix=Fix(points[0], sd=sd), time=times[0], agent=str(voyages.ids[i])), []
        for ask in questions(points, times)[1:]:
            here = points[ask.row]
            belief = filter.step(belief, [Fix(here, sd=sd)], time=times[ask.row])
            out.append(bool(np.linalg.norm(past[belief.map()] - here, axis=1).min() > TOO_FAR))
        return out

    return float(np.mean(np.concatenate(thread_map(one, range(len(voyages))))))


def main(quick: bool = False) -> None:
    """Print the table; ``quick`` takes ten voyages and one setting."""
    every = demo.week()
    past = every.filter(time=(None, "2020-12-07"))
    held_out = every.filter(time=("2020-12-07", None))
    if quick:
        held_out = held_out.select(np.arange(10))
    print(f"{len(past):,} voyages of 1-6 December, {len(held_out):,} of 7 December\n")
    print("| method | between fixes | in 5 min | in 15 min | class astray |\n|---|---|---|---|---|")

    def row(name: str, method: Method, lost: str = "") -> None:
        cells = [f"{off.mean():,.0f} ({np.median(off):,.0f})" for off in errors(method, held_out).values()]
        print(f"| {name} | {' | '.join(cells)} | {lost} |", flush=True)

    row("constant velocity", constant_velocity)
    row("nearest track", nearest_track(past.resample(spacing=demo.SPACING)))
    settings = [(DEPLETIONS[0], scale, sd) for scale in SCALES for sd in SDS] + [(DEPLETIONS[1], 8.0, 50.0)]
    for depletion, scale, sd in settings[:1] if quick else settings:
        filter = MHPF(demo.teach(past, scale), demo.PARTICLES, levels=[], depletion=depletion, seed=demo.SEED)
        lost = astray(filter, sd, held_out.select(np.arange(0, len(held_out), 3)))
        row(f"MHPF, noise {scale:g}, sd {sd:g}, depletion {depletion:g}", particle(filter, sd), f"{lost:.1%}")


if __name__ == "__main__":
    main(quick="--quick" in sys.argv)
