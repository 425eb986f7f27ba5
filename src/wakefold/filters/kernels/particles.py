"""Resampling and weights of particles, and class masses over the part of the tree that holds particles.

Notation as in docs/algorithm.md. N particles, d coordinates, A nodes (the classes in use with a particle below them,
children before parents: leaves first, then inner classes by rising birth), S copies (particles of coarse sets, grouped
by node).
"""

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.base.random import uniforms

LOG, GAUSSIAN, STUDENT = 0, 1, 2


@inner
def _peak(values):
    """The largest value; ``values.max()`` would take a second to compile."""
    peak = -np.inf
    for i in range(len(values)):
        peak = max(peak, values[i])
    return peak


@kernel
def pick(log_weights, positions, out):
    """Index of the particle at each of the sorted ``positions`` in [0, 1) of the cumulated weights, into ``out``."""
    peak, total = _peak(log_weights), 0.0
    weights = np.empty(len(log_weights))
    for i in range(len(log_weights)):
        weights[i] = math.exp(log_weights[i] - peak)
        total += weights[i]
    i, last, reached = 0, len(log_weights) - 1, weights[0]
    for n in range(len(positions)):
        while reached <= positions[n] * total and i < last:  # i < last: rounding may leave the sum just short
            i += 1
            reached += weights[i]
        out[n] = i


@kernel
def pick_strata(log_weights, u, out):
    """``pick`` at one position in each of len(out) equal strata; ``u`` is one uniform for all, or one for each."""
    count = len(out)
    positions = np.empty(count)
    for n in range(count):
        positions[n] = (n + u[n % len(u)]) / count
    pick(log_weights, positions, out)


@kernel
def opened(key, step, purpose, log_weights, points, classes, kept, first, changed, leaves):
    """The particles that survive resampling, ``changed`` of them with a class drawn uniformly from the leaves.

    Args:
        kept: (N,) the particles that survive, or none to pick them here, one in each of N strata.
        first: how many uniforms the resampling takes from the stream: N or, systematic, 1.

    Returns:
        points (N, d) and classes (N,), both new. The changed ones are spread evenly; they keep their positions.
    """
    count, d = points.shape
    u = np.empty(first + 1 + changed)
    uniforms(key, step, purpose, u)
    if len(kept) == 0:
        kept = np.empty(count, dtype=np.int64)
        pick_strata(log_weights, u[:first], kept)
    new_points, new_classes = np.empty((count, d)), np.empty(count, dtype=np.int64)
    for i in range(count):
        for k in range(d):
            new_points[i, k] = points[kept[i], k]
        new_classes[i] = classes[kept[i]]
    for i in range(changed):
        new_classes[int((i + u[first]) * (count / changed))] = int(u[first + 1 + i] * leaves)
    return new_points, new_classes


@kernel
def layout(classes, log_weights, up, size):
    """The classes in use that hold particles, their masses, and the copies each of them needs.

    Args:
        classes: (N,) leaf class of each particle.
        log_weights: (N,).
        up: (C,) nearest ancestor in use of each class, -1 above the last.
        size: C.

    Returns:
        nodes (A,) class ids in rising order; parent (A,) index into nodes or -1; leaf_of (N,) index into nodes;
        start (A + 1,) first copy of each node (leaves have none); copy_of (S,) particle of each copy; mass (A,).
    """
    count = np.empty(size, dtype=np.int64)
    for c in range(size):
        count[c] = 0
    total = 0
    for i in range(len(classes)):
        c = classes[i]
        while c >= 0:
            count[c] += 1
            total += count[c] == 1
            c = up[c]
    nodes, where = np.empty(total, dtype=np.int64), np.empty(size, dtype=np.int64)
    a = 0
    for c in range(size):
        if count[c] > 0:
            nodes[a], where[c] = c, a
            a += 1
    parent, start = np.empty(total, dtype=np.int64), np.empty(total + 1, dtype=np.int64)
    start[0] = 0
    for a in range(total):
        above = up[nodes[a]]
        parent[a] = where[above] if above >= 0 else -1
        start[a + 1] = count[nodes[a]]
    leaf_of = np.empty(len(classes), dtype=np.int64)
    for i in range(len(classes)):
        leaf_of[i] = where[classes[i]]
        start[leaf_of[i] + 1] = 0
    cursor = np.empty(total, dtype=np.int64)
    for a in range(total):
        start[a + 1] += start[a]
        cursor[a] = start[a]
    copy_of = np.empty(start[total], dtype=np.int64)
    for i in range(len(classes)):
        a = parent[leaf_of[i]]
        while a >= 0:
            copy_of[cursor[a]] = i
            cursor[a] += 1
            a = parent[a]
    return nodes, parent, leaf_of, start, copy_of, _node_masses(log_weights, leaf_of, parent)


