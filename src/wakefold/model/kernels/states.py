"""The state of an agent: where it is and how it came there, as numbers that past and present are compared by.

Raw, of length ``raw_length``: position (d), age, time, displacement since the start (d), displacement since each of the
lags (d each), in double precision. Of the features made of it, those of the map tell places apart, and those of the own
frame are the same wherever the agent is and whichever way it goes, but for the position and heading at their head.
"""

import math

from wakefold.base.compile import inner, kernel

DAY = 86400.0
BEYOND = 1e15


@inner
def place(points, times, lo, hi, at, out):
    """Position ``out`` (d,) at a time on the rows lo..hi of a track; its first and last point before and after it."""
    d = points.shape[1]
    if at <= times[lo]:
        a, b, share = lo, lo, 0.0
    elif at >= times[hi - 1]:
        a, b, share = hi - 1, hi - 1, 0.0
    else:
        a, b = lo, hi - 1
        while b - a > 1:
            middle = (a + b) // 2
            if times[middle] <= at:
                a = middle
            else:
                b = middle
        share = (at - times[a]) / (times[b] - times[a])
    for k in range(d):
        out[k] = points[a, k] + share * (points[b, k] - points[a, k])


@inner
def state(points, times, lo, hi, at, lags, out):
    """Raw state ``out`` at a time of the agent whose track is the rows lo..hi; ``lags`` (K,) in seconds."""
    d = points.shape[1]
    here = out[:d]
    place(points, times, lo, hi, at, here)
    out[d], out[d + 1] = at - times[lo], at
    for k in range(d):
        out[d + 2 + k] = here[k] - points[lo, k]
    for j in range(len(lags)):
        before = out[2 * d + 2 + j * d : 2 * d + 2 + (j + 1) * d]
        place(points, times, lo, hi, at - lags[j], before)
        for k in range(d):
            before[k] = here[k] - before[k]


@kernel
def states(points, times, offsets, track, at, lags, out):
    """Raw states ``out`` (n, raw_length) of agents on tracks (n,) at times (n,)."""
    for i in range(len(track)):
        state(points, times, offsets[track[i]], offsets[track[i] + 1], at[i], lags, out[i])


@inner
def heading(raw, d, lags, base):
    """Velocity over the base lag: speed, and the cosine and sine of its heading, 1 and 0 of an agent at rest."""
    span = min(lags[base], raw[d])
    if not span > 0.0:
        return 0.0, 1.0, 0.0
    at = 2 * d + 2 + base * d
    x, y = raw[at] / span, raw[at + 1] / span
    ground = math.sqrt(x * x + y * y)
    if not ground > 0.0:
        return 0.0, 1.0, 0.0
    return ground, x / ground, y / ground


@inner
def features(raw, who, d, lags, base, slow, daily, to_map, to_own):
    """Features ``to_map`` and ``to_own`` (F,) of a raw state of the agent numbered ``who``, of the same number."""
    ground, c, s = heading(raw, d, lags, base)
    now, start, age = raw[:d], raw[d + 2 : 2 * d + 2], raw[d]
    away = 0.0
    for k in range(d):
        to_map[k] = to_own[k] = now[k]
        away += start[k] * start[k]
        to_map[d + k] = now[k] - start[k]
    n = d
    to_own[n], to_own[n + 1] = start[0] * c + start[1] * s, start[1] * c - start[0] * s
    for k in range(2, d):
        to_own[n + k] = start[k]
    n += d
    # newer against older half: how it turns and speeds up, along and across
    new, old = min(lags[base], age), min(lags[base + 1], age) - min(lags[base], age)
    first, second = 2 * d + 2 + base * d, 3 * d + 2 + base * d
    x = y = 0.0
    if old > 0.0:
        x = raw[first] / new - (raw[second] - raw[first]) / old
        y = raw[first + 1] / new - (raw[second + 1] - raw[first + 1]) / old
    to_map[n], to_map[n + 1] = x * c + y * s, y * c - x * s
    to_map[n + 2], to_map[n + 3], to_map[n + 4] = c, s, math.log(ground + slow)
    to_map[n + 5], to_map[n + 6] = age, math.sqrt(away)
    to_map[n + 7] = raw[d + 1] % DAY if daily else 0.0
    to_map[n + 8] = who
    for k in range(n, n + 9):
        to_own[k] = to_map[k]
    n += 9
    for j in range(len(lags)):
        at = 2 * d + 2 + j * d
        for k in range(d):
            to_map[n + k] = to_own[n + k] = raw[at + k]
        to_own[n], to_own[n + 1] = raw[at] * c + raw[at + 1] * s, raw[at + 1] * c - raw[at] * s
        n += d


@kernel
def all_features(raw, who, d, lags, base, slow, daily, to_map, to_own):
    """``features`` of raw states (n, raw_length)."""
    for i in range(len(raw)):
        features(raw[i], who[i], d, lags, base, slow, daily, to_map[i], to_own[i])


@inner
def steps(seconds, step):
    """How many steps that is; no more than a whole number holds."""
    return min(seconds / step, BEYOND)


@kernel
def futures(points, begins, track, row, ahead, step, out):
    """Displacement ``out`` (n, H, d) of past states ``row`` (n,) until ``ahead`` (H,) seconds later, or their end."""
    d = points.shape[1]
    for i in range(len(row)):
        last = begins[track[row[i]] + 1] - 1
        for h in range(len(ahead)):
            later = steps(ahead[h], step)
            a = min(row[i] + int(later), last)
            b = min(a + 1, last)
            share = later - int(later) if a < last else 0.0
            for k in range(d):
                there = points[a, k] + share * (points[b, k] - points[a, k])
                out[i, h, k] = there - points[row[i], k]


@kernel
def targets(raw, d, lags, base, moved, ahead, out):
    """Residuals ``out`` (n, H, d) of displacements against constant velocity, along and across the heading."""
    for i in range(len(raw)):
        ground, c, s = heading(raw[i], d, lags, base)
        for h in range(len(ahead)):
            x, y = moved[i, h, 0] - ahead[h] * ground * c, moved[i, h, 1] - ahead[h] * ground * s
            for k in range(d):
                out[i, h, k] = moved[i, h, k]
            out[i, h, 0], out[i, h, 1] = x * c + y * s, y * c - x * s


def raw_length(d: int, lags: int) -> int:
    """Numbers of a raw state."""
    return 2 * d + 2 + d * lags


def feature_count(d: int, lags: int) -> int:
    """Numbers of a vector of features."""
    return 2 * d + 9 + d * lags
