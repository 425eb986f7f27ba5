"""How far the engines of the relational filter are from "bootstrap" with 100,000 particles, on small scenes.

``python -m benchmarks.engines [seeds]``. Three scenes of twelve frames, 0.4 s apart, error 0.3 m, names known; the
relation switches as a predicate holds (near and of one velocity), so that there is no exact answer to compare with.
For each engine: the gap of the probability of the relation of each pair to that of "bootstrap", over all pairs, frames
and seeds, and of the positions of the objects. A second run of "bootstrap" tells its own sampling error, "rbk" with
20,000 particles how much of a gap is that of "bootstrap" itself.
"""

from __future__ import annotations

import sys
from time import process_time

import numpy as np

import wakefold as wf
from wakefold.relations.model import couple_velocity, near, same_velocity

DT, SD, FRAMES = 0.4, 0.3, 12
REFERENCE = 100_000  # particles
ENGINES = {
    "bootstrap, again": 100_000,
    "bootstrap": 1_000,
    "adapted": 1_000,
    "rbk": 1_000,
    "rbk, many": 20_000,
    "collapsed": 1,
}
SCENES = ("two keep together", "two drift apart", "a third joins two")


def scene(name: str, seed: int) -> np.ndarray:
    """``(FRAMES, n, 2)`` fixes, metres."""
    rng = np.random.default_rng([SCENES.index(name), seed])
    t = DT * np.arange(FRAMES)
    walk = [np.column_stack([1.2 * t, 0.0 * t]), np.column_stack([1.2 * t, 0.8 + 0.0 * t])]
    if name == "two drift apart":
        walk[1] = walk[1] + np.column_stack([0.0 * t, 0.35 * t])
    if name == "a third joins two":
        walk.append(np.column_stack([1.2 * t, 1.6 + np.maximum(2.4 - t, 0.0)]))
    at = np.stack(walk, axis=1)
    return at + SD * rng.normal(size=at.shape)


def model() -> wf.RelationalModel:
    """Pairs may be related from the beginning."""
    together = wf.Relation(
        "together",
        ("person", "person"),
        on_when=near(2.0) & same_velocity(0.5),
        rate_on=0.3,
        rate_off=0.05,
        prior=0.3,
        couples=couple_velocity(k=0.5, noise=0.1),
    )
    return wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35, speed=1.0)}, [together])


def follow(fixes: np.ndarray, engine: str, particles: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities ``(FRAMES, pairs)`` and positions ``(FRAMES, n, 2)``."""
    f = wf.RelationalFilter(model(), engine.split(",")[0], particles=particles, gate=20.0, seed=seed)  # pyright: ignore
    belief, p, at = f.start(), [], []
    n = fixes.shape[1]
    for k, fix in enumerate(fixes):
        belief = f.step(belief, wf.Detections(fix, sd=SD, ids=np.arange(n), detect_prob=1.0), dt=DT if k else 0.0)
        p.append([belief.probability("together", i, j) for i in range(n) for j in range(i)])
        at.append(belief.mean[:, 0])
    return np.array(p), np.array(at)


def main(quick: bool = False, seeds: int = 5) -> None:
    seeds = 1 if quick else seeds
    print("| scene | engine | particles | gap, mean | mean, absolute | largest | positions, cm | CPU s a scene |")
    print("|---|---|---|---|---|---|---|---|")
    for name in SCENES:
        gaps: dict[str, list[np.ndarray]] = {engine: [] for engine in ENGINES}
        away: dict[str, list[float]] = {engine: [] for engine in ENGINES}
        spent = dict.fromkeys(ENGINES, 0.0)
        for seed in range(seeds):
            fixes = scene(name, seed)
            p, at = follow(fixes, "bootstrap", 1_000 if quick else REFERENCE, seed=1)
            for engine, particles in ENGINES.items():
                start = process_time()
                mine, here = follow(fixes, engine, min(particles, 1_000) if quick else particles, seed=2)
                spent[engine] += process_time() - start
                gaps[engine].append(mine - p)
                away[engine].append(float(np.sqrt(((here - at) ** 2).sum(axis=2).mean())))
        for engine, particles in ENGINES.items():
            gap = np.array(gaps[engine])
            print(
                f"| {name} | {engine} | {particles if particles > 1 else ''} | {gap.mean():+.3f} "
                f"| {np.abs(gap).mean():.3f} | {np.abs(gap).max():.3f} | {100 * np.mean(away[engine]):.2f} "
                f"| {spent[engine] / seeds:.2f} |"
            )


if __name__ == "__main__":
    rest = [argument for argument in sys.argv[1:] if argument != "--quick"]
    main("--quick" in sys.argv[1:], *(int(argument) for argument in rest[:1]))
