"""Pairs let go and taken up from one step to the next: two rising lists merged."""

import numpy as np

from wakefold.base.compile import kernel


@kernel
def within(points, strip, order, gate):
    """Pairs of objects within ``gate``, (P, 2), the smaller place first.

    Args:
        points: (n, 2) objects strip by strip, in each by rising first coordinate.
        strip: (n,) number of the strip of each, a whole one; a strip is at least ``gate`` wide.
        order: (n,) place of each object.
    """
    n = len(points)
    out, count, behind = np.empty((4 * n, 2), dtype=np.int64), 0, 0
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        while behind < n and (
            strip[behind] <= strip[i] or (strip[behind] == strip[i] + 1 and x - points[behind, 0] > gate)
        ):
            behind += 1
        for ahead in range(2):  # of the own strip those that follow, and the next strip
            j = behind if ahead else i + 1
            while j < n and strip[j] == strip[i] + ahead and points[j, 0] - x <= gate:
                apart = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2
                if apart <= gate * gate:
                    if count == len(out):
                        more = np.empty((2 * count, 2), dtype=np.int64)
                        more[:count] = out
                        out = more
                    out[count, 0], out[count, 1] = min(order[i], order[j]), max(order[i], order[j])
                    count += 1
                j += 1
    return out[:count]


@kernel
def merge(first, second, place, mean, hidden, reach, wanted):
    """Which pairs there are after a step.

    Args:
        first, second: (P,) pairs of objects before, rising.
        place: (n_before,) new place of each object, rising; -1 for one let go.
        mean: (n, 2, d) objects now.
        hidden: (n,) whether an object is not seen.
        reach: metres; a pair farther apart is let go, but for one with a hidden object.
        wanted: (W,) pairs that are to be there, first * n + second, rising.

    Returns:
        First and second object of each pair, rising; where it was before, or -1 for a new one.
    """
    n, d = len(mean), mean.shape[2]
    room = len(first) + len(wanted)
    out_first, out_second = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    source = np.empty(room, dtype=np.int64)
    count, j = 0, 0
    for i in range(len(first)):
        a, b = place[first[i]], place[second[i]]
        if a < 0 or b < 0:
            continue
        key = a * n + b
        while j < len(wanted) and wanted[j] < key:
            out_first[count], out_second[count], source[count] = wanted[j] // n, wanted[j] % n, -1
            count += 1
            j += 1
        asked = j < len(wanted) and wanted[j] == key
        if asked:
            j += 1
        apart = 0.0
        for k in range(d):
            apart += (mean[b, 0, k] - mean[a, 0, k]) ** 2
        if asked or hidden[a] or hidden[b] or apart <= reach * reach:
            out_first[count], out_second[count], source[count] = a, b, i
            count += 1
    for k in range(j, len(wanted)):
        out_first[count], out_second[count], source[count] = wanted[k] // n, wanted[k] % n, -1
        count += 1
    return out_first[:count], out_second[:count], source[:count]


@kernel
def gather(old, new, source, out):
    """Rows (K,) of ``old`` where ``source`` (P,) says which, else those of ``new`` one after the other."""
    taken = 0
    for i in range(len(source)):
        if source[i] >= 0:
            for k in range(out.shape[1]):
                out[i, k] = old[source[i], k]
        else:
            for k in range(out.shape[1]):
                out[i, k] = new[taken, k]
            taken += 1
