"""Stops, simplification and places along ragged tracks, compiled. Arrays in, arrays out."""

from __future__ import annotations

import numpy as np

from wakefold.base.compile import inner, kernel


@kernel
def mark_stops(points, times, offsets, radius, duration, stopped):
    """Mark the points of stops in ``stopped (P,)`` bool, false before.

    Scanning a track from its start, a stop begins at the first point p_i such that p_i..p_j all lie within
    ``radius`` of p_i and t_j - t_i >= ``duration``; j is as large as possible and the scan goes on at j + 1. A
    point that begins no stop was followed for less than ``duration``, so the work is linear in P for a given
    sampling rate, however long the stops.
    """
    for m in range(len(offsets) - 1):
        i, end = offsets[m], offsets[m + 1]
        while i < end:
            j = i + 1
            while j < end:
                square = 0.0
                for k in range(points.shape[1]):
                    square += (points[j, k] - points[i, k]) ** 2
                if not square <= radius * radius:
                    break
                j += 1
            if times[j - 1] - times[i] >= duration:
                while i < j:
                    stopped[i] = True
                    i += 1
            else:
                i += 1


@kernel
def douglas_peucker(points, offsets, tolerance, kept):
    """Mark in ``kept (P,)`` bool, false before, the points to keep: every other point lies within ``tolerance`` of the
    segment between the kept points before and after it (Douglas & Peucker 1973, without recursion)."""
    longest = 0
    for m in range(len(offsets) - 1):
        longest = max(longest, offsets[m + 1] - offsets[m])
    stack = np.empty((longest + 1, 2), dtype=np.int64)
    for m in range(len(offsets) - 1):
        first, last = offsets[m], offsets[m + 1] - 1
        kept[first] = True
        kept[last] = True
        stack[0, 0], stack[0, 1] = first, last
        top = 1
        while top > 0:
            top -= 1
            a, b = stack[top, 0], stack[top, 1]
            farthest, split = tolerance * tolerance, -1
            for i in range(a + 1, b):
                square = _square_to_segment(points[i], points[a], points[b])
                if square > farthest:
                    farthest, split = square, i
            if split >= 0:
                kept[split] = True
                stack[top, 0], stack[top, 1] = a, split
                stack[top + 1, 0], stack[top + 1, 1] = split, b
                top += 2


@inner
def _square_to_segment(p, a, b):
    along = 0.0
    chord = 0.0
    for k in range(len(p)):
        along += (p[k] - a[k]) * (b[k] - a[k])
        chord += (b[k] - a[k]) ** 2
    share = min(max(along / chord, 0.0), 1.0) if chord > 0.0 else 0.0
    square = 0.0
    for k in range(len(p)):
        square += (p[k] - a[k] - share * (b[k] - a[k])) ** 2
    return square


@kernel
def along(points, times, offsets, chosen, share, out):
    """Positions at a share (N,) of the duration of the ``chosen`` tracks (N,), into ``out`` (N, d).

    Args:
        points, times: (P, d), (P,) of all tracks; those of a track are ``offsets[track]:offsets[track + 1]``.
    """
    for i in range(len(chosen)):
        low, high = offsets[chosen[i]], offsets[chosen[i] + 1] - 1
        at = times[low] + share[i] * (times[high] - times[low])
        while low < high:  # the last point that is not later
            middle = (low + high + 1) // 2
            if times[middle] <= at:
                low = middle
            else:
                high = middle - 1
        for k in range(out.shape[1]):
            out[i, k] = points[low, k]
            if times[low] < at and low + 1 < offsets[chosen[i] + 1]:
                slope = (points[low + 1, k] - points[low, k]) / (times[low + 1] - times[low])
                out[i, k] = slope * (at - times[low]) + points[low, k]
