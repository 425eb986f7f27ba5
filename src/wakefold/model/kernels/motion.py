"""Motion of particles under the dynamics of their classes; notation as in filters/kernels/particles.py."""

# pyright: reportCallIssue=false
# (numba gives an intrinsic its typing context: it is called with one argument less than it is defined with)

import math

import numpy as np

from wakefold.base.compile import inner, kernel
from wakefold.base.random import normals, uniforms
from wakefold.model.kernels.boxes import WIDTH, bare, hold, nearest, pointer, rows_near, scratch
from wakefold.model.kernels.neighbours import add_rows, mean_velocity, nothing, velocity_at

STILL, GAUSSIAN, UNIFORM = 0, 1, 2  # noise of the motion

# Particles of one cloud lie close together: the rows of a class within reach of one particle, and this share of the
# reach beyond, serve those that follow within that share. A list costs as much as the sums over a single track; of a
# single track, a line, a wider share adds less than of an area.
SHARE, SHARE_OF_TRACK = 0.125, 0.25


_NONE = np.empty(0, dtype=np.int64)
ALONE = (_NONE, _NONE, _NONE)  # ``roll`` without copies


@inner
def _within(p, q, reach2, dims):
    """Whether two positions are less than sqrt(reach2) apart."""
    total = 0.0
    for k in range(len(dims)):
        total += (p[k] - q[k]) ** 2
    return total < reach2


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


@kernel
def drifts(points, classes, up, out, ground):
    """Localised velocity at points under their own classes, and under those above, into ``out``.

    The inverse-distance mean of the velocities in the open ball of radius sqrt(reach2); of an empty ball, the velocity
    of the nearest point of the class (docs/algorithm.md, Dynamics; Hawasly et al. 2016, Section 3.1).

    The classes above one are nested intervals of ranks. Going outwards, each class adds two ranges of the rows near q
    to the sums of the one inside it, so every neighbour is looked at once and serves all the classes that hold it.

    Args:
        points: (n, d). classes: (n,) of each.
        up: (C,) the class above each that counts, -1 for none; or empty, when none counts anywhere.
        out: (rows, d): for each point its class, then those above it, from the inside outwards.
    """
    lo, hi, reach2, floor2, dims = ground.lo, ground.hi, ground.reach2, ground.floor2, ground.dims
    d, field, room = len(dims), bare(ground.field), scratch(ground.field.leaf_at)
    lists, spare = pointer(room, 0), pointer(room, len(room) // 2)
    rows, count, listed, centre = lists, 0, -1, pointer(points, 0)  # the rows near ``centre`` of the class ``listed``
    at = pointer(out, 0)
    for i in range(len(points)):
        c, q = classes[i], pointer(points, i * d)
        top, size = c, d  # the outermost class, and how many numbers go to ``out``
        if len(up) > 0:
            while up[top] >= 0:
                top = up[top]
                size += d
        twin = i > 0 and c == classes[i - 1]  # resampling leaves runs of one class in one place
        for k in range(d):
            twin = twin and q[k] == q[k - d]
        if twin:
            for k in range(size):
                at[k] = at[k - size]
            at = pointer(at, size)
            continue
        share = SHARE_OF_TRACK if hi[top] - lo[top] == 1 else SHARE
        if top != listed or not _within(q, centre, reach2 * share**2, dims):
            first, last = field.leaf_at[lo[top]], field.leaf_at[hi[top]]
            rows, count = rows_near(q, first, last, field, reach2 * (1.0 + share) ** 2, lists, dims)
            listed, centre = top, q
        sums = nothing(dims)
        first = last = field.leaf_at[lo[c]]
        best2, best = np.inf, first * 2 * d * WIDTH  # nearest point so far; wanted only while the ball is empty
        left = right = np.intp(0) if c == top else _first_from(rows, count, first)  # rows[left:right] are summed
        while c >= 0:
            outer_first, outer_last = field.leaf_at[lo[c]], field.leaf_at[hi[c]]
            outer_left, outer_right = left, right
            if c == top:
                outer_left, outer_right = 0, count
            else:
                while outer_left > 0 and rows[outer_left - 1] >= outer_first:
                    outer_left -= 1
                while outer_right < count and rows[outer_right] < outer_last:
                    outer_right += 1
            if outer_left < left:  # often nothing is added on one side
                sums = add_rows(q, rows, outer_left, left, field, reach2, floor2, sums, dims)
            if right < outer_right:
                sums = add_rows(q, rows, right, outer_right, field, reach2, floor2, sums, dims)
            if not mean_velocity(sums, at, dims):
                best2, best = nearest(q, outer_first, first, field, best2, best, spare, dims)
                best2, best = nearest(q, last, outer_last, field, best2, best, spare, dims)
                velocity_at(field, best, at, dims)
            first, last, left, right = outer_first, outer_last, outer_left, outer_right
            at = pointer(at, d)
            c = up[c] if len(up) > 0 else -1
    hold(room)


@kernel
def roll(points, classes, copies, out, stream, noise_law, span, ground):
    """Move points (n, d) under their own classes (n,); ``out`` is points. Or write where copies of them go.

    Small groups are plain tuples: each named one costs a call half a microsecond.

    Args:
        copies: up (see ``drifts``), nodes, start. When ``up`` is not empty, the first sub-step takes copies of the
            points, each under another class above that of its point, to ``out`` (S, d), grouped by class: those of
            ``nodes[a]`` from ``start[a]`` on.
        stream: key, step, purpose of the random numbers.
        noise_law: kind and scale: ``GAUSSIAN`` with sd scale * sqrt(h) metres in each sub-step, or the papers'
            ``UNIFORM`` within +-scale metres once, in the last.
        span: from which sub-step on, of how many, and the length h of each, s.
    """
    (up, nodes, start), (key, step, purpose) = copies, stream
    (kind, scale), (begin, parts, h), dims = noise_law, span, ground.dims
    d, size, copied = len(dims), len(out) * len(dims), len(up) > 0
    noise = np.empty(parts * size)
    if kind == GAUSSIAN:
        normals(key, step, purpose, noise)
        sd = scale * math.sqrt(h)
        for i in range(len(noise)):
            noise[i] *= sd
    else:
        for i in range(len(noise)):
            noise[i] = 0.0
        if kind == UNIFORM and parts > 0:
            last = noise[len(noise) - size :]
            uniforms(key, step, purpose, last)
            for i in range(size):
                last[i] = scale * (2.0 * last[i] - 1.0)
    drift = np.empty((len(points) + (len(out) if copied else 0), d))
    cursor = np.empty(len(up), dtype=np.int64)
    for a in range(len(nodes)):
        cursor[nodes[a]] = start[a]
    for part in range(begin, 1 if copied else parts):
        drifts(points, classes, up, drift, ground)
        row = 0
        for i in range(len(points)):
            if not copied:
                for k in range(d):
                    points[i, k] += h * drift[i, k] + noise[part * size + i * d + k]
                continue
            c, row = up[classes[i]], row + 1
            while c >= 0:
                s = cursor[c]
                for k in range(d):
                    out[s, k] = points[i, k] + (h * drift[row, k] + noise[s * d + k])
                cursor[c], c, row = s + 1, up[c], row + 1
