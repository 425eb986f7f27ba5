"""One step of the collapsed relational filter: objects by Kalman filters, each pair's relation summed out.

All axes share one covariance (noise is the same along each), kept as (position, cross, velocity). A motion is
(f00, f01, f10, f11, q00, q01, q11): x' = f00 x + f01 v, v' = f10 x + f11 v, and its noise.
"""

import math
from typing import NamedTuple

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.base.types import Bools, Floats, Ints
from wakefold.relations.kernels.histories import MOST, WIDTH, absorb, copy, reduce
from wakefold.relations.kernels.looks import log_ratio
from wakefold.relations.kernels.predicates import AT_ONCE, FEATURES, evaluate

FLOOR = 1e-9  # a relation is never surer than this
SURE = 1e-5  # a mode less probable is let go, if more than that can come back in a step

# Of a Gaussian being stepped, after the FEATURES that ``evaluate`` reads: covariance of position and velocity, half the
# squared innovation over its variance, one over that variance, probability, and chance to switch.
CROSS, MISFIT, PRECISION, WEIGHT, TURN = range(FEATURES, FEATURES + 5)


class Held(NamedTuple):
    """Beliefs about P pairs.

    Attributes:
        first, second: (P,) objects.
        p: (P,) probability of the relation.
        counts, states: (P, 2), (H, WIDTH) how many Gaussians each pair has unrelated and related, and these.
    """

    first: Ints
    second: Ints
    p: Floats
    counts: Ints
    states: Floats


class Seen(NamedTuple):
    """The n objects after the detections of a step.

    Attributes:
        z, variance, seen: (n, 2), (n,), (n,) detection of each object, its variance, whether there is one.
        known: (n,) whether an object was seen lately.
        mean, cov: (n, 2, 2), (n, 3) the objects' own filters.
    """

    z: Floats
    variance: Floats
    seen: Bools
    known: Bools
    mean: Floats
    cov: Floats


class Law(NamedTuple):
    """How a relation acts and changes within a step.

    Attributes:
        motions: (2, 7) of the relative state, unrelated and related.
        chances: (3, 2) of switching on and off where the predicate holds, where not, and where unknown.
        ops, numbers: of the predicate; no operations: it always holds.
        limit: Gaussians a pair may have in each mode.
    """

    motions: Floats
    chances: Floats
    ops: Ints
    numbers: Floats
    limit: int


class Switches(NamedTuple):
    """Of P pairs: probability before the switch, and of switching on and off; (P,) each."""

    before: Floats
    on: Floats
    off: Floats


@inner
def _spread(c, k, motion):
    """Predict the covariance at ``c[k : k + 3]`` in place."""
    f00, f01, f10, f11 = motion[0], motion[1], motion[2], motion[3]
    pp, pv, vv = c[k], c[k + 1], c[k + 2]
    c[k] = f00 * f00 * pp + 2.0 * f00 * f01 * pv + f01 * f01 * vv + motion[4]
    c[k + 1] = f00 * f10 * pp + (f00 * f11 + f01 * f10) * pv + f01 * f11 * vv + motion[5]
    c[k + 2] = f10 * f10 * pp + 2.0 * f10 * f11 * pv + f11 * f11 * vv + motion[6]


@inner
def _innovation(mean, cov, z, variance):
    """Squared innovation over its variance, and that variance."""
    away = 0.0
    for k in range(len(z)):
        away += (z[k] - mean[0, k]) ** 2
    s = cov[0] + variance
    return away / s, s


@inner
def _update(mean, cov, z, s):
    """Kalman update by a position; ``s``: variance of the innovation."""
    g0, g1 = cov[0] / s, cov[1] / s
    for k in range(len(z)):
        away = z[k] - mean[0, k]
        mean[0, k] += g0 * away
        mean[1, k] += g1 * away
    pp, pv = cov[0], cov[1]
    cov[0] = (1.0 - g0) * pp
    cov[1] = (1.0 - g0) * pv
    cov[2] -= g1 * pv


@kernel
def predict(mean, cov, motion):
    """Move n objects: ``mean`` (n, 2, d), ``cov`` (n, 3), in place, by ``motion`` (n, 7)."""
    for i in range(len(mean)):
        for k in range(mean.shape[2]):
            x, v = mean[i, 0, k], mean[i, 1, k]
            mean[i, 0, k] = motion[i, 0] * x + motion[i, 1] * v
            mean[i, 1, k] = motion[i, 2] * x + motion[i, 3] * v
        _spread(cov[i], 0, motion[i])


