"""Tracks that could be near a given one: descending the boxes of ``wakefold.model.linkage.bounds``."""

from __future__ import annotations

import numpy as np

from wakefold.base.compile import kernel, ordered_inner


@ordered_inner
def gap_squared(low, high, n, others_low, others_high, m, d, limit):
    """Squared lower bound of the distance between box n and box m of others; from the limit on it may be too low.

    A track is a box whose corners are both its features.
    """
    worst = np.float32(0.0)
    for end in range(0, 2 * d, d):
        total = np.float32(0.0)
        for k in range(end, end + d):
            g = max(np.float32(0.0), max(low[n, k] - others_high[m, k], others_low[m, k] - high[n, k]))
            total += g * g
        worst = max(worst, total)
    if worst >= limit:
        return worst
    widest = np.float32(0.0)
    for k in range(2 * d, low.shape[1]):
        widest = max(widest, max(low[n, k] - others_high[m, k], others_low[m, k] - high[n, k]))
    return max(worst, widest * widest)


@kernel
def near(queries, q, features, bounds, low, high, d, limit, rows, squares):
    """Tracks with a squared bound below the limit.

    Args:
        queries: ``(Q, F)`` features.
        q: the query.
        features, bounds, low, high: of the tracks searched, see ``wakefold.model.linkage.bounds.Boxes``.
        d: coordinates of a point.
        limit: square of a lower bound, in units of the features.
        rows, squares: ``(M,)`` written: tracks in box order and the squares of their bounds.

    Returns:
        number of tracks found.
    """
    inner = len(bounds) - 2
    stack, top, count = np.zeros(64, np.int64), 1, 0
    while top > 0:
        top -= 1
        n = stack[top]
        if gap_squared(queries, queries, q, low, high, n, d, limit) >= limit:
            continue
        if n < inner:
            stack[top], stack[top + 1] = 2 * n + 1, 2 * n + 2
            top += 2
            continue
        for x in range(bounds[n - inner], bounds[n - inner + 1]):
            square = gap_squared(queries, queries, q, features, features, x, d, limit)
            if square < limit:
                rows[count], squares[count] = x, square
                count += 1
    return count
