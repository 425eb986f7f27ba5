"""Time of a frame of the relational filter, engine "collapsed", one thread: pairs a second, and cost against pairs.

``python -m benchmarks.relational [directory for the picture]``. People walk at 1.2 m/s on average in a square without
edges, 0.22 of them a square metre, heading anew now and then; all are seen with their names every 0.4 s, error 0.1 m.
The model is that of docs/relational.md: near and of one velocity, coupled with a pull. Medians over frames; CPU seconds
are those of the thread.
"""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

import wakefold as wf
from wakefold.relations.kernels import pairs as kernel
from wakefold.relations.model import couple_velocity, near, same_velocity

DT = 0.4  # seconds between frames
SD = 0.1  # metres
DENSITY = 0.22  # people a square metre: 1,000 have about 12,400 pairs within 6 m
WARM = 5  # frames before the clock starts
GATE = 6.0  # metres
TARGET = 5e6  # pair-steps a second


def crowd(people: int, frames: int, seed: int = 0) -> np.ndarray:
    """``(frames, people, 2)`` metres."""
    rng = np.random.default_rng(seed)
    side = np.sqrt(people / DENSITY)
    at = rng.uniform(0, side, (people, 2))
    heading, pace = rng.uniform(0, 2 * np.pi, people), rng.normal(1.2, 0.2, people)
    out = np.empty((frames, people, 2))
    for k in range(frames):
        heading += rng.normal(0, 0.1, people)
        at = (at + DT * pace[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])) % side
        out[k] = at + SD * rng.normal(size=at.shape)
    return out


def model(kind: str) -> wf.RelationalModel:
    """Of each row of the first table."""

    def relation(name: str, **more: Any) -> wf.Relation:
        couples = couple_velocity(k=0.3, noise=0.15, pull=0.02)
        pair = ("person", "person")
        when = near(2.0) & same_velocity(0.5)
        return wf.Relation(name, pair, when, rate_on=0.2, rate_off=0.0075, couples=couples, **more)

    edges = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0])
    looks = wf.PairEvidence(edges, edges, edges, np.zeros((5, 5, 5))) if "looks" in kind else None
    relations = [relation("together", evidence=looks)]
    if "two" in kind:
        relations.append(relation("beside"))
    activities = [wf.Activity("stroll", ["apart", "together", "parted"], min_time=30.0)] if "activity" in kind else []
    return wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35)}, relations, activities)


class Times(NamedTuple):
    """Medians of a run.

    Attributes:
        wall, cpu: milliseconds a frame; quartiles of the latter.
        least: CPU milliseconds of the fastest frame.
        kernel: CPU milliseconds of a frame in the pair kernel.
        pairs: of a frame.
    """

    wall: float
    cpu: float
    quartiles: tuple[float, float]
    least: float
    kernel: float
    pairs: float


def run(kind: str, people: int, gate: float, frames: int) -> Times:
    """Follow a crowd; the first frames only warm up."""
    f = wf.RelationalFilter(model(kind), "collapsed", gate=gate)
    seen = [wf.Detections(at, sd=SD, ids=np.arange(people)) for at in crowd(people, WARM + frames)]
    walls, cpus, inside, pairs = [], [], [], []
    spent = 0.0

    def timed(*args: Any) -> None:
        nonlocal spent
        start = thread_time()
        whole(*args)
        spent += thread_time() - start

    whole = kernel.step
    kernel.step = timed
    try:
        scene = f.start()
        for scan in seen:
            spent, many = 0.0, sum(len(p.first) for p in scene.pairs)  # those of the frame before are stepped
            wall, cpu = perf_counter(), thread_time()
            scene = f.step(scene, scan, dt=DT)
            cpus.append((thread_time() - cpu) * 1e3)
            walls.append((perf_counter() - wall) * 1e3)
            inside.append(spent * 1e3)
            pairs.append(many)
    finally:
        kernel.step = whole
    rest = slice(WARM, None)
    low, high = np.percentile(cpus[rest], [25, 75])
    return Times(
        median(walls[rest]),
        median(cpus[rest]),
        (float(low), float(high)),
        min(cpus[rest]),
        median(inside[rest]),
        median(pairs[rest]),
    )