@kernel
def update(mean, cov, which, z, variance):
    """Update objects ``which`` (m,) by positions ``z`` (m, d) in place; the log-likelihood of the positions."""
    total = 0.0
    for j in range(len(which)):
        i = which[j]
        square, s = _innovation(mean[i], cov[i], z[j], variance[j])
        total -= 0.5 * (square + z.shape[1] * math.log(2.0 * math.pi * s))
        _update(mean[i], cov[i], z[j], s)
    return total


@kernel
def difference(first, second, mean, cov, out_mean, out_cov):
    """Relative state of independent objects, second minus first: ``out_mean`` (P, 2, d), ``out_cov`` (P, 3)."""
    for i in range(len(first)):
        a, b = first[i], second[i]
        for j in range(2):
            for k in range(mean.shape[2]):
                out_mean[i, j, k] = mean[b, j, k] - mean[a, j, k]
        for j in range(3):
            out_cov[i, j] = cov[a, j] + cov[b, j]


@inner
def _move_and_see(many, pair, mode, row, held, objects, motions, f):
    """Objects move as their relation of before says, and are seen, in ``many`` Gaussians of pairs.

    Args:
        pair, mode, row: of each Gaussian, the last in ``held.states``.
        f: out: (TURN + 1, AT_ONCE) rows 0 to 5, ``CROSS``, ``MISFIT`` and ``PRECISION``.
    """
    first, second, states = held.first, held.second, held.states
    z, variance, seen = objects.z, objects.variance, objects.seen
    for h in range(many):
        m, k = motions[mode[h]], row[h]
        ux, uy, wx, wy = states[k, 0], states[k, 1], states[k, 2], states[k, 3]
        pp, pv, vv = states[k, 4], states[k, 5], states[k, 6]
        f00, f01, f10, f11 = m[0], m[1], m[2], m[3]
        ux, wx = f00 * ux + f01 * wx, f10 * ux + f11 * wx
        uy, wy = f00 * uy + f01 * wy, f10 * uy + f11 * wy
        pp, pv, vv = (
            f00 * f00 * pp + 2.0 * f00 * f01 * pv + f01 * f01 * vv + m[4],
            f00 * f10 * pp + (f00 * f11 + f01 * f10) * pv + f01 * f11 * vv + m[5],
            f10 * f10 * pp + 2.0 * f10 * f11 * pv + f11 * f11 * vv + m[6],
        )
        a, b = first[pair[h]], second[pair[h]]
        if seen[a] and seen[b]:
            ex, ey = z[b, 0] - z[a, 0] - ux, z[b, 1] - z[a, 1] - uy
            s = 1.0 / (pp + (variance[a] + variance[b]))
            g0, g1 = pp * s, pv * s
            ux, uy, wx, wy = ux + g0 * ex, uy + g0 * ey, wx + g1 * ex, wy + g1 * ey
            vv -= g1 * pv
            pp *= 1.0 - g0
            pv *= 1.0 - g0
            f[MISFIT, h], f[PRECISION, h] = 0.5 * s * (ex * ex + ey * ey), s
        f[0, h], f[1, h], f[2, h], f[3, h], f[4, h], f[5, h], f[CROSS, h] = ux, uy, wx, wy, pp, vv, pv


@inner
def _weigh(lo, hi, f):
    """Probabilities of the Gaussians ``lo:hi`` of a pair given what was seen, in place."""
    best = lo
    for h in range(lo + 1, hi):
        if f[MISFIT, h] < f[MISFIT, best]:
            best = h
    total = 0.0
    for h in range(lo, hi):
        fits = f[PRECISION, h] if h == best else f[PRECISION, h] * math.exp(f[MISFIT, best] - f[MISFIT, h])
        f[WEIGHT, h] *= fits
        total += f[WEIGHT, h]
    total = 1.0 / total
    for h in range(lo, hi):
        f[WEIGHT, h] = max(f[WEIGHT, h] * total, FLOOR)


