"""Motion of particles under the dynamics of their classes; notation as in kernels/particles.py."""

# pyright: reportCallIssue=false
# (numba gives an intrinsic its typing context: it is called with one argument less than it is defined with)

import numpy as np

from wakefold.kernels.boxes import WIDTH, near, nearest, scratch
from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.neighbours import add_rows, mean_velocity, nothing, velocity, velocity_at

# Particles of one cloud lie close together: the rows of a class within reach of one particle, and this share of the
# reach beyond, serve those that follow within that share. A list costs as much as the sums over a single track.
SHARE = 0.125


@inner
def _within(p, q, reach2, dims):
    """Whether two positions are less than sqrt(reach2) apart."""
    total = 0.0
    for k in range(len(dims)):
        total += (p[k] - q[k]) ** 2
    return total < reach2


@kernel
def drifts(points, classes, lo, hi, field, reach2, floor2, out, dims):
    """Localised velocity at each of the points (n, d) under its own class, into ``out`` (n, d)."""
    lists, side, count, listed = scratch(field), 0, 0, -1  # the rows near ``centre`` of the class ``listed``
    centre = np.empty(len(dims))
    share2, wide2 = reach2 * SHARE**2, reach2 * (1.0 + SHARE) ** 2
    for i in range(len(points)):
        twin = i > 0 and classes[i] == classes[i - 1]  # resampling leaves runs of one class in one place
        for k in range(len(dims)):
            twin = twin and points[i, k] == points[i - 1, k]
        if twin:
            for k in range(len(dims)):
                out[i, k] = out[i - 1, k]
            continue
        first, last = field.leaf_at[lo[classes[i]]], field.leaf_at[hi[classes[i]]]
        if classes[i] != listed or not _within(points[i], centre, share2, dims):
            side, count = near(points[i], first, last, field, wide2, lists, dims)
            listed = classes[i]
            for k in range(len(dims)):
                centre[k] = points[i, k]
        velocity(points[i], first, last, lists[side], count, field, reach2, floor2, out[i], dims)


@kernel
def move(points, classes, lo, hi, field, reach2, floor2, noise, h, dims):
    """Move points (n, d) under their own classes through the sub-steps of ``noise`` (sub-steps, n, d), in place.

    ``h`` is the length of a sub-step, s.
    """
    drift = np.empty_like(points)
    for part in range(len(noise)):
        drifts(points, classes, lo, hi, field, reach2, floor2, drift, dims)
        for i in range(len(points)):
            for k in range(len(dims)):
                points[i, k] += h * drift[i, k] + noise[part, i, k]


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


@kernel
def move_nested(
    points, leaf_of, nodes, parent, start, lo, hi, field, reach2, floor2, noise, copy_noise, h, copies, dims
):
    """Move the base particles (N, d) under their leaves, in place, and their copies under every ancestor in use.

    One sub-step of ``h`` seconds: ``noise`` (N, d), ``copy_noise`` (S, d). The copies start where the base particle
    does and come to lie in ``copies`` (S, d), grouped by node as ``start`` tells.
    """
    cursor = start[:-1].copy()
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
        for k in range(len(dims)):
            points[i, k] += h * drift[0, k] + noise[i, k]
        node, place = parent[leaf_of[i]], 1
        while node >= 0:
            s = cursor[node]
            cursor[node] += 1
            for k in range(len(dims)):
                copies[s, k] = q[k] + (h * drift[place, k] + copy_noise[s, k])
            node, place = parent[node], place + 1
