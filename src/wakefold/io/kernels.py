"""Which rows of an agent can be one body's, compiled. Arrays in, arrays out."""

from __future__ import annotations

import math

import numpy as np

from wakefold.base.compile import kernel

OPEN = 8  # strands of an agent that may go on


@kernel
def strands(time, points, offsets, radius, max_speed, strand):
    """Number the rows ``strand (n,)`` of each agent by bodies, from 0, in the order of time.

    A row goes on the strand whose last row is nearest among those from which ``max_speed`` is enough; else it begins
    one. Of more than ``OPEN`` strands, the one that has waited for longest ends.

    Args:
        time: (n,) seconds, never falling within an agent, whose rows are ``offsets[m]:offsets[m + 1]``.
        points: (n, 3) places; on a sphere of this ``radius``, or in a plane if it is 0.
    """
    last = np.empty(OPEN, dtype=np.int64)
    name = np.empty(OPEN, dtype=np.int64)
    for m in range(len(offsets) - 1):
        count, names = 0, 0
        for i in range(offsets[m], offsets[m + 1]):
            chosen, nearest = -1, np.inf
            for k in range(count):
                square = 0.0
                for axis in range(3):
                    square += (points[i, axis] - points[last[k], axis]) ** 2
                away = math.sqrt(square)
                if radius > 0.0:
                    away = 2.0 * radius * math.asin(min(away / (2.0 * radius), 1.0))
                passed = time[i] - time[last[k]]
                if passed > 0.0 and away <= max_speed * passed and away < nearest:
                    chosen, nearest = k, away
            if chosen < 0:
                if count < OPEN:
                    chosen = count
                    count += 1
                else:
                    chosen = 0
                    for k in range(1, OPEN):
                        if last[k] < last[chosen]:
                            chosen = k
                name[chosen] = names
                names += 1
            strand[i] = name[chosen]
            last[chosen] = i
