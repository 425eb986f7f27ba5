"""What "who walks with whom" is held against: a rule on distance and velocity, and a logistic regression.

Both read whole tracks of a pair, and are trained and tuned on the same scenes as the relation's constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from wakefold.base.types import Bools, Floats
from wakefold.experiments.stats import f1
from wakefold.relations.learning.logistic import logistic
from wakefold.relations.learning.together import Crowd
from wakefold.relations.learning.walkers import Walkers, steps

DISTANCES = (0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.3, 2.6, 3.0)  # metres
DIFFERENCES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8)  # m/s
SHARES = (0.3, 0.5, 0.7, 0.8, 0.9)  # of the time
RIDGES = (0.01, 0.1, 1.0)
CUTS = tuple(np.linspace(-2.5, 2.5, 21))  # log-odds
COLUMNS = {"spacing and velocity": slice(0, 7), "and coming and going": slice(0, 11)}


def features(walkers: Walkers, scene: Crowd) -> Floats:
    """``(K, 11)`` of each pair: logs of the mean, least, greatest and spread of the distance, of the mean difference of
    velocities, of the mean speed, cosine of mean velocities; logs of the time together, of its share of the time either
    is there, and of the gaps between their coming and their going.
    """
    pairs = scene.pairs
    s, at = steps(walkers, pairs), pairs.offsets
    frames = np.diff(at)

    def mean(x: Floats) -> Floats:
        return np.add.reduceat(x, at[:-1]) / frames

    distance = mean(s.spacing)
    spread = np.sqrt(np.maximum(mean(s.spacing**2) - distance**2, 0.0))
    least, most = np.minimum.reduceat(s.spacing, at[:-1]), np.maximum.reduceat(s.spacing, at[:-1])
    begin = np.abs(walkers.begin[pairs.first] - walkers.begin[pairs.second]) * walkers.dt
    end = np.abs(walkers.end[pairs.first] - walkers.end[pairs.second]) * walkers.dt
    either = np.maximum(walkers.end[pairs.first], walkers.end[pairs.second]) - np.minimum(
        walkers.begin[pairs.first], walkers.begin[pairs.second]
    )
    return np.column_stack(
        [
            np.log(distance + 0.1),
            np.log(least + 0.1),
            np.log(most + 0.1),
            np.log(spread + 0.05),
            np.log(mean(s.difference) + 0.05),
            np.log(mean(s.faster) + 0.05),
            mean(s.alignment),
            np.log(frames),
            frames / either,
            np.log1p(begin),
            np.log1p(end),
        ]
    )


class Rule:
    """Near and alike in velocity for a share of the time; the thresholds with the best mean F1 over scenes."""

    def __init__(self, walkers: Sequence[Walkers], scenes: Sequence[Crowd], truth: Sequence[Bools]) -> None:
        shares = [self._shares(w, c) for w, c in zip(walkers, scenes, strict=True)]
        score = np.mean(
            [
                [[f1(y, table[k] >= share) for share in SHARES] for k in range(table.shape[0])]
                for table, y in zip(shares, truth, strict=True)
            ],
            axis=0,
        )
        best, share = np.unravel_index(int(score.argmax()), score.shape)
        self.cell, self.share = int(best), SHARES[int(share)]
        self.distance, self.difference = list(product(DISTANCES, DIFFERENCES))[self.cell]

    def found(self, walkers: Walkers, scene: Crowd) -> Bools:
        """Which pairs the rule takes as together."""
        return self._shares(walkers, scene)[self.cell] >= self.share

    @staticmethod
    def _shares(walkers: Walkers, scene: Crowd) -> Floats:
        """``(cells, K)`` share of the time that each pair is near and alike, for all pairs of thresholds."""
        s, at = steps(walkers, scene.pairs), scene.pairs.offsets
        held = ((s.spacing < d) & (s.difference < v) for d, v in product(DISTANCES, DIFFERENCES))
        return np.array([np.add.reduceat(x.astype(np.float64), at[:-1]) for x in held]) / np.diff(at)


class Logistic:
    """Logistic regression on ``features``; columns, penalty and cut by leave-one-scene-out over the training scenes."""

    def __init__(self, tables: Sequence[Floats], truth: Sequence[Bools]) -> None:
        best = (-1.0, "", 0.0, 0.0)
        for columns, ridge in product(COLUMNS, RIDGES):
            held = []
            for k, (table, y) in enumerate(zip(tables, truth, strict=True)):
                others = [i for i in range(len(tables)) if i != k]
                weights = self._fit([tables[i] for i in others], [truth[i] for i in others], columns, ridge)
                z = self._log_odds(table, columns, weights)
                held.append([f1(y, z > cut) for cut in CUTS])
            score = np.mean(held, axis=0)
            best = max(best, (float(score.max()), columns, ridge, CUTS[int(score.argmax())]))
        _, self.columns, self.ridge, self.cut = best
        self.weights = self._fit(tables, truth, self.columns, self.ridge)

    def found(self, table: Floats) -> Bools:
        """Which pairs are taken as together."""
        return self._log_odds(table, self.columns, self.weights) > self.cut

    def probability(self, table: Floats) -> Floats:
        """``(K,)`` of each pair being together."""
        return 1.0 / (1.0 + np.exp(-self._log_odds(table, self.columns, self.weights)))

    @staticmethod
    def _fit(
        tables: Sequence[Floats], truth: Sequence[Bools], columns: str, ridge: float
    ) -> tuple[Floats, Floats, Floats]:
        x, y = np.concatenate([t[:, COLUMNS[columns]] for t in tables]), np.concatenate(list(truth))
        importance = np.concatenate([np.full(len(t), 10.0 / np.sqrt(max(t.sum(), 1))) for t in truth])
        centre, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
        design = np.column_stack([(x - centre) / scale, np.ones(len(x))])
        return centre, scale, logistic(design, y, importance, np.zeros(len(x)), ridge)

    @staticmethod
    def _log_odds(table: Floats, columns: str, fitted: tuple[Floats, Floats, Floats]) -> Floats:
        centre, scale, weights = fitted
        return ((table[:, COLUMNS[columns]] - centre) / scale) @ weights[:-1] + weights[-1]


def within(table: Floats, truth: Bools, seed: int, folds: int = 10) -> float:
    """F1 of the logistic regression cross-validated inside one scene: what a scene's own labels are worth."""
    fold = np.random.default_rng(seed).permutation(len(truth)) % folds
    found = np.zeros(len(truth), dtype=bool)
    best = 0.0
    for columns, ridge in product(COLUMNS, RIDGES):
        for k in range(folds):
            fitted = Logistic._fit([table[fold != k]], [truth[fold != k]], columns, ridge)
            found[fold == k] = Logistic._log_odds(table[fold == k], columns, fitted) > 0.0
        best = max(best, f1(truth, found))
    return best
