"""Motion of particles under the dynamics of their classes; notation as in kernels/particles.py."""

# pyright: reportCallIssue=false
# (numba gives an intrinsic its typing context: it is called with one argument less than it is defined with)

import math

import numpy as np

from wakefold.kernels.boxes import WIDTH, Field, near, nearest, scratch
from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.neighbours import add_rows, mean_velocity, nothing, velocity, velocity_at
from wakefold.kernels.random import normals, uniforms

STILL, GAUSSIAN, UNIFORM = 0, 1, 2  # noise of the motion

# Particles of one cloud lie close together: the rows of a class within reach of one particle, and this share of the
# reach beyond, serve those that follow within that share. A list costs as much as the sums over a single track; of a
# single track, a line, a wider share adds less than of an area.
SHARE, SHARE_OF_TRACK = 0.125, 0.25


@inner
def _within(p, q, reach2, dims):
    """Whether two positions are less than sqrt(reach2) apart."""
    total = 0.0
    for k in range(len(dims)):
        total += (p[k] - q[k]) ** 2
    return total < reach2


@kernel
def drifts(points, classes, out, lo, hi, field, reach2, floor2, dims):
    """Localised velocity at each of the points (n, d) under its own class, into ``out`` (n, d)."""
    lists, side, count, listed = scratch(field), 0, 0, -1  # the rows near ``centre`` of the class ``listed``
    centre = np.empty(len(dims))
    for i in range(len(points)):
        c = classes[i]
        twin = i > 0 and c == classes[i - 1]  # resampling leaves runs of one class in one place
        for k in range(len(dims)):
            twin = twin and points[i, k] == points[i - 1, k]
        if twin:
            for k in range(len(dims)):
                out[i, k] = out[i - 1, k]
            continue
        first, last = field.leaf_at[lo[c]], field.leaf_at[hi[c]]
        share = SHARE_OF_TRACK if hi[c] - lo[c] == 1 else SHARE
        if c != listed or not _within(points[i], centre, reach2 * share**2, dims):
            side, count = near(points[i], first, last, field, reach2 * (1.0 + share) ** 2, lists, dims)
            listed = c
            for k in range(len(dims)):
                centre[k] = points[i, k]
        velocity(points[i], first, last, lists[side], count, field, reach2, floor2, out[i], dims)


@inner
def _noise(key, step, purpose, kind, scale, h, parts, size):
    """``size`` numbers for each of the sub-steps of ``h`` seconds, one after the other, metres.

    Gaussian noise has sd scale * sqrt(h) in each sub-step; the papers' uniform noise comes once, in the last.
    """
    out = np.empty(parts * size)
    if kind == GAUSSIAN:
        sd = scale * math.sqrt(h)
        normals(key, step, purpose, out)
        for i in range(len(out)):
            out[i] *= sd
        return out
    for i in range(len(out)):
        out[i] = 0.0
    if kind == UNIFORM and parts > 0:
        last = out[len(out) - size :]
        uniforms(key, step, purpose, last)
        for i in range(size):
            last[i] = scale * (2.0 * last[i] - 1.0)
    return out


@inner
def _move(points, classes, noise, h, begin, parts, lo, hi, field, reach2, floor2, dims):
    """Move points (n, d) under their own classes through sub-steps ``begin`` to ``parts`` of the noise, in place."""
    drift = np.empty((len(points), len(dims)))
    for part in range(begin, parts):
        drifts(points, classes, drift, lo, hi, field, reach2, floor2, dims)
        place = part * len(points) * len(dims)
        for i in range(len(points)):
            for k in range(len(dims)):
                points[i, k] += h * drift[i, k] + noise[place + i * len(dims) + k]


@kernel
def roll(
    points, classes, key, step, purpose, kind, scale, parts, h, begin,
    lo, hi, data, leaf_at, boxes, level_at, reach2, floor2, dims,
):  # fmt: skip
    """Move points (n, d) under their own classes through the sub-steps from ``begin`` of ``parts``, in place.

    A sub-step takes ``h`` seconds; the noise is that of the stream (key, step, purpose). From ``lo`` on:
    ``Dynamics.ground`` (a ``Field`` handed over whole would cost 1 µs more).
    """
    field = Field(data, leaf_at, boxes, level_at)
    noise = _noise(key, step, purpose, kind, scale, h, parts, len(points) * len(dims))
    _move(points, classes, noise, h, begin, parts, lo, hi, field, reach2, floor2, dims)


@inner
def _first_from(rows, count, row):
    """How many of the ``count`` rows, in rising order, come before a row; ``np.searchsorted`` compiles for a second."""
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return low


