"""How the settings of the rendezvous experiment were chosen: ``python -m benchmarks.rendezvous_settings``.

Every hidden Markov model is tried with each of its settings on the same tuning scenes (hard negatives, noise of 200 m):
it learns from 60 and is judged, by F1 at the threshold of the training part, on 150 others; twice. None of these scenes
is among those of ``wakefold.experiments.rendezvous.trials``.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from wakefold.experiments.rendezvous.rivals import (
    States,
    decoded,
    features,
    kalman,
    phased,
    received,
    threshold,
    two_class,
)
from wakefold.experiments.rendezvous.scenes import HARD, scenes
from wakefold.experiments.stats import f1

SEED, SD, FOLDS = 20111, 200.0, 2
QS = (0.0005, 0.002, 0.005)


def main() -> None:
    rng = np.random.default_rng(SEED)
    folds = [(scenes(60, HARD, SD, rng), scenes(150, HARD, SD, rng)) for _ in range(FOLDS)]
    found: dict[tuple, list[float]] = {}
    for train, judge in folds:
        for set_, q in [("received", 0.0), *product(("filtered", "smoothed"), QS)]:
            views = [
                received(s) if set_ == "received" else kalman(s, SD, q, smooth=set_ == "smoothed")
                for s in (train, judge)
            ]
            x, asked = map(features, views)
            for method, states in product((two_class, phased, decoded), (2, 4, 6)):
                scores, ours = method(x, train, asked, States(states, states), np.random.default_rng(SEED))
                at = threshold(scores, train.positive)
                found.setdefault((method.__name__, set_, q, states), []).append(f1(ours > at.score, judge.positive))
    for (method, set_, q, states), values in sorted(found.items(), key=lambda item: (item[0][:2], -np.mean(item[1]))):
        print(f"{method:<10}{set_:<10}q {q:<8g}{states} states  F1 {np.mean(values):.3f}")


if __name__ == "__main__":
    main()
