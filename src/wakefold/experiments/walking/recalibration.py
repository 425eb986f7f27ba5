"""What beliefs in company over time are worth: corrections of their log-odds, learned where the groups are known.

Weights are learned from whole tracks (``relations_fit``), so that beliefs of the first seconds are too small; and where
beliefs are asked only at certain moments, of certain people, they may be worth something else again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from wakefold.base.types import Bools, Floats
from wakefold.relations.learning.logistic import log_odds, logistic, probability
from wakefold.relations.learning.walkers import Together

MOMENTS = np.unique(np.rint(5 * 1.35 ** np.arange(20)).astype(np.int64))  # frames at which beliefs over time are judged


class Correction(NamedTuple):
    """How much surer the log-odds over time should be; made by ``learn_soon`` or ``learn_surer``.

    Attributes:
        slope, offset: of the log-odds.
    """

    slope: float
    offset: float

    def surer(self, belief: Floats) -> Floats:
        """Beliefs over time, corrected."""
        return probability(self.slope * log_odds(belief) + self.offset)


def learn_soon(beliefs: Sequence[Floats], pairs: Sequence[Together], together: Sequence[Bools]) -> Correction:
    """Weights are learned from whole tracks, so that beliefs of the first seconds are too small: by how much.

    Logistic regression on the log-odds at moments ever further apart; scenes weigh as in ``fit``. The beliefs must
    come from constants of other scenes, or they look better than they are.

    Args:
        beliefs: ``(R,)`` for each scene, of ``TogetherFit.over_time``.
        pairs: of each scene.
        together: ``(K,)`` for each scene, whether each of its pairs is together.
    """
    said, labels = [], []
    for p, who, y in zip(beliefs, pairs, together, strict=True):
        at = who.offsets
        pair = np.repeat(np.arange(len(y)), np.diff(at))
        taken = np.flatnonzero(np.isin(np.arange(at[-1]) - at[pair] + 1, MOMENTS))
        said.append(p[taken])
        labels.append(y[pair[taken]])
    return learn_surer(said, labels)


def learn_surer(beliefs: Sequence[Floats], together: Sequence[Bools]) -> Correction:
    """What beliefs at certain moments are worth: the correction that makes them right there.

    Logistic regression on the log-odds; scenes weigh as in ``fit``.

    Args:
        beliefs: ``(n,)`` for each scene, from constants of other scenes.
        together: ``(n,)`` for each scene, whether they are right.
    """
    importance = [np.full(len(y), 10.0 / np.sqrt(max(y.sum(), 1))) for y in together]
    x = np.column_stack([log_odds(np.concatenate(beliefs)), np.ones(sum(map(len, beliefs)))])
    slope, offset = logistic(x, np.concatenate(together), np.concatenate(importance), np.zeros(len(x)), 0.3)
    return Correction(float(slope), float(offset))