@kernel
def log_likelihood(points, fix, family, scale, dof, out):
    """Log-likelihood of a fix (d,) at each of the points (n, d), into ``out`` (n,); returns the smallest distance.

    ``scale`` is the sd of a Gaussian or Student density, or the diagonal for the papers' -log weight.
    """
    n, d = points.shape
    if family == GAUSSIAN:
        constant = -d * (0.5 * math.log(2.0 * math.pi) + math.log(scale))
    else:
        constant = (
            math.lgamma(0.5 * (dof + d))
            - math.lgamma(0.5 * dof)
            - 0.5 * d * math.log(dof * math.pi)
            - d * math.log(scale)
        )
    closest = np.inf
    for i in range(n):
        distance2 = 0.0
        for k in range(d):
            gap = (points[i, k] - fix[k]) / scale  # scaled first: no overflow short of 1e154 scales
            distance2 += gap * gap
        closest = min(closest, distance2)
        if family == LOG:
            out[i] = math.log(-math.log(min(max(math.sqrt(distance2), 1e-4), 1.0)))
        elif family == GAUSSIAN:
            out[i] = constant - 0.5 * distance2
        else:
            out[i] = constant - 0.5 * (dof + d) * math.log1p(distance2 / dof)
    return math.sqrt(closest) * scale


@kernel
def log_sum(log_weights):
    """log of the sum of exp(log_weights); -inf when all are -inf."""
    peak = _peak(log_weights)
    if peak == -np.inf:
        return peak
    total = 0.0
    for i in range(len(log_weights)):
        total += math.exp(log_weights[i] - peak)
    return peak + math.log(total)


@inner
def _multiply(log_weights, log_factors, keep):
    """log(sum of products / sum of weights); the weights become the products, normalised.

    They stay as they are when told to ``keep`` them or when every product is zero (the result is -inf then).
    """
    before, peak, total = log_sum(log_weights), -np.inf, 0.0
    for i in range(len(log_weights)):
        peak = max(peak, log_weights[i] + log_factors[i])
    if peak == -np.inf:
        return peak
    for i in range(len(log_weights)):
        total += math.exp(log_weights[i] + log_factors[i] - peak)
    after = peak + math.log(total)
    for i in range(len(log_weights)):
        if not keep:
            log_weights[i] += log_factors[i] - after
    return after - before


@kernel
def multiply(log_weights, log_factors):
    """Multiply weights by factors and normalise, in place; returns log(sum of products / sum of weights).

    When every product is zero nothing is changed and the result is -inf.
    """
    return _multiply(log_weights, log_factors, False)


@kernel
def weigh(points, fix, family, scale, dof, limit, log_weights):
    """``multiply`` by the likelihood of a fix; weights stay as they are when no point (n, d) is within the limit of it.

    Returns:
        log(sum of products / sum of weights), and whether the weights have become the products.
    """
    log_factors = np.empty(len(points))
    lost = log_likelihood(points, fix, family, scale, dof, log_factors) > limit
    gain = _multiply(log_weights, log_factors, lost)
    return gain, not lost and gain > -np.inf


@kernel
def normalise(log_weights):
    """Divide weights by their sum, in place."""
    total = log_sum(log_weights)
    for i in range(len(log_weights)):
        log_weights[i] -= total


@inner
def _node_masses(log_weights, leaf_of, parent):
    """Mass of every node: leaves sum the weights of their particles, parents sum their children."""
    mass = np.empty(len(parent))
    for a in range(len(parent)):
        mass[a] = 0.0
    for i in range(len(log_weights)):
        mass[leaf_of[i]] += math.exp(log_weights[i])
    return _sum_up(mass, parent)


