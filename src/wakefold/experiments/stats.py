"""Statistics over scenarios: the runs of one scenario share their truth, so only its mean counts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.types import Bools

RESAMPLES = 4000


def scenario_means(runs: ArrayLike) -> NDArray[np.float64]:
    """``(scenarios,)`` means of ``(scenarios, repetitions)``."""
    return np.asarray(runs, dtype=np.float64).mean(axis=1)


def half_width(means: ArrayLike) -> float:
    """Half the 95 % interval of the mean of scenarios (Student's t); NaN for a single one."""
    from scipy.stats import t

    x = np.asarray(means, dtype=np.float64)
    if len(x) < 2:
        return float("nan")
    return float(t.ppf(0.975, len(x) - 1) * x.std(ddof=1) / np.sqrt(len(x)))


def ratio_interval(a: ArrayLike, b: ArrayLike) -> tuple[float, float, float]:
    """Ratio of the means of two paired samples and its 95 % interval (percentiles of a bootstrap over scenarios)."""
    x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    rows = np.random.default_rng(0).integers(len(x), size=(RESAMPLES, len(x)))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = x[rows].mean(axis=1) / y[rows].mean(axis=1)
        low, high = np.nanquantile(ratios, [0.025, 0.975])
        return float(x.mean() / y.mean()), float(low), float(high)


def wilcoxon(a: ArrayLike, b: ArrayLike) -> float:
    """p of the two-sided paired signed-rank test; 1 where the pairs are equal.

    With n pairs it cannot be below 2 ** (1 - n): 0.002 for ten scenarios, 0.0625 for five.
    """
    from scipy.stats import wilcoxon

    x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if np.allclose(x, y, rtol=1e-12, atol=0.0):
        return 1.0
    result: Any = wilcoxon(x, y)
    return float(result.pvalue)


def f1(found: Bools, truth: Bools) -> float:
    """Harmonic mean of precision and recall; 0 where nothing was found."""
    return float(2 * (found & truth).sum() / max(int(found.sum()) + int(truth.sum()), 1))


def number(value: float) -> str:
    """Three significant digits; a dash for none."""
    if not np.isfinite(value):
        return "–"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def mean_text(means: ArrayLike) -> str:
    """ "mean ± half the 95 % interval" of scenarios."""
    x = np.asarray(means, dtype=np.float64)
    return f"{number(float(x.mean()))} ± {number(half_width(x))}" if np.isfinite(x).all() else "–"


def ratio_text(a: ArrayLike, b: ArrayLike) -> str:
    """ "ratio [low, high]"."""
    return "{} [{}, {}]".format(*(number(x) for x in ratio_interval(a, b)))


def p_text(p: float) -> str:
    """ "p = …"."""
    return f"p = {p:.2g}" if p >= 1e-4 else "p < 1e-4"
