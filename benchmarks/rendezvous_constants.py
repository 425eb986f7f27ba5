"""How the constants of the filter in phases were learned: ``python -m benchmarks.rendezvous_constants [generations]``.

Evolution strategy with adapted covariance (CMA-ES; Hansen, "The CMA Evolution Strategy: A Tutorial", 2016) over the
logarithms of the constants, from those in ``experiments.rendezvous.relational``. What is made small, on 300 tuning
scenes with all positions and 300 with 60 % missing: the log-loss of "the ships have met", as said and at its best scale
and offset (half each), and a tenth of the position error as a share of the Kalman filter's. None of these scenes is
among those of ``wakefold.experiments.rendezvous.trials``.
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.optimize import minimize

from wakefold.experiments.rendezvous.relational import LEARNED, Constants, meeting, phases
from wakefold.experiments.rendezvous.rivals import kalman, position_error
from wakefold.experiments.rendezvous.scenes import HARD, scenes
from wakefold.experiments.rendezvous.trials import Q
from wakefold.experiments.stats import f1

SEED, SD, SHARES, SCENES, POSITION = 20111, 200.0, (0.0, 0.6), 300, 0.1
SOME = [scenes(SCENES, HARD, SD, np.random.default_rng([SEED, k]), missing=m) for k, m in enumerate(SHARES)]
PLAIN = [position_error(kalman(some, SD, Q, smooth=False).position, some) for some in SOME]


def loss(logs: np.ndarray, *, show: bool = False) -> float:
    """Of constants given as logarithms; infinite where they are no probabilities."""
    constants = Constants(*np.exp(logs))
    if constants.turning_first + constants.resting_first > 0.9:
        return np.inf
    total = 0.0
    for some, plain in zip(SOME, PLAIN, strict=True):
        _, odds, place = phases(some, SD, meeting(constants))
        odds, error = np.clip(odds, -30.0, 30.0), position_error(place, some) / plain

        def log_loss(w: np.ndarray, odds: np.ndarray = odds, met: np.ndarray = some.positive) -> float:
            z = np.exp(w[0]) * odds + w[1]
            return float(np.logaddexp(0.0, np.where(met, -z, z)).clip(0.0, 10.0).mean())

        said, best = log_loss(np.zeros(2)), minimize(log_loss, np.zeros(2), method="Nelder-Mead").fun
        total += (0.5 * said + 0.5 * best + POSITION * error) / len(SOME)
        if show:
            print(f"log-loss {said:.4f}, F1 {f1(odds > 0, some.positive):.3f}, position error {error:.3f} of Kalman's")
    return total


def main(generations: int) -> None:
    mean, width = np.log(LEARNED), 0.3
    print(f"start: {loss(mean, show=True):.4f}")
    n, rng = len(mean), np.random.default_rng(SEED)
    count, half = 14, 7
    weights = np.log(half + 0.5) - np.log(np.arange(1, half + 1))
    weights /= weights.sum()
    mass = 1.0 / (weights**2).sum()
    c_path, c_cov = (mass + 2) / (n + mass + 5), 4 / (n + 4)
    c_one = 2 / ((n + 1.3) ** 2 + mass)
    c_rank = min(1 - c_one, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
    usual = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    path, spread, cov = np.zeros(n), np.zeros(n), np.eye(n)
    for generation in range(generations):
        scale, axes = np.linalg.eigh(cov)
        scale = np.sqrt(np.maximum(scale, 1e-12))
        tried = rng.standard_normal((count, n)) @ (axes * scale).T
        chosen = tried[np.argsort([loss(mean + width * step) for step in tried])[:half]]
        step = weights @ chosen
        mean = mean + width * step
        path = (1 - c_path) * path + np.sqrt(c_path * (2 - c_path) * mass) * (axes @ ((axes.T @ step) / scale))
        spread = (1 - c_cov) * spread + np.sqrt(c_cov * (2 - c_cov) * mass) * step
        cov = (1 - c_one - c_rank) * cov + c_one * np.outer(spread, spread) + c_rank * (chosen.T * weights) @ chosen
        width *= np.exp(c_path / (1 + c_path) * (np.linalg.norm(path) / usual - 1))
        print(f"{generation}: {loss(mean):.4f}, width {width:.3f}", flush=True)
    loss(mean, show=True)
    for name, value in zip(Constants._fields, np.exp(mean), strict=True):
        print(f"    {name}={value:.3g},")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
