"""Filters as methods: any object with ``start``, ``step`` and ``forecast`` whose beliefs are weighted points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from wakefold.base.parallel import Progress, thread_map
from wakefold.base.types import Floats
from wakefold.evidence.fix import Fix
from wakefold.forecast.classes import Ledger
from wakefold.forecast.questions import Questions
from wakefold.forecast.samples import SAMPLES, normal_samples, systematic


class Filter(Protocol):
    """What every filter of this package is."""

    def start(self, *, fix: Fix | None = ..., time: Any = ..., agent: str | None = ...) -> Any: ...
    def step(self, belief: Any, evidence: Any = ..., dt: Any = ..., *, time: Any = ...) -> Any: ...
    def forecast(self, belief: Any, horizon: Any) -> Any: ...


def follow(
    filter: Filter, asked: Questions, ledger: Ledger | None = None, sd: float | None = None,
    progress: Progress | None = None,
) -> Floats:  # fmt: skip
    """Samples ``(Q, H, S, d)`` of a filter that follows every track; NaN where it refused to forecast.

    Args:
        ledger: takes down the belief about classes at the moments it is asked for.
        sd: of a fix, metres per axis; the filter's own by default.
    """
    out = np.full((len(asked), len(asked.horizons), SAMPLES, asked.fixes.dim), np.nan)
    begin = np.searchsorted(asked.track, np.arange(len(asked.fixes) + 1))

    def one(track: int) -> None:
        moments = {int(asked.row[q]): q for q in range(begin[track], begin[track + 1])}
        rows = [] if ledger is None else asked.class_row[track].tolist()
        last = max([*moments, *rows], default=-1)
        for row, belief in _beliefs(filter, asked, track, last, sd):
            if ledger is not None and row in rows:
                for number, level in enumerate(ledger.levels):
                    table = belief.level(level)
                    for moment in (m for m, at in enumerate(rows) if at == row):
                        ledger.level(track, moment, number, table)
            if row in moments:
                q = moments[row]
                out[q] = _ahead(filter, belief, asked, np.flatnonzero(np.isfinite(asked.truth[q, :, 0])), out[q])

    thread_map(one, range(len(asked.fixes)), progress=progress)
    return out


def _beliefs(filter: Filter, asked: Questions, track: int, last: int, sd: float | None) -> Iterator[tuple[int, Any]]:
    """The rows of the fixes of a track up to the last, and the belief after each."""
    fixes = asked.fixes
    rows = range(int(fixes.offsets[track]), min(int(fixes.offsets[track + 1]), last + 1))
    belief = None
    for row in rows:
        fix, now = Fix(fixes.points[row], sd=sd), float(fixes.times[row])
        if belief is None:
            belief = filter.start(fix=fix, time=now, agent=str(fixes.attributes.get("agent", fixes.ids)[track]))
        else:
            belief = filter.step(belief, [fix], time=now)
        yield row, belief


def _ahead(filter: Filter, belief: Any, asked: Questions, wanted: np.ndarray, out: Floats) -> Floats:
    """``(H, S, d)`` samples of the forecasts for the wanted horizons."""
    out = out.copy()
    try:
        later = filter.forecast(belief, asked.horizons[wanted].tolist())
    except ValueError:  # farther ahead than the filter goes
        return out
    for h, each in zip(wanted, later, strict=True):
        out[h] = samples(each)
    return out


def samples(belief: Any) -> Floats:
    """``(S, d)`` samples of a belief, in the order of its points; of Gaussians with their spread."""
    chosen = systematic(belief.weights)
    points = belief.points[chosen]
    gaussians = getattr(belief, "gaussians", None)
    if gaussians is None:
        return points
    factors = np.linalg.cholesky(gaussians.covs[chosen] + 1e-9 * np.eye(points.shape[1]))
    turned = normal_samples()[37 * np.arange(SAMPLES) % SAMPLES]  # neighbours in the order of points differ
    return points + np.einsum("sij,sj->si", factors, turned)
