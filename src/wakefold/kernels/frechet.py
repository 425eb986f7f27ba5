import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def rows_plain(points, offsets, first, last, out):
    m = len(offsets) - 1
    d = points.shape[1]
    row = np.empty(np.max(offsets[1:] - offsets[:-1]))
    for i in range(first, last):
        base = i * m - i * (i + 1) // 2 - i - 1
        na = offsets[i + 1] - offsets[i]
        for j in range(i + 1, m):
            nb = offsets[j + 1] - offsets[j]
            left = np.inf
            for p in range(na):
                left = np.inf
                diag = np.inf
                for q in range(nb):
                    s = 0.0
                    for k in range(d):
                        t = points[offsets[i] + p, k] - points[offsets[j] + q, k]
                        s += t * t
                    up = row[q] if p else np.inf
                    best = min(min(up, left), diag)
                    if p == 0 and q == 0:
                        best = 0.0
                    diag = up
                    left = max(s, best)
                    row[q] = left
            out[base + j] = np.sqrt(left)
