"""Features of tracks whose differences bound the Fréchet distance from below, and a tree of boxes around them."""

from __future__ import annotations

import numpy as np

from wakefold.base.compile import inner, kernel, ordered_inner, ordered_kernel

SAMPLE = 16  # tracks by which the widest feature of a box is chosen


@ordered_kernel
def track_features(points, offsets, middle, scale, directions, landmarks, first, last, axes, out):
    """Features of tracks, see ``wakefold.model.linkage.bounds``.

    Args:
        points, offsets: ragged tracks.
        middle, scale: features are those of ``(points - middle) * scale``.
        directions: ``(u, d)`` unit vectors.
        landmarks: ``(z, d)`` places, moved and scaled like the points.
        first, last: tracks to do.
        axes: tuple of d integers.
        out: ``(M, 2 d + 2 u + z)``: first point, last point, reach along each direction, reach against each, distance
            to each landmark.
    """
    longest = 0
    for track in range(first, last):
        longest = max(longest, offsets[track + 1] - offsets[track])
    at = np.empty((len(axes), longest))  # axis by axis, so that the loops over the points run in SIMD lanes
    for track in range(first, last):
        start, length = offsets[track], offsets[track + 1] - offsets[track]
        for row in range(length):
            for k in range(len(axes)):
                at[k, row] = (points[start + row, k] - middle[k]) * scale
        for k in range(len(axes)):
            out[track, k], out[track, len(axes) + k] = at[k, 0], at[k, length - 1]
        f = 2 * len(axes)
        for u in range(len(directions)):
            low, high = np.inf, -np.inf
            for row in range(length):
                along = 0.0
                for k in range(len(axes)):
                    along += at[k, row] * directions[u, k]
                low = along if along < low else low
                high = along if along > high else high
            out[track, f], out[track, f + len(directions)] = high, -low
            f += 1
        f += len(directions)
        for z in range(len(landmarks)):
            nearest = np.inf
            for row in range(length):
                square = 0.0
                for k in range(len(axes)):
                    square += (at[k, row] - landmarks[z, k]) ** 2
                nearest = square if square < nearest else nearest
            out[track, f] = np.sqrt(nearest)
            f += 1


@inner
def part(values, order, start, stop, middle):
    """Reorder ``start:stop`` so that no value before ``middle`` is larger than one from there on.

    Hoare's FIND: Communications of the ACM 4 (1961) 321, Algorithm 65.

    Args:
        values, order: ``(M,)`` reordered alike.
    """
    first, last = start, stop - 1
    while first < last:
        pivot = values[(first + last) // 2]
        i, j = first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            last = j
        elif middle >= i:
            first = i
        else:
            return


@ordered_inner
def corners(features, order, start, stop, step, low, high, n):
    """Corners of the box of every step-th track of ``order[start:stop]``, into row n."""
    for f in range(features.shape[1]):
        low[n, f] = high[n, f] = features[order[start], f]
    for i in range(start + step, stop, step):
        for f in range(features.shape[1]):
            value = features[order[i], f]
            low[n, f] = value if value < low[n, f] else low[n, f]
            high[n, f] = value if value > high[n, f] else high[n, f]


@kernel
def divide(features, order, starts, stops, low, high, values):
    """Halve the tracks at the median of their widest feature, again and again, and note the corners of the boxes.

    Args:
        features: ``(M, F)``.
        order: ``(M,)`` tracks, reordered so that box n holds ``order[starts[n]:stops[n]]``.
        starts, stops: ``(B,)`` the halves of box n are 2 n + 1 and 2 n + 2, leaves come last.
        low, high: ``(B, F)`` corners, written.
        values: ``(M,)`` scratch.
    """
    inner = len(starts) // 2
    for n in range(inner):
        corners(features, order, starts[n], stops[n], 1 + (stops[n] - starts[n]) // SAMPLE, low, high, n)
        widest = 0
        for f in range(features.shape[1]):
            if high[n, f] - low[n, f] > high[n, widest] - low[n, widest]:
                widest = f
        for i in range(starts[n], stops[n]):
            values[i] = features[order[i], widest]
        part(values, order, starts[n], stops[n], stops[2 * n + 1])
    for n in range(inner, len(starts)):
        corners(features, order, starts[n], stops[n], np.intp(1), low, high, n)  # a literal would compile it twice
    for n in range(inner - 1, -1, -1):
        for f in range(features.shape[1]):
            low[n, f] = min(low[2 * n + 1, f], low[2 * n + 2, f])
            high[n, f] = max(high[2 * n + 1, f], high[2 * n + 2, f])