def slope(pairs: list[float], times: list[float]) -> tuple[float, float, float]:
    """Exponent of the times in the pairs, and of what is linear: milliseconds at rest, and nanoseconds a pair."""
    rate, rest = np.polyfit(pairs, times, 1, w=1 / np.array(times))
    return float(np.polyfit(np.log(pairs), np.log(times), 1)[0]), float(rest), float(rate * 1e6)


def draw(series: dict[str, tuple[list[float], list[float], list[float]]], path: Path) -> None:
    """Milliseconds a frame against pairs, for the filter (filled, with what is linear) and its kernel (hollow)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4.2), layout="constrained")
    ax = figure.subplots()
    for (name, (pairs, cpu, inside)), colour in zip(series.items(), ("#1f4e79", "#c0504d"), strict=False):
        exponent, rest, rate = slope(pairs, cpu)
        line = np.geomspace(min(pairs), max(pairs))
        label = f"{name}: step {rest:.1f} ms + {rate:.0f} ns a pair; exponent {exponent:.2f}"
        ax.loglog(pairs, cpu, "o", color=colour, ms=5, label=label)
        ax.loglog(line, rest + 1e-6 * rate * line, color=colour, lw=0.8)
        label = f"its pair kernel; exponent {slope(pairs, inside)[0]:.2f}"
        ax.loglog(pairs, inside, "o", color=colour, mfc="none", ms=5, label=label)
    every = np.array(sorted(p for pairs, _, _ in series.values() for p in pairs))
    ax.loglog(every, every / TARGET * 1e3, "--", color="#999999", lw=1, label="5 M pair-steps a second")
    ax.set(xlabel="pairs within the gate", ylabel="CPU ms a frame")
    ax.set_ylim(top=200.0)
    ax.legend(frameon=False, fontsize=7, loc="upper left")
    ax.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def main(quick: bool = False, directory: Path | None = None) -> None:
    frames = 5 if quick else 50
    people = 200 if quick else 1000
    run("", 30, GATE, 2)  # compile
    print("| model | people | pairs | wall, ms | CPU, ms | CPU, quartiles | CPU, least | kernel, ms | M pair-steps/s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for kind in ("one relation", "and an activity", "and looks of pairs", "two relations"):
        t = run(kind, people, GATE, frames)
        low, high = t.quartiles
        print(
            f"| {kind} | {people:,} | {t.pairs:,.0f} | {t.wall:.2f} | {t.cpu:.2f} | {low:.2f} to {high:.2f} "
            f"| {t.least:.2f} | {t.kernel:.2f} | {t.pairs / t.kernel / 1e3:.2f} |"
        )
    series: dict[str, tuple[list[float], list[float], list[float]]] = {}
    gates = [3.0, 6.0] if quick else [2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0]
    sizes = [100, 200] if quick else [125, 250, 500, 1000, 2000, 4000, 8000]
    plans = {
        f"gate {gates[0]:g} to {gates[-1]:g} m, {people:,} people": [(people, gate) for gate in gates],
        f"{sizes[0]:,} to {sizes[-1]:,} people, gate 6 m": [(size, GATE) for size in sizes],
    }
    print("\n| series | people | gate, m | pairs | wall, ms | CPU, ms | CPU, quartiles | kernel, ms |")
    print("|---|---|---|---|---|---|---|---|")
    for name, plan in plans.items():
        pairs, cpu, inside = [], [], []
        for size, gate in plan:
            t = run("", size, gate, 5 if quick else 25)
            low, high = t.quartiles
            shown = f"{t.wall:.2f} | {t.cpu:.2f} | {low:.2f} to {high:.2f} | {t.kernel:.3f}"
            print(f"| {name} | {size:,} | {gate:g} | {t.pairs:,.0f} | {shown} |")
            pairs.append(t.pairs)
            cpu.append(t.cpu)
            inside.append(t.kernel)
        series[name] = pairs, cpu, inside
    print("\n| series | exponent, whole step | exponent, kernel | at rest, ms | ns a pair |\n|---|---|---|---|---|")
    for name, (pairs, cpu, inside) in series.items():
        exponent, rest, rate = slope(pairs, cpu)
        print(f"| {name} | {exponent:.2f} | {slope(pairs, inside)[0]:.2f} | {rest:.2f} | {rate:.0f} |")
    if directory is not None:
        draw(series, directory / "relational-cost.png")


if __name__ == "__main__":
    rest = [argument for argument in sys.argv[1:] if argument != "--quick"]
    main(quick="--quick" in sys.argv[1:], directory=Path(rest[0]) if rest else None)