@inner
def _sum_up(mass, parent):
    for a in range(len(mass)):
        if parent[a] >= 0:
            mass[parent[a]] += mass[a]
    return mass


@inner
def _log_ratio(new, old):
    """log(new / old) with 0/0 = 0."""
    return math.log(new / old) if new > 0.0 and old > 0.0 else -np.inf


@kernel
def spread_fix(log_weights, leaf_of, parent, start, prior, factors, also_observed):
    """Rebuild the tree after a fix on the base set and multiply the other sets (docs/algorithm.md, step 4).

    Args:
        log_weights: (N,) of the base set, already multiplied and normalised; multiplied by r when ``also_observed``.
        prior: (A,) masses before; becomes the masses after.
        factors: (A,) log-multiplier of each node's coarse set, changed in place.
    """
    new = _node_masses(log_weights, leaf_of, parent)
    for a in range(len(parent)):
        ratio = _log_ratio(new[a], prior[a])
        factors[a] = factors[a] + ratio if start[a + 1] > start[a] else ratio  # a leaf has no coarse set: only r
    if also_observed:
        for i in range(len(log_weights)):
            log_weights[i] += factors[leaf_of[i]]
    for a in range(len(parent)):
        prior[a] = new[a]


@kernel
def spread_coarse(log_weights, leaf_of, parent, start, base_mass, prior, factors, observed, log_g, also_observed):
    """Coarse evidence on the nodes alive at its level, then the rebuild (docs/algorithm.md, step 4).

    Args:
        log_weights: (N,) of the base set, changed in place.
        base_mass: (A,) mass each node's coarse set was copied with.
        prior: (A,) masses before; becomes the masses after.
        factors: (A,) log-multiplier of each node's coarse set, changed in place.
        observed: (A,) for leaves the node of the observed level above (or at) them, -1 for other nodes.
        log_g: (A,) log-likelihood of the evidence for each observed node.

    Returns:
        log(sum of products / sum of weights) over the observed sets; -inf (and nothing changed) when all are zero.
    """
    total = len(parent)
    weight, new = np.empty(total), np.empty(total)  # weight of the observed sets, before the evidence; -1 of others
    for a in range(total):
        weight[a] = -1.0
        new[a] = 0.0
    for a in range(total):
        if observed[a] >= 0:
            weight[observed[a]] = 0.0
    for i in range(len(log_weights)):
        leaf = leaf_of[i]
        if observed[leaf] == leaf:
            weight[leaf] += math.exp(log_weights[i])
    before = after = 0.0
    for a in range(total):
        if weight[a] >= 0.0:
            if start[a + 1] > start[a]:
                weight[a] = base_mass[a] * math.exp(factors[a])
            before += weight[a]
            weight[a] *= math.exp(log_g[a])
            after += weight[a]
    if not after > 0.0:
        return -np.inf
    for a in range(total):
        o = observed[a]
        if o >= 0 and prior[o] > 0.0:
            new[a] = prior[a] * (weight[o] / after / prior[o])
    _sum_up(new, parent)
    for a in range(total):
        ratio = _log_ratio(new[a], prior[a])
        update = log_g[a] - math.log(after) if weight[a] >= 0.0 else ratio
        if weight[a] >= 0.0 and also_observed:
            update += ratio
        prior[a] = new[a]
        factors[a] = factors[a] + update if start[a + 1] > start[a] else update
    for i in range(len(log_weights)):
        log_weights[i] += factors[leaf_of[i]]
    return math.log(after) - math.log(before)


@kernel
def nearest_used(parent, used):
    """(C,) the nearest ancestor in use of each class, -1 above the last; parents come after their children."""
    up = np.empty(len(parent), dtype=np.int64)
    for c in range(len(parent) - 1, -1, -1):
        above = parent[c]
        up[c] = above if above < 0 or used[above] else up[above]
    return up


@kernel
def alive_above(nodes, parent, start, death, level):
    """(A,) for leaves the node alive at the level above (or at) them, -1 for other nodes."""
    out = np.empty(len(nodes), dtype=np.int64)
    for a in range(len(nodes)):
        out[a] = -1
        if start[a + 1] == start[a]:
            o = a
            while death[nodes[o]] <= level:
                o = parent[o]
            out[a] = o
    return out
