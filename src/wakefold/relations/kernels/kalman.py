"""Kalman filter and Rauch-Tung-Striebel smoother of positions under white-noise acceleration.

The axes share one covariance, as both are seen or missing together: a step costs the same in any number of dimensions.
Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), Sections 5.2, 6.2, 8.6.
"""

import numpy as np

from wakefold.base.compile import kernel


@kernel
def constant_velocity(seen, times, sd, q, speed, mean, cov, mean_ahead, cov_ahead):
    """Filtered states of one track.

    seen (T, d), NaN where nothing was received; sd (T,); q is the power of the acceleration, m^2/s^3; ``speed`` the
    standard deviation of the velocity at first, m/s. Fills mean (T, 2, d): position and velocity; cov (T, 2, 2) of an
    axis; and the same before the position of the moment was heard. What precedes the first position stays NaN.
    Returns the log-likelihood of all positions but the first.
    """
    count, d = seen.shape
    total, begun = 0.0, False
    for t in range(count):
        heard = not np.isnan(seen[t, 0])
        if not begun:
            mean[t] = np.nan
            cov[t] = np.nan
            mean_ahead[t] = np.nan
            cov_ahead[t] = np.nan
            if heard:
                begun = True
                mean[t, 0] = seen[t]
                mean[t, 1] = 0.0
                cov[t, 0, 0], cov[t, 1, 1] = sd[t] ** 2, speed**2
                cov[t, 0, 1] = cov[t, 1, 0] = 0.0
                mean_ahead[t] = mean[t]
                cov_ahead[t] = cov[t]
            continue
        dt = times[t] - times[t - 1]
        a, b, c = cov[t - 1, 0, 0], cov[t - 1, 0, 1], cov[t - 1, 1, 1]
        a, b, c = a + 2 * dt * b + dt * dt * c + q * dt**3 / 3, b + dt * c + q * dt**2 / 2, c + q * dt
        mean_ahead[t, 0] = mean[t - 1, 0] + dt * mean[t - 1, 1]
        mean_ahead[t, 1] = mean[t - 1, 1]
        cov_ahead[t, 0, 0], cov_ahead[t, 1, 1] = a, c
        cov_ahead[t, 0, 1] = cov_ahead[t, 1, 0] = b
        if not heard:
            mean[t] = mean_ahead[t]
            cov[t] = cov_ahead[t]
            continue
        s = a + sd[t] ** 2
        gain, gain_v = a / s, b / s
        for k in range(d):
            off = seen[t, k] - mean_ahead[t, 0, k]
            mean[t, 0, k] = mean_ahead[t, 0, k] + gain * off
            mean[t, 1, k] = mean_ahead[t, 1, k] + gain_v * off
            total -= 0.5 * (off * off / s + np.log(2 * np.pi * s))
        cov[t, 0, 0] = (1 - gain) * a
        cov[t, 0, 1] = cov[t, 1, 0] = (1 - gain) * b
        cov[t, 1, 1] = c - gain_v * b
    return total


@kernel
def smooth(times, mean, cov, mean_ahead, cov_ahead):
    """Turn filtered states into smoothed ones, in place, from the last back to the first that was heard."""
    for t in range(len(times) - 2, -1, -1):
        if np.isnan(cov[t, 0, 0]):
            return
        dt = times[t + 1] - times[t]
        a, b, c = cov[t, 0, 0], cov[t, 0, 1], cov[t, 1, 1]
        p, r, s = cov_ahead[t + 1, 0, 0], cov_ahead[t + 1, 0, 1], cov_ahead[t + 1, 1, 1]
        det = p * s - r * r
        # Gain: cov F' / cov_ahead, by the inverse of a matrix of two by two.
        u, v = a + dt * b, b + dt * c
        g00, g01 = (u * s - b * r) / det, (b * p - u * r) / det
        g10, g11 = (v * s - c * r) / det, (c * p - v * r) / det
        for k in range(mean.shape[2]):
            x, y = mean[t + 1, 0, k] - mean_ahead[t + 1, 0, k], mean[t + 1, 1, k] - mean_ahead[t + 1, 1, k]
            mean[t, 0, k] += g00 * x + g01 * y
            mean[t, 1, k] += g10 * x + g11 * y
        e, f, h = cov[t + 1, 0, 0] - p, cov[t + 1, 0, 1] - r, cov[t + 1, 1, 1] - s
        cov[t, 0, 0] += g00 * (g00 * e + g01 * f) + g01 * (g00 * f + g01 * h)
        cov[t, 1, 1] += g10 * (g10 * e + g11 * f) + g11 * (g10 * f + g11 * h)
        cov[t, 0, 1] += g10 * (g00 * e + g01 * f) + g11 * (g00 * f + g01 * h)
        cov[t, 1, 0] = cov[t, 0, 1]
