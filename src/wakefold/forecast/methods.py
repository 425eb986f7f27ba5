"""The methods that are scored, by name: plain rivals, and filters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from wakefold.base.types import Floats, Ints
from wakefold.filters.bootstrap import BL1, BL2
from wakefold.filters.calibrated import Calibrated
from wakefold.filters.mhpf import MHPF
from wakefold.filters.trail import Trail
from wakefold.forecast.classes import Ledger
from wakefold.forecast.followed import Filter, follow
from wakefold.forecast.questions import Questions

CONSTANT_VELOCITY, KALMAN, NEAREST, WINDOWS = "constant velocity", "Kalman", "nearest track", "nearest windows"
PARTICLES, DEPLETION = 500, 0.0009  # of so few particles it redraws none, and lets a recovery find any track
FILTERS: dict[str, Callable[..., Filter]] = {  # from a model; one line more is one filter more
    "BL1": partial(BL1, particles=PARTICLES, depletion=DEPLETION),
    "BL2": BL2,
    "MHPF": partial(MHPF, particles=PARTICLES, depletion=DEPLETION, levels=[]),
    "Calibrated": Calibrated,
    "Trail": Trail,
}
TUNED = ("BL1", "BL2", "MHPF")  # noise of motion and sd of a fix are chosen for these; the others learn them
SLOW = ("BL2", "Calibrated")  # tens of milliseconds for an answer, with a large model far more
NO_CLASSES = ("BL2",)
NAMES = (CONSTANT_VELOCITY, KALMAN, NEAREST, WINDOWS, *FILTERS)


class Method(NamedTuple):
    """One that is scored.

    Attributes:
        name: in the results.
        answer: samples ``(Q, H, S, d)`` for questions; writes beliefs about classes into the ledger, if there is one.
        setting: what was chosen for it, in plain types.
    """

    name: str
    answer: Callable[[Questions, Ledger | None], Floats]
    setting: Mapping[str, Any]


def of_filter(name: str, filter: Filter, setting: Mapping[str, Any] | None = None) -> Method:
    """A filter as it is, by a name."""

    def answer(asked: Questions, ledger: Ledger | None) -> Floats:
        return follow(filter, asked, None if name in NO_CLASSES else ledger)

    return Method(name, answer, setting or {})


def answered(samples: Floats, asked: Questions, plain: Callable[[], Floats]) -> tuple[Floats, Ints]:
    """Samples with those of a plain method where there were none, and how many such answers there are by horizon."""
    missing = ~np.isfinite(samples).all(axis=(2, 3)) & np.isfinite(asked.truth[:, :, 0])
    if missing.any():
        samples = np.where(missing[:, :, None, None], plain(), samples)
    return samples, missing.sum(axis=0)
