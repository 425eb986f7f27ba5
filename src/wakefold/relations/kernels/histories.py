"""What the relations of a pair may have been: a few Gaussians over its relative state, and how alike ones are merged.

A row of ``WIDTH`` numbers is one Gaussian: relative position and velocity, second minus first (0 to 3), covariance of
each axis (position, cross, velocity; 4 to 6) and its probability (7). The rows of a pair stand together, those of the
pair unrelated before those of it related.
"""

import numpy as np

from wakefold.base.compile import inner, kernel

WIDTH = 8
MOST = 16  # Gaussians of a pair in one mode
ALIKE = 0.05  # nats: two Gaussians are merged where no more is lost of what is known of the mode
TINY = 1e-200  # least determinant of a covariance


@inner
def copy(row, to):
    """One row to another (faster than by a slice)."""
    for k in range(WIDTH):
        to[k] = row[k]


@inner
def absorb(row, other):
    """The Gaussian of the same probability, mean and covariance as two together, into the first."""
    total = row[7] + other[7]
    t = other[7] / total
    px, py, vx, vy = other[0] - row[0], other[1] - row[1], other[2] - row[2], other[3] - row[3]
    s = 0.5 * t * (1.0 - t)
    row[0], row[1], row[2], row[3] = row[0] + t * px, row[1] + t * py, row[2] + t * vx, row[3] + t * vy
    row[4] += t * (other[4] - row[4]) + s * (px * px + py * py)
    row[5] += t * (other[5] - row[5]) + s * (px * vx + py * vy)
    row[6] += t * (other[6] - row[6]) + s * (vx * vx + vy * vy)
    row[7] = total


@inner
def _inverse(row):
    """One over the determinant of a covariance (of one axis)."""
    return 1.0 / max(row[4] * row[6] - row[5] * row[5], TINY)


@inner
def _lost(row, other, inverse, another):
    """What merging two Gaussians loses of the knowledge of their mode, nats times its probability; at most.

    Runnalls (IEEE Trans. AES 2007, 43: 989-999) bounds the divergence by w log r + w' log r', r the ratio of the
    determinant of the merged covariance to that of each (with two axes alike: of one axis); log r <= r - 1.
    """
    total = row[7] + other[7]
    t = other[7] / total
    px, py, vx, vy = other[0] - row[0], other[1] - row[1], other[2] - row[2], other[3] - row[3]
    s = 0.5 * t * (1.0 - t)
    pp = row[4] + t * (other[4] - row[4]) + s * (px * px + py * py)
    pv = row[5] + t * (other[5] - row[5]) + s * (px * vx + py * vy)
    vv = row[6] + t * (other[6] - row[6]) + s * (vx * vx + vy * vy)
    return (pp * vv - pv * pv) * (row[7] * inverse + other[7] * another) - total


@inner
def reduce(rows, at, many, limit, total, inverse):
    """Merge, among the rows ``at : at + many`` of one mode, the two most alike, while they are alike or too many.

    Args:
        limit: Gaussians that may stay.
        total: probability of the mode.
        inverse: (MOST + 1,) to work on.

    Returns:
        How many stayed; they are the first rows.
    """
    for i in range(many if many > 1 else 0):
        inverse[i] = _inverse(rows[at + i])
    while many > 1:
        least, first, second = 0.0, -1, -1
        for i in range(1, many):
            for j in range(i):
                loss = _lost(rows[at + j], rows[at + i], inverse[j], inverse[i])
                if first < 0 or loss < least:
                    least, first, second = loss, j, i
        if many <= limit and least > ALIKE * total:
            break
        absorb(rows[at + first], rows[at + second])
        many -= 1
        if many > 1:
            inverse[first] = _inverse(rows[at + first])
        if second < many:
            copy(rows[at + many], rows[at + second])
            inverse[second] = inverse[many]
    return many


@kernel
def gather(old, old_counts, new, new_counts, source, out, counts):
    """The rows of pairs where ``source`` (P,) says which of the old, else those of the new ones one after the other.

    Args:
        old, new: (H, WIDTH) rows of pairs.
        old_counts, new_counts: (., 2) how many rows a pair has, unrelated and related.
        out, counts: out, with room enough.

    Returns:
        How many rows of ``out`` there are.
    """
    starts = np.empty(len(old_counts), dtype=np.int64)
    at = 0
    for i in range(len(old_counts)):
        starts[i] = at
        at += old_counts[i, 0] + old_counts[i, 1]
    taken = fresh = to = 0
    for i in range(len(source)):
        if source[i] >= 0:
            counts[i, 0], counts[i, 1] = old_counts[source[i], 0], old_counts[source[i], 1]
            start = starts[source[i]]
            for k in range(counts[i, 0] + counts[i, 1]):
                copy(old[start + k], out[to])
                to += 1
        else:
            counts[i, 0], counts[i, 1] = new_counts[taken, 0], new_counts[taken, 1]
            taken += 1
            for _ in range(counts[i, 0] + counts[i, 1]):
                copy(new[fresh], out[to])
                fresh += 1
                to += 1
    return to
