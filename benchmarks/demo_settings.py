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
from wakefold.forecast.methods import CONSTANT_VELOCITY, NEAREST
from wakefold.forecast.questions import ask
from wakefold.forecast.score import EVERY, score
from wakefold.forecast.scores import Scores
from wakefold.tracks.tracks import Tracks

SCALES, SDS = (8.0, 15.0), (25.0, 50.0, 100.0)  # m/sqrt(s), metres


DEPLETIONS = (0.0009, 0.01)  # with 500 particles: no class is redrawn at random, or five in each step
TOO_FAR = 1000.0  # metres


def astray(filter: MHPF, voyages: Tracks) -> float:
    """Share of the fixes after which the most probable past voyage is nowhere within a kilometre of the ship."""
    past, fixes = filter.model.tracks, ask(voyages, demo.HORIZONS, EVERY, EVERY).fixes

    def one(i: int) -> list[bool]:
        places, times = fixes[i], fixes.times_of(i)
        belief, out = filter.start(fix=Fix(places[0]), time=times[0], agent=str(voyages.ids[i])), []
        for place, time in zip(places[1:], times[1:], strict=True):
            belief = filter.step(belief, [Fix(place)], time=time)
            out.append(bool(np.linalg.norm(past[belief.map()] - place, axis=1).min() > TOO_FAR))
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
    print("| method | in 5 min | in 15 min | class astray |\n|---|---|---|---|")

    def row(scores: Scores, name: str, title: str, lost: str = "") -> None:
        found = scores.to_dict()["methods"][name]
        cells = [f"{found[f'{h:g}']['mean']:,.0f} ({found[f'{h:g}']['median']:,.0f})" for h in demo.HORIZONS]
        print(f"| {title} | {' | '.join(cells)} | {lost} |", flush=True)

    plain = score(demo.teach(past), held_out, horizons=demo.HORIZONS, levels=[], methods=[CONSTANT_VELOCITY, NEAREST])
    for name in plain.judged:
        row(plain, name, name)
    settings = [(DEPLETIONS[0], scale, sd) for scale in SCALES for sd in SDS] + [(DEPLETIONS[1], 8.0, 50.0)]
    for depletion, scale, sd in settings[:1] if quick else settings:
        model = demo.teach(past, scale)
        filter = MHPF(model, demo.PARTICLES, levels=[], sd=sd, depletion=depletion, seed=demo.SEED)
        lost = astray(filter, held_out.select(np.arange(0, len(held_out), 3)))
        found = score(model, held_out, horizons=demo.HORIZONS, levels=[], methods={"MHPF": filter})
        row(found, "MHPF", f"MHPF, noise {scale:g}, sd {sd:g}, depletion {depletion:g}", f"{lost:.1%}")


if __name__ == "__main__":
    main(quick="--quick" in sys.argv)
