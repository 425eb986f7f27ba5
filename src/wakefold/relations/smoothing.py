"""Where an agent was, given positions with noise and holes: the plain Kalman filter and smoother of one agent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wakefold.base.types import Floats
from wakefold.relations.kernels import kalman


class Smoothed(NamedTuple):
    """Position and velocity of one agent over time.

    Attributes:
        position: ``(T, d)`` metres; NaN before the first position was seen.
        velocity: ``(T, d)`` m/s.
        cov: ``(T, 2, 2)`` of position and velocity, in any one axis.
        log_likelihood: of the positions seen, but for the first.
    """

    position: Floats
    velocity: Floats
    cov: Floats
    log_likelihood: float


def constant_velocity(
    seen: ArrayLike,
    times: ArrayLike,
    sd: ArrayLike,
    *,
    q: float,
    speed: float = 10.0,
    smooth: bool = True,
) -> Smoothed:
    """The Kalman filter, or smoother, of one agent whose velocity wanders (white-noise acceleration).

    Args:
        seen: ``(T, d)`` positions, metres; a row of NaN where nothing was received.
        times: ``(T,)`` seconds, not falling.
        sd: of the noise in either coordinate, metres: one number or ``(T,)``, above 0.
        q: power of the acceleration, m²/s³: the velocity wanders by sqrt(q dt) m/s in dt seconds.
        speed: standard deviation of the velocity before anything was seen, m/s.
        smooth: whether positions to come count too (Rauch-Tung-Striebel), or only those so far.

    Raises:
        ValueError: numbers that are not above 0, or shapes that do not fit.
    """
    places = np.ascontiguousarray(seen, dtype=np.float64)
    clock = np.ascontiguousarray(times, dtype=np.float64)
    noise = np.ascontiguousarray(np.broadcast_to(np.asarray(sd, dtype=np.float64), clock.shape))
    if places.ndim != 2 or places.shape[0] != len(clock):
        raise ValueError(f"seen must be (T, d) with T = {len(clock)} times, got shape {places.shape}")
    if not (q > 0 and speed > 0 and (noise > 0).all()):
        raise ValueError("q, speed and sd must be above 0")
    mean, cov = np.empty((len(clock), 2, places.shape[1])), np.empty((len(clock), 2, 2))
    ahead, cov_ahead = np.empty_like(mean), np.empty_like(cov)
    fit = kalman.constant_velocity(places, clock, noise, float(q), float(speed), mean, cov, ahead, cov_ahead)
    if smooth:
        kalman.smooth(clock, mean, cov, ahead, cov_ahead)
    return Smoothed(mean[:, 0], mean[:, 1], cov, float(fit))
