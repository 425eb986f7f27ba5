"""Compiled loops over fixes, tracks and samples: arrays in, arrays out."""

from __future__ import annotations

import math

import numpy as np

from wakefold.base.compile import inner, kernel

WIDTH = 0.4  # of the density of samples: share of their median distance from the geometric median
ROUNDS, CLOSE = 200, 1e-5  # of the search for the geometric median: its last step, as a share of the mean distance


@kernel
def given(times, offsets, every, out):
    """Mark the first point of each track, and each that comes ``every`` seconds or more after the last one marked."""
    for track in range(len(offsets) - 1):
        last = -np.inf
        for row in range(offsets[track], offsets[track + 1]):
            if times[row] - last >= every:
                out[row] = True
                last = times[row]


@inner
def _between(points, times, low, when, out):
    """Position at a time between rows ``low`` and ``low + 1``."""
    share = (when - times[low]) / (times[low + 1] - times[low])
    for axis in range(points.shape[1]):
        out[axis] = points[low, axis] + share * (points[low + 1, axis] - points[low, axis])


@inner
def _place(points, times, begin, end, when, out):
    """Position of a track of the rows ``begin:end`` at a time; before it began its first, after its end its last."""
    if when <= times[begin]:
        out[:] = points[begin]
    elif when >= times[end - 1]:
        out[:] = points[end - 1]
    else:
        low, high = begin, end - 1
        while high - low > 1:
            middle = (low + high) // 2
            if times[middle] <= when:
                low = middle
            else:
                high = middle
        _between(points, times, low, when, out)


@kernel
def back(points, times, first, row, lags, out):
    """Positions ``(Q, L, d)`` so many seconds before the fixes ``row``, from ``first`` up to them alone."""
    for q in range(len(row)):
        for lag in range(len(lags)):
            _place(points, times, first[q], row[q] + 1, times[row[q]] - lags[lag], out[q, lag])


@kernel
def places(points, times, offsets, track, when, out):
    """Positions ``(N, H, d)`` of tracks at times ``(N, H)``; before they began and after their end as at it."""
    for k in range(len(track)):
        begin, end = offsets[track[k]], offsets[track[k] + 1]
        for h in range(when.shape[1]):
            _place(points, times, begin, end, when[k, h], out[k, h])


@kernel
def kalman(points, times, offsets, q, r, speed, states, covs):
    """Kalman filter of constant velocity with white-noise acceleration along each track, every axis alike.

    Fills positions and velocities ``(F, 2, d)``, and for an axis the variance of position, the covariance of both and
    the variance of velocity ``(F, 3)``, after each fix. ``q`` m²/s³, ``r`` sd of a fix, ``speed`` sd of the velocity at
    first.
    """
    for track in range(len(offsets) - 1):
        begin, end = offsets[track], offsets[track + 1]
        states[begin, 0] = points[begin]
        states[begin, 1] = 0.0
        a, b, c = r * r, 0.0, speed * speed
        covs[begin, 0], covs[begin, 1], covs[begin, 2] = a, b, c
        for row in range(begin + 1, end):
            dt = times[row] - times[row - 1]
            a += 2.0 * dt * b + dt * dt * c + q * dt**3 / 3.0
            b += dt * c + q * dt * dt / 2.0
            c += q * dt
            total = a + r * r
            gain, turn = a / total, b / total
            for axis in range(points.shape[1]):
                ahead = states[row - 1, 0, axis] + dt * states[row - 1, 1, axis]
                off = points[row, axis] - ahead
                states[row, 0, axis] = ahead + gain * off
                states[row, 1, axis] = states[row - 1, 1, axis] + turn * off
            c -= turn * b
            b *= 1.0 - gain
            a *= 1.0 - gain
            covs[row, 0], covs[row, 1], covs[row, 2] = a, b, c


