"""Columns of trails: of agents just met, copied, and read back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wakefold.filters.kernels.trail import REPORTS, SLOTS, Trails

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration

LEAST_ODDS = 1e-3  # that a report leaves to what it speaks against: none is so sure that fixes cannot say otherwise


def columns(agents: int, dim: int) -> Trails:
    """Trails of so many agents of whom nothing is known yet."""
    d = max(dim, 2)
    return Trails(
        np.zeros((agents, SLOTS)), np.zeros((agents, SLOTS, d)), np.zeros(agents, dtype=np.int64),
        np.zeros(agents), np.ones(agents), np.zeros((agents, REPORTS, 2), dtype=np.int64),
        np.ones((agents, REPORTS)), np.zeros(agents, dtype=np.int64), np.zeros((agents, 2), dtype=np.uint64),
        np.zeros(agents, dtype=np.int64), np.zeros(agents),
    )  # fmt: skip


def copied(trails: Trails) -> Trails:
    """The same, of its own arrays."""
    return Trails._make(column.copy() for column in trails)


def unpacked(arrays: Mapping[str, NDArray[Any]], tree: Filtration) -> Trails:
    """The trail of one agent that was stored.

    Raises:
        KeyError, ValueError: something is missing or unsound.
    """
    if arrays["points"].ndim != 3:
        raise ValueError("its points are no trail")
    empty = columns(1, arrays["points"].shape[2])
    trails = Trails._make(np.array(arrays[name]) for name in Trails._fields)
    for name, blank, own in zip(Trails._fields, empty, trails, strict=True):
        if own.shape != blank.shape or own.dtype != blank.dtype:
            raise ValueError(f"its {name} are {own.dtype} {own.shape}")
    n, told = int(trails.fixes[0]), int(trails.told[0])
    sound = 0 <= n <= SLOTS and 0 <= told <= REPORTS and (np.diff(trails.times[0, :n]) >= 0).all()
    sound = sound and all(np.isfinite(own).all() for own in trails if own.dtype == np.float64) and trails.sd[0] > 0
    odds = trails.odds[0, :told]
    sound = sound and bool(((odds >= LEAST_ODDS) & (odds <= 1 / LEAST_ODDS)).all())
    classes = set(zip(tree.lo.tolist(), tree.hi.tolist(), strict=True))
    if not sound or not classes.issuperset(map(tuple, trails.reports[0, :told].tolist())):
        raise ValueError("its trail is none")
    return trails
