"""One step of the collapsed relational filter: each pair's relation summed out. Motions as in ``objects``."""

import math
from typing import NamedTuple

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.base.types import Bools, Floats, Ints
from wakefold.relations.kernels.histories import MOST, WIDTH, absorb, copy, reduce
from wakefold.relations.kernels.looks import log_ratio
from wakefold.relations.kernels.predicates import (
    asks_own,
    blend,
    chance_of,
    depth_of,
    evaluate,
    own_of,
    reach_of,
    shift_of,
)
from wakefold.relations.kernels.regions import FAR

FLOOR = 1e-9  # a relation is never surer than this
SURE = 1e-5  # a mode less probable is let go, if more than that can come back in a step
LEFT = 0.05  # share of a Gaussian that is left at least, for it to be told what others are not


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
        told: whether motion or looks depend on the relation. If not, the unrelated Gaussian is that of all histories.
    """

    motions: Floats
    chances: Floats
    ops: Ints
    numbers: Floats
    limit: int
    told: bool


class Switches(NamedTuple):
    """Of P pairs: probability before the switch, and of switching on and off; (P,) each."""

    before: Floats
    on: Floats
    off: Floats


@inner
def _move(states, at, motions, mode, to, h):
    """The Gaussian of a pair in row ``at`` moved as in ``mode``, to row ``h``; its probability stays."""
    f00, f01, f10, f11 = motions[mode, 0], motions[mode, 1], motions[mode, 2], motions[mode, 3]
    ux, uy, wx, wy = states[at, 0], states[at, 1], states[at, 2], states[at, 3]
    pp, pv, vv = states[at, 4], states[at, 5], states[at, 6]
    to[h, 0], to[h, 1] = f00 * ux + f01 * wx, f00 * uy + f01 * wy
    to[h, 2], to[h, 3] = f10 * ux + f11 * wx, f10 * uy + f11 * wy
    to[h, 4] = f00 * f00 * pp + 2.0 * f00 * f01 * pv + f01 * f01 * vv + motions[mode, 4]
    to[h, 5] = f00 * f10 * pp + (f00 * f11 + f01 * f10) * pv + f01 * f11 * vv + motions[mode, 5]
    to[h, 6] = f10 * f10 * pp + 2.0 * f10 * f11 * pv + f11 * f11 * vv + motions[mode, 6]
    to[h, 7] = states[at, 7]


@inner
def _see(rows, h, a, b, z, variance):
    """The Gaussian of a pair in row ``h`` given where both are; half the squared innovation, one over its variance."""
    ex, ey = z[b, 0] - z[a, 0] - rows[h, 0], z[b, 1] - z[a, 1] - rows[h, 1]
    pp, pv = rows[h, 4], rows[h, 5]
    s = 1.0 / (pp + (variance[a] + variance[b]))
    g0, g1 = pp * s, pv * s
    rows[h, 0] += g0 * ex
    rows[h, 1] += g0 * ey
    rows[h, 2] += g1 * ex
    rows[h, 3] += g1 * ey
    rows[h, 4], rows[h, 5], rows[h, 6] = (1.0 - g0) * pp, (1.0 - g0) * pv, rows[h, 6] - g1 * pv
    return 0.5 * s * (ex * ex + ey * ey), s


@inner
def _weigh(many, f, told, misfit, precision):
    """Probabilities of the Gaussians of a pair given what was seen, in place."""
    best = 0
    if told:
        for h in range(1, many):
            if misfit[h] < misfit[best]:
                best = h
    total = 0.0
    for h in range(many):
        fits = precision[h] if h == best else precision[h] * math.exp(min(misfit[best] - misfit[h], 50.0))
        f[h, 7] = f[h, 7] * fits if told or h > 0 else fits
        total += f[h, 7]
    if not told:  # as shares of the Gaussian of all histories
        whole, related = f[0, 7], total - f[0, 7]
        f[0, 7], total = max(whole - related, 0.0), max(whole, related)
    total = 1.0 / total
    for h in range(many):
        f[h, 7] = max(f[h, 7] * total, FLOOR)


@inner
def _rest(many, f, inside, yes, one):
    """Given the predicate, the Gaussian of all histories less those related, into ``one``; its share of all that is."""
    whole = left = yes[0]
    for h in range(1, many):
        left -= f[h, 7] * yes[h]
    for k in range(7):
        one[k] = inside[0, k]
    if left <= LEFT * whole:
        return max(left, 0.0)
    d0 = d1 = d2 = d3 = 0.0
    pp, pv, vv = whole * one[4], whole * one[5], whole * one[6]
    for h in range(1, many):
        w, row = f[h, 7] * yes[h], inside[h]
        e0, e1, e2, e3 = row[0] - one[0], row[1] - one[1], row[2] - one[2], row[3] - one[3]
        d0 -= w * e0
        d1 -= w * e1
        d2 -= w * e2
        d3 -= w * e3
        pp -= w * (row[4] + 0.5 * (e0 * e0 + e1 * e1))
        pv -= w * (row[5] + 0.5 * (e0 * e2 + e1 * e3))
        vv -= w * (row[6] + 0.5 * (e2 * e2 + e3 * e3))
    d0, d1, d2, d3 = d0 / left, d1 / left, d2 / left, d3 / left
    one[0], one[1], one[2], one[3] = one[0] + d0, one[1] + d1, one[2] + d2, one[3] + d3
    one[4] = max(pp / left - 0.5 * (d0 * d0 + d1 * d1), LEFT * one[4])
    one[6] = max(vv / left - 0.5 * (d2 * d2 + d3 * d3), LEFT * one[6])
    most = 0.999 * math.sqrt(one[4] * one[6])
    one[5] = min(max(pv / left - 0.5 * (d0 * d2 + d1 * d3), -most), most)
    return left


@inner
def _mode(way, stay, come, f, inside, yes, turn, known, law, rows, at, one, inverse):
    """Gaussians of a mode after a switch, into ``rows`` from ``at`` on: those that stayed and, as one, those that came.

    Args:
        way: how a Gaussian leaves the mode: 0 on, 1 off.
        stay, come: the Gaussians from the first to before the second of each were of this mode, and of the other.
        f, inside, yes: Gaussians, these given the predicate, and its probability.
        turn: chance of each to switch.
        one, inverse: to work on.

    Returns:
        How many there are, and their probability.
    """
    many, total = 0, 0.0
    for h in range(stay[0], stay[1]):
        share = f[h, 7] * (1.0 - turn[h])
        if share > 0.0:
            total += share
            blend(f[h], inside[h], shift_of(way, False, yes[h], known, law.chances), rows[at + many])
            rows[at + many, 7] = share
            many += 1
    here = many
    if not law.told and way == 1:
        share = law.chances[0, 0] * _rest(come[1] + stay[1] - stay[0], f, inside, yes, one) if known else 0.0
        if share > FLOOR * max(total, FLOOR):
            copy(one, rows[at + here])
            rows[at + here, 7] = share
            many += 1
    else:
        for h in range(come[0], come[1]):
            share = f[h, 7] * turn[h]
            if share > FLOOR * total:
                to = rows[at + here] if many == here else one
                blend(f[h], inside[h], shift_of(1 - way, True, yes[h], known, law.chances), to)
                to[7] = share
                if many == here:
                    many += 1
                else:
                    absorb(rows[at + here], one)
    if many > here:
        total += rows[at + here, 7]
    return reduce(rows, at, many, law.limit, total, inverse), total


@kernel
def step(held, objects, law, looks, switched, out):
    """Beliefs about P pairs after a step of time and the detections of both objects, in place.

    A pair is a switching linear system of two modes, unrelated (0) and related (1), over its relative state (second
    minus first), in the order of Eq. 1: objects move as they were related before, are seen, and then the relation
    changes as they are now; a switch, and that there was none, tells of the state as far as its chance depends on the
    predicate. Each mode is a few Gaussians, one for each sort of history that led there: those that came from the other
    mode in this step are one more, and the most alike are merged.

    Args:
        held: the pairs before; ``p`` and ``counts`` are those after the step then.
        objects, law, looks: see there.
        switched: out.
        out: (H + 2 P, WIDTH) out: the Gaussians after the step.

    Returns:
        How many rows of ``out`` there are.
    """
    first, second, p, counts, states = held.first, held.second, held.p, held.counts, held.states
    z, variance, seen, known = objects.z, objects.variance, objects.seen, objects.known
    chances, motions, share = law.chances, law.motions, looks.share
    before, on, off = switched.before, switched.on, switched.off
    f, inside, yes, turn = (
        np.empty((2 * MOST, WIDTH)),
        np.empty((2 * MOST, WIDTH)),
        np.empty(2 * MOST),
        np.empty(2 * MOST),
    )
    misfit, precision = np.zeros(2 * MOST), np.ones(2 * MOST)
    one, inverse, own, kept = np.empty(WIDTH), np.empty(MOST + 1), np.zeros(8), np.empty((depth_of(law.ops), WIDTH))
    returns = chances[0, 0] > SURE, min(chances[0, 1], chances[1, 1]) > SURE
    looked = looks.table.size > 0
    asked, reach = looked or asks_own(law.ops), reach_of(law.ops, law.numbers)
    never_on = max(chances[1, 0], chances[2, 0]) < SURE
    at = to = 0
    for i in range(len(first)):
        a, b, middle = first[i], second[i], counts[i, 0]
        many = middle + counts[i, 1]
        both, sure = seen[a] and seen[b], known[a] and known[b]
        if many == 1 and middle == 1 and reach > 0.0 and never_on:  # most pairs of a crowd
            _move(states, at, motions, 0, out, to)
            if both:
                _see(out, to, a, b, z, variance)
            far = math.sqrt(out[to, 0] * out[to, 0] + out[to, 1] * out[to, 1]) - reach
            if far > 0.0 and far * far > FAR * out[to, 4]:
                out[to, 7] = 1.0
                p[i] = before[i] = FLOOR
                on[i], off[i] = chance_of(0, 0.0, sure, chances), chance_of(1, 0.0, sure, chances)
                at += 1
                to += 1
                continue
        if asked:
            own_of(a, b, objects.mean, objects.cov, own)
        for h in range(many):
            _move(states, at, motions, 1 if h >= middle else 0, f, h)
            at += 1
            if both:
                misfit[h], precision[h] = _see(f, h, a, b, z, variance)
                if looked and h >= middle:
                    misfit[h] -= share[i] * log_ratio(
                        f[h, 0], f[h, 1], f[h, 2], f[h, 3], own[0], own[1], own[2], own[3], looks
                    )  # fmt: skip
        if both and many > 1:
            _weigh(many, f, law.told, misfit, precision)
        none = some = turned_on = turned_off = 0.0
        for h in range(many):
            copy(f[h], inside[h])
            yes[h] = evaluate(law.ops, law.numbers, inside[h], own, sure, kept) if len(law.ops) else 1.0
            turn[h] = chance_of(0 if h < middle else 1, yes[h], sure, chances)
            if h < middle:
                none += f[h, 7]
                turned_on += f[h, 7] * turn[h]
            else:
                some += f[h, 7]
                turned_off += f[h, 7] * turn[h]
        if many == 1 and turned_on + turned_off < SURE:
            copy(f[0], out[to])
            out[to, 7] = 1.0
            p[i] = 1.0 - FLOOR if counts[i, 1] else FLOOR
            before[i] = p[i]
            on[i], off[i] = chance_of(0, yes[0], sure, chances), chance_of(1, yes[0], sure, chances)
            to += 1
            continue
        before[i] = min(max(some / (none + some), FLOOR), 1.0 - FLOOR)
        apart, related = (0, middle), (middle, many)
        if law.told:
            off_many, none_after = _mode(0, apart, related, f, inside, yes, turn, sure, law, out, to, one, inverse)
        else:  # the Gaussian of all histories stays as it is
            copy(f[0], out[to])
            off_many, none_after = 1, 0.0
        on_many, some_after = _mode(
            1, related, apart, f, inside, yes, turn, sure, law, out, to + off_many, one, inverse
        )  # fmt: skip
        if not law.told:
            turned_on = min(max(some_after - (some - turned_off), 0.0), none)
            none_after = max(1.0 - some_after, FLOOR)
            out[to, 7] = none_after
        # a mode without a Gaussian switches as the other would
        on[i] = turned_on / none if none > 0.0 else chance_of(0, yes[0], sure, chances)
        off[i] = turned_off / some if some > 0.0 else chance_of(1, yes[0], sure, chances)
        if some_after < SURE and returns[0]:
            on_many, some_after = 0, 0.0
        elif none_after < SURE and returns[1] and law.told:
            for k in range(on_many):
                copy(out[to + off_many + k], out[to + k])
            off_many, none_after = 0, 0.0
        scale = 1.0 / (none_after + some_after)
        for _ in range(off_many + on_many):
            out[to, 7] *= scale
            to += 1
        counts[i, 0], counts[i, 1] = off_many, on_many
        p[i] = min(max(some_after * scale, FLOOR), 1.0 - FLOOR)
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