@inner
def _chain(q, node, nodes, parent, lo, hi, rows, count, field, reach2, floor2, out, dims):
    """Localised velocity at q under a leaf node and every ancestor of it in use, into ``out``, from the leaf outwards.

    The classes above a leaf are nested intervals of ranks. Going outwards, each class adds two ranges of the rows near
    q to the sums of the one inside it, so every neighbour is looked at once and serves all the classes that hold it.

    Args:
        rows: ``count`` rows of the outermost class, in rising order, with all of its points in the ball.
    """
    sums = nothing(dims)
    first = last = field.leaf_at[lo[nodes[node]]]
    best2, best = np.inf, first * 2 * len(dims) * WIDTH  # nearest point so far; wanted only while the ball is empty
    left = right = _first_from(rows, count, first)  # the rows near q that are summed: rows[left:right]
    place = 0
    while node >= 0:
        outer_first, outer_last = field.leaf_at[lo[nodes[node]]], field.leaf_at[hi[nodes[node]]]
        outer_left, outer_right = left, right
        while outer_left > 0 and rows[outer_left - 1] >= outer_first:
            outer_left -= 1
        while outer_right < count and rows[outer_right] < outer_last:
            outer_right += 1
        if outer_left < left:  # often nothing is added on one side
            sums = add_rows(q, rows, outer_left, left, field, reach2, floor2, sums, dims)
        if right < outer_right:
            sums = add_rows(q, rows, right, outer_right, field, reach2, floor2, sums, dims)
        if not mean_velocity(sums, out[place], dims):
            best2, best = nearest(q, outer_first, first, field, best2, best, dims)
            best2, best = nearest(q, last, outer_last, field, best2, best, dims)
            velocity_at(field, best, out[place], dims)
        first, last, left, right = outer_first, outer_last, outer_left, outer_right
        place += 1
        node = parent[node]


@inner
def _move_nested(points, leaf_of, nodes, parent, start, noise, h, copies, lo, hi, field, reach2, floor2, dims):
    """Write the copies (S, d) where one sub-step takes them from the points (N, d); ``noise`` is S d numbers."""
    cursor = np.empty(len(nodes), dtype=np.int64)
    for a in range(len(nodes)):
        cursor[a] = start[a]
    drift = np.empty((len(nodes), len(dims)))  # under a particle's leaf and its ancestors, from the leaf outwards
    lists, side, count, listed = scratch(field), 0, 0, -1  # the rows near ``centre`` of the node ``listed``
    share2, wide2 = reach2 * SHARE**2, reach2 * (1.0 + SHARE) ** 2
    q, before, centre = np.empty(len(dims)), np.empty(len(dims)), np.empty(len(dims))
    for i in range(len(points)):
        twin = i > 0 and leaf_of[i] == leaf_of[i - 1]  # resampling leaves runs of one class in one place
        for k in range(len(dims)):
            q[k] = points[i, k]
            twin = twin and q[k] == before[k]
            before[k] = q[k]
        if not twin:
            top = leaf_of[i]
            while parent[top] >= 0:
                top = parent[top]
            if top != listed or not _within(q, centre, share2, dims):
                first, last = field.leaf_at[lo[nodes[top]]], field.leaf_at[hi[nodes[top]]]
                side, count = near(q, first, last, field, wide2, lists, dims)
                listed = top
                for k in range(len(dims)):
                    centre[k] = q[k]
            _chain(q, leaf_of[i], nodes, parent, lo, hi, lists[side], count, field, reach2, floor2, drift, dims)
        node, place = parent[leaf_of[i]], 1
        while node >= 0:
            s = cursor[node]
            cursor[node] += 1
            for k in range(len(dims)):
                copies[s, k] = q[k] + (h * drift[place, k] + noise[s * len(dims) + k])
            node, place = parent[node], place + 1


@kernel
def roll_nested(
    points, leaf_of, nodes, parent, start, copy_of, key, step, purpose, kind, scale, parts, h,
    lo, hi, data, leaf_at, boxes, level_at, reach2, floor2, dims,
):  # fmt: skip
    """Copies (S, d) of the base particles (N, d), grouped by node as ``start`` tells, after the first sub-step.

    A copy starts where its particle does and moves under its own node, an ancestor in use of the particle's leaf. Of no
    sub-steps, it stays there.
    """
    copies = np.empty((len(copy_of), len(dims)))
    if parts == 0:
        for s in range(len(copy_of)):
            for k in range(len(dims)):
                copies[s, k] = points[copy_of[s], k]
        return copies
    field = Field(data, leaf_at, boxes, level_at)
    noise = _noise(key, step, purpose, kind, scale, h, parts, len(copies) * len(dims))
    _move_nested(points, leaf_of, nodes, parent, start, noise, h, copies, lo, hi, field, reach2, floor2, dims)
    return copies
