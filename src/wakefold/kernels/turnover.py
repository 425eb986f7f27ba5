"""Pairs let go and taken up from one step to the next: two rising lists merged."""

import numpy as np

from wakefold.kernels.compile import kernel


@kernel
def within(positions, order, axis, gate):
    """Pairs of objects within ``gate``, (P, 2), the smaller place first: ``positions`` (n, d) swept along ``axis``.

    ``order`` (n,): places, rising along that axis.
    """
    n, d = positions.shape
    out = np.empty((0, 2), dtype=np.int64)
    for counted in range(2):
        count = 0
        for i in range(n):
            a = order[i]
            for j in range(i + 1, n):
                b = order[j]
                if positions[b, axis] - positions[a, axis] > gate:
                    break
                apart = 0.0
                for k in range(d):
                    apart += (positions[b, k] - positions[a, k]) ** 2
                if apart <= gate * gate:
                    if counted:
                        out[count, 0], out[count, 1] = min(a, b), max(a, b)
                    count += 1
        if not counted:
            out = np.empty((count, 2), dtype=np.int64)
    return out


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
