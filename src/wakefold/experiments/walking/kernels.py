"""Random exchanges of names among people, for ``wakefold.experiments.walking.blackout``."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.compile import inner, kernel

PAIRS, THREES = 0.3, 0.51  # of the exchanges: two pairs; up to here: three people in turn; else two people


class Ties(NamedTuple):
    """Pairs of people.

    Attributes:
        add: (m, n, n) what is added for pair e = (first, second) at two places.
        first, second: (m,).
        begin, member: pairs of each person are ``member[begin[i]:begin[i + 1]]``.
    """

    add: NDArray[np.float64]
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    begin: NDArray[np.int64]
    member: NDArray[np.int64]


@inner
def _tied(ties, names, moved, count):
    """Sum of the ties of the first ``count`` people in ``moved``, each once."""
    first, second, begin, member = ties.first, ties.second, ties.begin, ties.member
    total = 0.0
    for k in range(count):
        for r in range(begin[moved[k]], begin[moved[k] + 1]):
            e = member[r]
            other = first[e] + second[e] - moved[k]
            counted = False
            for earlier in range(k):
                counted = counted or moved[earlier] == other
            if not counted:
                total += ties.add[e, names[first[e]], names[second[e]]]
    return total


@kernel
def exchange(own, ties, names, draws, cooling, hot, count):
    """Metropolis steps over one-to-one assignments, slowly cooled to temperature 1 and then counted.

    own (n, n): log-likelihood of each person at each place; names (n,): the assignment, changed in place; draws
    (steps, 5) uniform; ``cooling``: steps before counting; ``hot``: inverse temperature at first. Adds to count (n, n)
    how often each person was at each place.
    """
    first, second = ties.first, ties.second
    n, m = len(names), len(first)
    moved, new, old = np.zeros(4, np.int64), np.zeros(4, np.int64), np.zeros(4, np.int64)
    for step in range(len(draws)):
        u = draws[step]
        if m > 1 and u[0] < PAIRS:
            a, b = int(u[1] * m), int(u[2] * m)
            moved[0], moved[1], moved[2], moved[3] = first[a], second[a], first[b], second[b]
            size, flip = 4, u[3] < 0.5
            new[0], new[1] = names[moved[2 + flip]], names[moved[3 - flip]]
            new[2 + flip], new[3 - flip] = names[moved[0]], names[moved[1]]
        else:
            size = 3 if n > 2 and u[0] < THREES else 2
            for k in range(size):
                moved[k] = int(u[1 + k] * n)
            for k in range(size):
                new[k] = names[moved[(k + 1) % size]]
        apart = True
        for k in range(size):
            for j in range(k):
                apart = apart and moved[j] != moved[k]
        if apart:
            gain = -_tied(ties, names, moved, size)
            for k in range(size):
                old[k] = names[moved[k]]
                gain += own[moved[k], new[k]] - own[moved[k], old[k]]
                names[moved[k]] = new[k]
            gain += _tied(ties, names, moved, size)
            cold = 1.0 if step >= cooling else hot + (1.0 - hot) * step / cooling
            if math.log(u[4] + 1e-300) >= cold * gain:
                for k in range(size):
                    names[moved[k]] = old[k]
        if step >= cooling:
            for i in range(n):
                count[i, names[i]] += 1.0