@inner
def _row(h, f, weight, row):
    """The Gaussian at ``h`` with a probability, as a row."""
    row[0], row[1], row[2], row[3] = f[0, h], f[1, h], f[2, h], f[3, h]
    row[4], row[5], row[6], row[7] = f[4, h], f[CROSS, h], f[5, h], weight


@inner
def _mode(stay, stays, come, comes, f, limit, rows, at, one, inverse):
    """Gaussians of a mode after a switch, into ``rows`` from ``at`` on: those that stayed and, as one, those that came.

    Args:
        stay, stays: the Gaussians ``stay:stays`` were of this mode; ``come:comes`` of the other.
        one, inverse: to work on.

    Returns:
        How many there are, and their probability.
    """
    many, total = 0, 0.0
    for h in range(stay, stays):
        share = f[WEIGHT, h] * (1.0 - f[TURN, h])
        if share > 0.0:
            total += share
            _row(h, f, share, rows[at + many])
            many += 1
    here = many
    for h in range(come, comes):
        share = f[WEIGHT, h] * f[TURN, h]
        if share > FLOOR * total:
            if many == here:
                _row(h, f, share, rows[at + here])
                many += 1
            else:
                _row(h, f, share, one)
                absorb(rows[at + here], one)
    if many > here:
        total += rows[at + here, 7]
    return reduce(rows, at, many, limit, total, inverse), total


@inner
def _chance(way, yes, known, chances):
    """Of a switch on (``way`` 0) or off (1) where the predicate holds with probability ``yes``; see ``step``."""
    return yes * chances[0, way] + (1.0 - yes) * chances[1, way] if known else chances[2, way]


@kernel
def step(held, objects, law, looks, switched, out):
    """Beliefs about P pairs after a step of time and the detections of both objects, in place.

    A pair is a switching linear system of two modes, unrelated (0) and related (1), over its relative state (second
    minus first), in the order of Eq. 1: objects move as they were related before, are seen, and then the relation
    changes as they are now. Each mode is a few Gaussians, one for each sort of history that led there: those that came
    from the other mode in this step are one more, and the most alike are merged. Pairs go through this together, as
    many as have ``AT_ONCE`` Gaussians, so that the predicate is interpreted once for all of them.

    Args:
        held: the pairs before; ``p`` and ``counts`` are those after the step then.
        objects, law, looks: see there.
        switched: out.
        out: (H + 2 P, WIDTH) out: the Gaussians after the step.

    Returns:
        How many rows of ``out`` there are.
    """
    first, second, p, counts, states = held.first, held.second, held.p, held.counts, held.states
    seen, known, mean, cov = objects.seen, objects.known, objects.mean, objects.cov
    chances, limit, share = law.chances, law.limit, looks.share
    before, on, off = switched.before, switched.on, switched.off
    pair, mode = np.empty(AT_ONCE, dtype=np.int64), np.empty(AT_ONCE, dtype=np.int64)
    row, until = np.empty(AT_ONCE, dtype=np.int64), np.empty(AT_ONCE, dtype=np.int64)
    f, stack = np.empty((TURN + 1, AT_ONCE)), np.empty((max(len(law.ops), 1), AT_ONCE))
    f[MISFIT], f[PRECISION] = 0.0, 1.0
    one, inverse = np.empty(WIDTH), np.empty(MOST + 1)
    returns = chances[0, 0] > SURE, min(chances[0, 1], chances[1, 1]) > SURE
    looked = looks.table.size > 0
    lo = at = to = 0
    while lo < len(first):
        hi, many = lo, 0
        while hi < len(first) and many + counts[hi, 0] + counts[hi, 1] <= AT_ONCE:
            for h in range(counts[hi, 0] + counts[hi, 1]):
                pair[many], row[many], mode[many] = hi, at, 1 if h >= counts[hi, 0] else 0
                f[WEIGHT, many] = states[at, 7]
                many += 1
                at += 1
            hi += 1
        _move_and_see(many, pair, mode, row, held, objects, law.motions, f)
        for h in range(many):
            a, b = first[pair[h]], second[pair[h]]
            f[6, h], f[7, h], f[8, h], f[9, h] = mean[a, 1, 0], mean[a, 1, 1], mean[b, 1, 0], mean[b, 1, 1]
            f[10, h], f[11, h], f[12, h] = cov[a, 2], cov[b, 2], 1.0
            if looked and mode[h] == 1 and seen[a] and seen[b]:
                f[MISFIT, h] -= share[pair[h]] * log_ratio(
                    f[0, h], f[1, h], f[2, h], f[3, h], f[6, h], f[7, h], f[8, h], f[9, h], looks
                )  # fmt: skip
        if len(law.ops) > 0:
            evaluate(law.ops, law.numbers, many, f, until, stack)
        else:
            stack[0, :many] = 1.0
        start = 0
        for i in range(lo, hi):
            a, b = first[i], second[i]
            middle, end = start + counts[i, 0], start + counts[i, 0] + counts[i, 1]
            if end > start + 1 and seen[a] and seen[b]:
                _weigh(start, end, f)
            sure = known[a] and known[b]
            none = some = turned_on = turned_off = 0.0
            for h in range(start, end):
                f[TURN, h] = _chance(mode[h], stack[0, h], sure, chances)
                if h < middle:
                    none += f[WEIGHT, h]
                    turned_on += f[WEIGHT, h] * f[TURN, h]
                else:
                    some += f[WEIGHT, h]
                    turned_off += f[WEIGHT, h] * f[TURN, h]
            before[i] = min(max(some / (none + some), FLOOR), 1.0 - FLOOR)
            # a mode without a Gaussian switches as the other would
            on[i] = turned_on / none if none > 0.0 else _chance(0, stack[0, start], sure, chances)
            off[i] = turned_off / some if some > 0.0 else _chance(1, stack[0, start], sure, chances)
            if end == start + 1 and turned_on + turned_off < SURE:
                _row(start, f, 1.0, out[to])
                p[i] = 1.0 - FLOOR if counts[i, 1] else FLOOR
                to += 1
            else:
                off_many, none = _mode(start, middle, middle, end, f, limit, out, to, one, inverse)
                on_many, some = _mode(middle, end, start, middle, f, limit, out, to + off_many, one, inverse)
                if some < SURE and returns[0]:
                    on_many, some = 0, 0.0
                elif none < SURE and returns[1]:
                    for k in range(on_many):
                        copy(out[to + off_many + k], out[to + k])
                    off_many, none = 0, 0.0
                scale = 1.0 / (none + some)
                for _ in range(off_many + on_many):
                    out[to, 7] *= scale
                    to += 1
                counts[i, 0], counts[i, 1] = off_many, on_many
                p[i] = min(max(some / (none + some), FLOOR), 1.0 - FLOOR)
            start = end
        lo = hi
    return to


