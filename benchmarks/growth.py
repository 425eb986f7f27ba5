"""Models that grow: cost of an added track, of learning all anew, and of taking a belief on.

``python -m benchmarks.growth`` learns all but the last day of the New York week, then adds that day; and adds 1,000
tracks to 100,000 drawn from Grand Central, where ``../shared/data`` has it. CPU seconds, medians of five rounds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from statistics import median
from time import perf_counter, process_time

import numpy as np

from benchmarks.filtration import GRAND_CENTRAL, drawn_from, grand_central
from wakefold.evidence.fix import Fix
from wakefold.experiments.harbour import demo
from wakefold.filters.mhpf import MHPF
from wakefold.model.model import Model, learn
from wakefold.tracks.tracks import Tracks

DAY = 86_400.0
DECEMBER_7 = 1_607_299_200.0  # seconds since 1970
AGENTS = 200  # whose beliefs go on


def cost(work: Callable[[], object], rounds: int) -> tuple[float, float]:
    """CPU and wall seconds, medians; the first call, which may compile, is not counted."""
    work()
    cpu, wall = [], []
    for _ in range(rounds):
        before, at = process_time(), perf_counter()
        work()
        cpu.append(process_time() - before)
        wall.append(perf_counter() - at)
    return median(cpu), median(wall)


def rows(name: str, old: Tracks, new: Tracks, rounds: int) -> Model:
    """Lines of the table for tracks and new ones; the model of the old ones."""
    model = learn(old)
    every = Tracks.concat([old, new])
    anew = cost(lambda: learn(every), rounds)
    grown = cost(lambda: model.extend(new), rounds)
    print(
        f"| {name} | {len(old):,} + {len(new):,} | {anew[0]:.2f} | {grown[0]:.3f} | {1e3 * grown[0] / len(new):.2f} "
        f"| {anew[0] / grown[0]:.0f} |"
    )
    return model


def main(quick: bool = False) -> None:
    """Print the table; ``quick`` takes one round and no large set."""
    rounds = 1 if quick else 5
    print("| set | tracks | learn all, CPU s | extend, CPU s | ms an added track | ratio |\n|---|---|---|---|---|---|")
    week = demo.week().resample(spacing=demo.SPACING)
    last = week.times[week.offsets[:-1]] >= DECEMBER_7
    model = rows("New York week, its last day added", week.select(~last), week.select(last), rounds)
    if not quick and GRAND_CENTRAL.exists():
        drawn = drawn_from(grand_central(), 101_000)
        rows("Grand Central, drawn", drawn.select(np.arange(100_000)), drawn.select(np.arange(100_000, 101_000)), 3)
    grown = model.extend(week.select(last))
    filter = MHPF(model, 200)
    beliefs = []
    for k in range(AGENTS):
        track = model.tracks[k]
        beliefs.append(filter.step(filter.start(fix=Fix(track[0])), [Fix(track[-1])], dt=60.0))
    cpu, _ = cost(lambda: [belief.on(grown) for belief in beliefs], rounds)
    forgotten, _ = cost(lambda: grown.forget(2 * DAY), rounds)
    left = len(grown.forget(2 * DAY).tracks)
    print(f"\nA belief of 200 particles taken on: {1e6 * cpu / AGENTS:.0f} µs. Forgetting all but {left:,} of "
          f"{len(grown.tracks):,} tracks: {forgotten:.2f} CPU s.")  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
