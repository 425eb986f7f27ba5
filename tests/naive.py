"""The definitions, in slow and obvious loops: what the fast kernels are checked against."""

import math
from itertools import pairwise

import numpy as np

# Tracks: stops, simplification, resampling


def stops(points, times, radius, duration):
    """(n,) bool: the points of stops, see `Tracks.segment`."""
    stopped = np.zeros(len(points), dtype=bool)
    i = 0
    while i < len(points):
        inside = [
            j for j in range(i, len(points)) if all(distance(points[k], points[i]) <= radius for k in range(i, j + 1))
        ]
        if times[inside[-1]] - times[i] >= duration:
            stopped[inside] = True
            i = inside[-1] + 1
        else:
            i += 1
    return stopped


def distance(p, q):
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(p, q, strict=True)))


def distance_to_path(point, path):
    """Distance from a point to the nearest place on a polyline (n, d)."""
    best = min(distance(point, p) for p in path)
    for a, b in pairwise(path):
        chord = b - a
        if chord @ chord > 0:
            share = min(1.0, max(0.0, (point - a) @ chord / (chord @ chord)))
            best = min(best, distance(point, a + share * chord))
    return best


def douglas_peucker(points, tolerance):
    """Rows kept, by the recursion of Douglas and Peucker (1973)."""
    if len(points) <= 2:
        return list(range(len(points)))
    away = [distance_to_path(p, points[[0, -1]]) for p in points[1:-1]]
    if max(away) <= tolerance:
        return [0, len(points) - 1]
    split = 1 + away.index(max(away))
    left, right = douglas_peucker(points[: split + 1], tolerance), douglas_peucker(points[split:], tolerance)
    return left + [split + row for row in right[1:]]


# Distance and filtration


def frechet(a, b):
    """Discrete Fréchet distance, Eiter and Mannila (1994), Table 1, on distances (not squares)."""
    c = {}
    for i in range(len(a)):
        for j in range(len(b)):
            total = 0.0
            for x, y in zip(a[i].tolist(), b[j].tolist(), strict=True):
                total = total + (x - y) * (x - y)
            before = [c[cell] for cell in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if cell in c]
            c[i, j] = max(math.sqrt(total), min(before)) if before else math.sqrt(total)
    return c[len(a) - 1, len(b) - 1]


def components(distances, height):
    """Set of frozensets: the parts of the graph that joins tracks no further apart than the height."""
    parts = [{i} for i in range(len(distances))]
    for i in range(len(distances)):
        for j in range(i):
            if distances[i][j] <= height:
                (p,) = (part for part in parts if i in part)
                (q,) = (part for part in parts if j in part)
                if p is not q:
                    parts.remove(q)
                    p |= q
    return {frozenset(part) for part in parts}


def single_linkage(distances):
    """All classes as {frozenset of tracks: (birth, death)}, from the partition at every distance there is."""
    heights = sorted({float(d) for row in distances for d in row} | {0.0})
    out = {frozenset([i]): (0.0, math.inf) for i in range(len(distances))}
    for height in heights:
        parts = components(distances, height)
        for part in parts:
            out.setdefault(part, (height, math.inf))
        for part, (birth, death) in out.items():
            if death == math.inf and part not in parts:
                out[part] = (birth, height)
    return out
