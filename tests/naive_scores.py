"""Questions, scores and rivals of forecasts in slow and obvious loops: what the fast ones are checked against."""

import math

import numpy as np
from naive import distance


def given_fixes(times, every):
    """Numbers of the fixes of one track that are given: the first, and each so long after the last that was."""
    out = [0]
    for i in range(1, len(times)):
        if times[i] - times[out[-1]] >= every:
            out.append(i)
    return out


def energy_score(samples, truth):
    """Mean distance of a sample from the truth less half the mean distance of two different samples."""
    count = len(samples)
    near = sum(distance(s, truth) for s in samples) / count
    apart = [distance(samples[i], samples[j]) for i in range(count) for j in range(count) if i != j]
    return near - 0.5 * sum(apart) / len(apart)


def denser(samples, middle, truth, width):
    """Share of the samples where the density of all others is higher than that of all of them at the truth."""
    off = sorted(distance(s, middle) for s in samples)
    n = len(off)
    h = width * (off[n // 2] if n % 2 else (off[n // 2 - 1] + off[n // 2]) / 2)

    def density(place, others):
        return sum(math.exp(-(distance(place, s) ** 2) / (2 * h * h)) for s in others) / len(others)

    there = density(truth, samples)
    each = [density(s, [other for j, other in enumerate(samples) if j != i]) for i, s in enumerate(samples)]
    return sum(value > there for value in each) / n


def kalman_track(points, times, q, r, speed):
    """Mean (2, d) and covariance (2, 2) of position and velocity after each fix, in matrices."""
    mean, cov = np.stack([points[0], np.zeros_like(points[0])]), np.diag([r**2, speed**2])
    out = [(mean, cov)]
    for k in range(1, len(times)):
        dt = times[k] - times[k - 1]
        move = np.array([[1.0, dt], [0.0, 1.0]])
        mean, cov = move @ mean, move @ cov @ move.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        gain = cov[:, :1] / (cov[0, 0] + r**2)
        mean, cov = mean + gain * (points[k] - mean[0]), cov - gain @ cov[:1]
        out.append((mean, cov))
    return out


def calibration_error(top, hit, bins=10):
    """Expected calibration error of probabilities ``top`` of what was right where ``hit``."""
    total = 0.0
    for b in range(bins):
        inside = [i for i, p in enumerate(top) if b / bins <= p < (b + 1) / bins or (b == bins - 1 and p == 1.0)]
        if inside:
            right, sure = sum(hit[i] for i in inside) / len(inside), sum(top[i] for i in inside) / len(inside)
            total += len(inside) / len(top) * abs(right - sure)
    return total