@kernel
def hidden(held, unseen, objects, spread, weight, out_mean, out_cov):
    """Where related objects that are seen put a hidden one: weighted sums over its pairs, into the outputs.

    Args:
        held: the pairs.
        unseen: (n,) whether an object is hidden.
        objects, spread: (n, 2, 2), (n, 3) the objects' own filters.
        weight: (n, 2) out: sum of the probabilities of relations to seen objects; log probability that none holds.
        out_mean, out_cov: (n, 2, 2), (n, 2, 2) out: sums of mean, and of second moments averaged over the axes.
    """
    at, counts, states = 0, held.counts, held.states
    for i in range(len(held.first)):
        a, b = held.first[i], held.second[i]
        start, at = at + counts[i, 0], at + counts[i, 0] + counts[i, 1]
        if unseen[a] == unseen[b]:
            continue
        h, o, sign = (b, a, 1.0) if unseen[b] else (a, b, -1.0)
        if at > start:
            weight[h, 1] += math.log1p(-held.p[i])
        for j in range(start, at):
            w = states[j, 7]
            weight[h, 0] += w
            pp = pv = vv = 0.0
            for k in range(2):
                x = objects[o, 0, k] + sign * states[j, k]
                v = objects[o, 1, k] + sign * states[j, 2 + k]
                out_mean[h, 0, k] += w * x
                out_mean[h, 1, k] += w * v
                # about the hidden object's own estimate, so that large coordinates cost no digits
                x -= objects[h, 0, k]
                v -= objects[h, 1, k]
                pp += x * x
                pv += x * v
                vv += v * v
            out_cov[h, 0, 0] += w * (0.5 * pp + spread[o, 0] + states[j, 4])
            out_cov[h, 0, 1] += w * (0.5 * pv + spread[o, 1] + states[j, 5])
            out_cov[h, 1, 1] += w * (0.5 * vv + spread[o, 2] + states[j, 6])
