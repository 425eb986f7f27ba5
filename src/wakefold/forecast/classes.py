"""Beliefs about classes, scored: which class, of those alive at a level, is the whole track of?

The true class is that of the past track nearest to the whole track (Fréchet distance). It is asked for after a quarter,
half and three quarters of the track.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wakefold.base.types import Floats, Ints
from wakefold.forecast.questions import SHARES
from wakefold.model.filtration import Filtration
from wakefold.model.model import Model
from wakefold.tracks.tracks import Tracks

FLOOR = 1e-4  # of every probability so much is that of the prior: one that is 0 costs some ten nats and a bit, not all
BINS = 10  # of the calibration error
TRUE, TOP, HIT = range(3)  # probability of the true class and of the likeliest, and whether they are one


class Table(NamedTuple):
    """Probabilities of the classes of a level, the likeliest first, as ``Belief.level`` gives them."""

    classes: Ints
    probability: Floats


def nearest_past(model: Model, tracks: Tracks) -> Ints:
    """``(T,)`` the past track nearest to each whole track, in points as far apart as those of the model."""
    spacing = model.tracks.median_spacing
    whole = tracks.resample(spacing=spacing) if spacing > 0 else tracks
    return np.array([model.filtration.query(points, model.tracks, k=1)[0][0] for points in whole], dtype=np.int64)


class Ledger:
    """Takes down beliefs about the classes of tracks.

    Args:
        tree: of the model.
        truth: ``(T,)`` past track whose class each track is of.
        levels: metres.

    Attributes:
        found: ``(T, 3, L, 3)`` by track, share of it and level: ``TRUE``, ``TOP``, ``HIT``; NaN where nothing was told.
    """

    def __init__(self, tree: Filtration, truth: Ints, levels: list[float]) -> None:
        self.tree, self.levels = tree, levels
        self._prior: Floats = (tree.hi - tree.lo) / len(tree)
        self._true = np.array([[tree.class_at(int(t), b) for b in levels] for t in truth]).reshape(
            len(truth), len(levels)
        )
        self.found = np.full((len(truth), len(SHARES), len(levels), 3), np.nan)

    def level(self, track: int, moment: int, level: int, table: Any) -> None:
        """A table of the probabilities of one of the levels, by its number."""
        true, prior = int(self._true[track, level]), self._prior
        of_true = float(table.probability[table.classes == true].sum())
        top = int(table.classes[0])
        self.found[track, moment, level] = (
            (1.0 - FLOOR) * of_true + FLOOR * prior[true],
            (1.0 - FLOOR) * float(table.probability[0]) + FLOOR * prior[top],
            top == true,
        )

    def tables(self, share: Floats) -> list[Table]:
        """The probabilities of every level that shares ``(M,)`` of the past tracks make."""
        ranked, out = share[self.tree.order], []
        for level in self.levels:
            classes = self.tree.alive(level)
            probability = np.add.reduceat(ranked, self.tree.lo[classes])
            order = np.argsort(-probability, kind="stable")
            out.append(Table(classes[order], probability[order]))
        return out

    def told(self, track: int, moment: int, tables: list[Table]) -> None:
        """A table for each level."""
        for number, table in enumerate(tables):
            self.level(track, moment, number, table)

    def tracks(self, named: Ints, prior: float) -> None:
        """Past tracks ``(T * 3, k)`` named at the three moments of each track, all as likely as one another.

        Args:
            prior: share of the probability that is spread over all past tracks.
        """
        for at, each in enumerate(named):
            share = np.bincount(each, minlength=len(self.tree)) / len(each)
            self.told(*divmod(at, len(SHARES)), self.tables((1.0 - prior) * share + prior / len(self.tree)))


def prior(tree: Filtration, truth: Ints, levels: list[float]) -> Floats:
    """What knows nothing of a track scores: every past track is as likely as another."""
    ledger = Ledger(tree, truth, levels)
    tables = ledger.tables(np.full(len(tree), 1.0 / len(tree)))
    for track in range(len(truth)):
        for moment in range(len(SHARES)):
            ledger.told(track, moment, tables)
    return ledger.found


def calibration_error(top: Floats, hit: Floats) -> float:
    """Expected calibration error of the likeliest class.

    The difference between the mean probability and the share that were right, in ten bins of probability, weighted by
    their number.
    """
    bins = np.minimum((top * BINS).astype(int), BINS - 1)
    number = np.bincount(bins, minlength=BINS)
    gap = np.abs(np.bincount(bins, top, BINS) - np.bincount(bins, hit, BINS))
    return float(gap.sum() / number.sum())


def summary(found: Floats) -> dict[str, dict[str, float]]:
    """Scores at one level by share of the track, from ``(T, 3, 3)``.

    Mean -log p, share right, calibration error, and of how many tracks.
    """
    out = {}
    for moment, share in enumerate(SHARES):
        rows = found[:, moment][np.isfinite(found[:, moment, TRUE])]
        if len(rows):
            out[f"{100 * share:.0f}"] = {
                "nll": float(-np.log(rows[:, TRUE]).mean()),
                "accuracy": float(rows[:, HIT].mean()),
                "ece": calibration_error(rows[:, TOP], rows[:, HIT]),
                "n": len(rows),
            }
    return out