@inner
def _middle(samples, away, at):
    """Geometric median of the samples into ``at``, by the steps of Weiszfeld, past samples as Vardi and Zhang (2000).

    ``away`` holds all distances between samples. The search starts from the sample nearest to all others.
    """
    count, dim = samples.shape
    best, least = 0, np.inf
    for i in range(count):
        total = away[i].sum()
        if total < least:
            best, least = i, total
    at[:] = samples[best]
    scale = least / count
    if scale == 0.0:
        return
    pull, ahead = np.empty(dim), np.empty(dim)
    for _ in range(ROUNDS):
        weight, here = 0.0, 0.0
        pull[:] = 0.0
        ahead[:] = 0.0
        for i in range(count):
            square = 0.0
            for axis in range(dim):
                square += (samples[i, axis] - at[axis]) ** 2
            distance = math.sqrt(square)
            if distance <= 1e-12 * scale:
                here += 1.0
                continue
            weight += 1.0 / distance
            for axis in range(dim):
                ahead[axis] += samples[i, axis] / distance
                pull[axis] += (samples[i, axis] - at[axis]) / distance
        strength = math.sqrt((pull * pull).sum())
        stay = min(1.0, here / strength) if strength > 0.0 else 1.0
        if weight == 0.0 or stay >= 1.0:
            return
        moved = 0.0
        for axis in range(dim):
            step = (1.0 - stay) * (ahead[axis] / weight - at[axis])
            at[axis] += step
            moved += step * step
        if moved <= (CLOSE * scale) ** 2:
            return


@kernel
def middles(samples, out):
    """Geometric medians ``(N, d)`` of samples ``(N, S, d)``."""
    count = samples.shape[1]
    away = np.empty((count, count))
    for n in range(len(samples)):
        _distances(samples[n], away)
        _middle(samples[n], away, out[n])


@inner
def _distances(samples, away):
    count, dim = samples.shape
    for i in range(count):
        away[i, i] = 0.0
        for j in range(i):
            square = 0.0
            for axis in range(dim):
                square += (samples[i, axis] - samples[j, axis]) ** 2
            away[i, j] = math.sqrt(square)
            away[j, i] = away[i, j]


@kernel
def judge(samples, truth, middle, out):
    """Score samples ``(N, S, d)`` of S >= 2 against truths ``(N, d)``.

    Fills the geometric medians ``(N, d)`` and ``(N, 3)``: distance of the truth from it, fair energy score, and the
    share of the samples where the density is higher than at the truth. The density is of Gaussians about the samples,
    sd ``WIDTH`` times their median distance from the geometric median; at a sample it is that of all others.
    """
    count, dim = samples.shape[1:]
    away, off, density = np.empty((count, count)), np.empty(count), np.zeros(count)
    for n in range(len(samples)):
        _distances(samples[n], away)
        _middle(samples[n], away, middle[n])
        near, wide = 0.0, 0.0
        for i in range(count):
            to_truth, to_middle = 0.0, 0.0
            for axis in range(dim):
                to_truth += (samples[n, i, axis] - truth[n, axis]) ** 2
                to_middle += (samples[n, i, axis] - middle[n, axis]) ** 2
            near += math.sqrt(to_truth)
            off[i] = math.sqrt(to_middle)
            for j in range(i):
                wide += away[i, j]
        away_from_middle = 0.0
        for axis in range(dim):
            away_from_middle += (truth[n, axis] - middle[n, axis]) ** 2
        out[n, 0] = math.sqrt(away_from_middle)
        out[n, 1] = near / count - wide / (count * (count - 1.0))
        width = WIDTH * np.median(off)
        if width == 0.0:  # most samples in one place: it is all of the region
            out[n, 2] = 0.0 if out[n, 0] == 0.0 else 1.0
            continue
        scale = -0.5 / (width * width)
        density[:] = 0.0
        at_truth = 0.0
        for i in range(count):
            square = 0.0
            for axis in range(dim):
                square += (samples[n, i, axis] - truth[n, axis]) ** 2
            at_truth += math.exp(scale * square)
            for j in range(i):
                share = math.exp(scale * away[i, j] * away[i, j])
                density[i] += share
                density[j] += share
        higher = 0
        for i in range(count):
            if density[i] / (count - 1.0) > at_truth / count:
                higher += 1
        out[n, 2] = higher / count
