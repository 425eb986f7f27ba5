"""What the looks of a pair say, read from a learned table, and what two have in common with all others."""

import math
from typing import NamedTuple

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.base.types import Floats


class Looks(NamedTuple):
    """What related pairs look like, as in ``relations.PairEvidence``; an empty table: nothing is known.

    Attributes:
        distances, differences, speeds, table: edges and nats per second.
        share: (P,) seconds that the looks of this step count as.
    """

    distances: Floats
    differences: Floats
    speeds: Floats
    table: Floats
    share: Floats


@inner
def _bin(edges, value):
    """The bin of ``value``; the last one for values beyond the edges, the first for values before."""
    i = 0
    while i < len(edges) - 2 and value >= edges[i + 1]:
        i += 1
    return i


@inner
def log_ratio(ux, uy, wx, wy, ax, ay, bx, by, looks):
    """What the looks of a pair say for its being related, nats per second; arguments as in ``evaluate``."""
    i = _bin(looks.distances, math.sqrt(ux * ux + uy * uy))
    j = _bin(looks.differences, math.sqrt(wx * wx + wy * wy))
    speed = 0.5 * (math.sqrt(ax * ax + ay * ay) + math.sqrt(bx * bx + by * by))
    return looks.table[i, j, _bin(looks.speeds, speed)]


@kernel
def in_common(p, first, second):
    """Sums over others of the products of what two have with each, ``p`` (n, n) symmetric, for pairs (P,)."""
    out = np.empty(len(first))
    for i in range(len(first)):
        total = 0.0
        for k in range(len(p)):
            total += p[first[i], k] * p[second[i], k]
        out[i] = total
    return out


@kernel
def log_ratios(u, w, va, vb, looks, out):
    """``log_ratio`` of n pairs, ``u, w, va, vb`` (n, 2)."""
    for i in range(len(u)):
        out[i] = log_ratio(
            u[i, 0], u[i, 1], w[i, 0], w[i, 1], va[i, 0], va[i, 1], vb[i, 0], vb[i, 1], looks
        )  # fmt: skip
