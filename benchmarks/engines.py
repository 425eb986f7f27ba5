"""How far the engines of the relational filter are from Algorithm 1 with 100,000 particles, on random pairs.

``python -m benchmarks.engines [scenes] [particles]``; two hours of CPU time with 200 scenes a setting and 100,000
particles. Twelve frames, 0.4 s apart. Half of the scenes are drawn from the model, in the others two walk side by side
or drift apart; in every second of either sort a quarter of the fixes is lost. The truth is ``benchmarks.reference``.
A row: a setting, the gap of P(related), mean over scenes and frames from the second on, mean absolute and largest; and
the mean logarithm of what the engine and the truth gave the relation as it was, of the scenes drawn from the model.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from typing import Any

import numpy as np

import wakefold as wf
from benchmarks.reference import Setting, belief, drawn
from wakefold.relations.model import ahead, closing, couple_velocity, near, same_velocity, slow

FRAMES, LOST = 12, 0.25
TIE = couple_velocity(k=0.5, noise=0.1)
SAID = {
    "near & same velocity": near(2.0) & same_velocity(0.5),
    "near": near(2.0),
    "same velocity": same_velocity(0.5),
    "slow": slow(0.6),
    "ahead": ahead(3.0, 1.0),
    "closing": closing(0.3),
    "near & not slow": near(2.0) & ~slow(0.6),
    "near | slow": near(2.0) | slow(0.6),
    "near & ahead": near(2.0) & ahead(3.0, 1.0),
}
RATES = {"slow": (0.3, 0.05), "fast": (2.0, 1.0)}
Fixes = np.ndarray


def settings() -> list[tuple[str, Setting]]:
    """Names and settings: noise, prior, rates and coupling; then every predicate."""
    out = []
    for sd, prior, (name, (on, off)), tie in product((0.05, 0.1, 0.3, 0.5), (0.0, 0.3), RATES.items(), (TIE, None)):
        what = f"sd {sd}, prior {prior}, {name}, {'coupled' if tie else 'not coupled'}"
        out.append((what, Setting(sd, prior, on, off, tie)))
    for predicate, sd in product(list(SAID)[1:], (0.1, 0.3)):
        out.append((f"{predicate}, sd {sd}", Setting(sd, 0.3, 0.3, 0.2, TIE, predicate)))
    return out


def scene(s: Setting, seed: int) -> tuple[Fixes, np.ndarray | None]:
    """``(FRAMES, 2, 2)`` fixes, NaN where lost; and the relation, if it was drawn from the model."""
    rng = np.random.default_rng([seed, 16])
    related = None
    if seed % 2:
        places, related = drawn(s, FRAMES, rng)
    else:
        t = s.dt * np.arange(FRAMES)[:, None]
        way, away = rng.uniform(0.0, 0.6), rng.uniform(0.4, 1.6)
        aside = rng.choice([0.0, 0.3])
        direction = rng.uniform(0, 2 * np.pi)
        places = np.stack([t * [way, 0.0], t * [way, aside] + [away * np.cos(direction), away * np.sin(direction)]], 1)
    fixes = places + s.sd * rng.normal(size=places.shape)
    if seed % 4 > 1:
        lost = rng.random((FRAMES, 2)) < LOST
        lost[0] = False
        fixes[lost] = np.nan
    return fixes, related


def follow(s: Setting, fixes: Fixes, engine: Any, particles: int, seed: int) -> np.ndarray:
    """P(related) at each frame, by an engine."""
    relation = wf.Relation(
        "r", ("p", "p"), SAID[s.predicate], rate_on=s.on, rate_off=s.off, prior=s.prior, couples=s.couples
    )
    model = wf.RelationalModel({"p": wf.ConstantVelocity(q=s.q, speed=s.speed)}, [relation])
    f = wf.RelationalFilter(model, engine, particles=particles, gate=1000.0, seed=seed)
    now, p = f.start(), []
    for k, fix in enumerate(fixes):
        there = np.flatnonzero(np.isfinite(fix[:, 0]))
        now = f.step(now, wf.Detections(fix[there], sd=s.sd, ids=there), dt=s.dt if k else 0.0)
        p.append(now.probability("r", 0, 1))
    return np.array(p)


def compare(s: Setting, engines: dict[str, int], particles: int, seed: int) -> dict[str, tuple]:
    """Of one scene: gaps ``(FRAMES - 1,)`` and log scores of each engine and of a second run of the truth."""
    fixes, related = scene(s, seed)
    truth = belief(s, fixes, particles, 2 * seed)
    said = {"truth, again": belief(s, fixes, particles, 2 * seed + 1)} if seed < 20 else {}
    said |= {engine: follow(s, fixes, engine, many, seed) for engine, many in engines.items()}
    out = {}
    for name, p in {**said, "truth": truth}.items():
        clipped = np.clip(p, 1e-6, 1 - 1e-6)[1:]
        log = np.log(np.where(related[1:], clipped, 1 - clipped)) if related is not None else np.zeros(0)
        out[name] = p[1:] - truth[1:], log, seed % 4 > 1
    return out


def main(scenes: int = 200, particles: int = 100_000, engines: str = "collapsed", only: str = "") -> None:
    counts = {name: 1000 if name in ("adapted", "rbk") else particles for name in engines.split(",")}
    print("| setting | engine | gap, mean | absolute | largest | lost: mean | absolute | log score | truth's |")
    print("|---|---|---|---|---|---|---|---|---|")
    every: dict[str, list[np.ndarray]] = {}
    with ProcessPoolExecutor(2) as pool:
        for name, s in settings():
            if only not in name:
                continue
            found = list(pool.map(partial(compare, s, counts, particles), range(scenes), chunksize=4))
            truth = np.concatenate([f["truth"][1] for f in found])
            for engine in ["truth, again", *counts]:
                some = [f[engine] for f in found if engine in f]
                gap, log = np.concatenate([g for g, _, _ in some]), np.concatenate([x for _, x, _ in some])
                lost = np.concatenate([g for g, _, missing in some if missing])
                every.setdefault(engine, []).append(gap)
                of = truth[: len(log)]
                print(
                    f"| {name} | {engine} | {gap.mean():+.4f} | {np.abs(gap).mean():.4f} | {np.abs(gap).max():.3f} "
                    f"| {lost.mean():+.4f} | {np.abs(lost).mean():.4f} | {log.mean():.4f} | {of.mean():.4f} |",
                    flush=True,
                )
    for engine, gaps in every.items():
        gap = np.concatenate(gaps)
        print(f"| all | {engine} | {gap.mean():+.4f} | {np.abs(gap).mean():.4f} | {np.abs(gap).max():.3f} | | | | |")


if __name__ == "__main__":
    rest = [argument for argument in sys.argv[1:] if argument != "--quick"]
    few = (4, 1_000) if "--quick" in sys.argv else (200, 100_000)
    numbers = [int(x) for x in rest[:2]] + list(few[len(rest[:2]) :])
    main(numbers[0], numbers[1], *rest[2:])
