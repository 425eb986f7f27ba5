"""Points of a class near a position: a tree of bounding boxes over the points in leaf order.

The points lie in leaf order (rank), time inside a leaf, so a class is a contiguous slice and so are its boxes. Blocks
of ``BLOCK`` points of one leaf, the last of a leaf filled up with points at infinity, are the lowest boxes; each level
above joins ``FAN`` boxes of the one below. A walk along a range of blocks skips the largest aligned box out of reach:
no stack, no hashing, no second index. A block is summed in SIMD lanes, row by row: d positions, d velocities.

``dims`` is a tuple of d zeros: its length is known when the kernel is compiled, so the loops over coordinates unroll.
"""

# pyright: reportCallIssue=false
# (numba gives an intrinsic its typing context: it is called with one argument less than it is defined with)

import math
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from wakefold.kernels.simd import LANES, Vector

WIDTH = LANES["float64"]
BLOCK = 2 * WIDTH
SHIFT = 2
FAN = 1 << SHIFT
_VECTOR = Vector(types.float64)


class Field(NamedTuple):
    """Points and velocities in leaf order, and the boxes over them."""

    data: np.ndarray  # (rows * 2 d * WIDTH,): in each row d positions, then d velocities, of WIDTH points
    leaf_at: np.ndarray  # (M + 1,) first block of each leaf rank
    boxes: np.ndarray  # (boxes of all levels, 2 d): lower corner, upper corner
    level_at: np.ndarray  # (levels + 1,) first box of each level


def field(points, velocities, starts):
    """The field of points (P, d) and velocities (P, d) in leaf order; leaf r owns ``starts[r]:starts[r + 1]``."""
    d = points.shape[1]
    lengths = np.diff(starts)
    blocks = -(-lengths // BLOCK)
    leaf_at = np.concatenate([[0], np.cumsum(blocks)])
    rows = np.zeros((leaf_at[-1] * BLOCK, 2 * d))
    rows[:, :d] = np.inf
    at = np.arange(len(points)) + np.repeat(leaf_at[:-1] * BLOCK - starts[:-1], lengths)
    rows[at, :d], rows[at, d:] = points, velocities
    sizes = [int(leaf_at[-1])]
    while sizes[-1] > 1:
        sizes.append(-(-sizes[-1] // FAN))
    level_at = np.concatenate([[0], np.cumsum(sizes)])
    first = np.repeat(starts[:-1], blocks) + BLOCK * (np.arange(leaf_at[-1]) - np.repeat(leaf_at[:-1], blocks))
    low, high = [np.minimum.reduceat(points, first)], [np.maximum.reduceat(points, first)]
    for size in sizes[1:]:
        below = np.arange(size) * FAN
        low.append(np.minimum.reduceat(low[-1], below))
        high.append(np.maximum.reduceat(high[-1], below))
    boxes = np.hstack([np.concatenate(low), np.concatenate(high)])
    data = np.ascontiguousarray(rows.reshape(-1, WIDTH, 2 * d).transpose(0, 2, 1)).reshape(-1)
    return Field(data, leaf_at, boxes, level_at)


# Sums in SIMD lanes


def _all(value):
    return ir.Constant(ir.VectorType(ir.DoubleType(), WIDTH), [value] * WIDTH)


def _spread(builder, value):
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    one = builder.insert_element(_all(ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, _all(ir.Undefined), lanes)


@intrinsic
def nothing(typing, dims):
    """Sums of no points: d + 1 vectors of zeros."""
    result = types.UniTuple(_VECTOR, len(dims) + 1)

    def generate(context, builder, signature, arguments):
        return context.make_tuple(builder, result, [_all(0.0)] * (len(dims) + 1))

    return result(dims), generate


@intrinsic
def _add_row(typing, data, row, q, reach2, floor2, sums, dims):
    """Add the points of a row strictly nearer to q than the reach to ``sums``: 1/distance, velocity/distance."""
    d = len(dims)

    def generate(context, builder, signature, arguments):
        flat = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = context.make_array(signature.args[2])(context, builder, arguments[2]).data
        kind = context.get_data_type(_VECTOR)
        word = arguments[1].type
        first = builder.mul(arguments[1], ir.Constant(word, 2 * d * WIDTH))

        def part(k):
            pointer = builder.gep(flat, [builder.add(first, ir.Constant(word, k * WIDTH))])
            return builder.load(builder.bitcast(pointer, kind.as_pointer()), align=8)

        distance2 = None
        for k in range(d):
            gap = builder.fsub(part(k), _spread(builder, builder.load(builder.gep(place, [ir.Constant(word, k)]))))
            square = builder.fmul(gap, gap)
            distance2 = square if distance2 is None else builder.fadd(distance2, square)
        inside = builder.fcmp_ordered("<", distance2, _spread(builder, arguments[3]))
        floor = _spread(builder, arguments[4])
        apart = builder.select(builder.fcmp_ordered(">", distance2, floor), distance2, floor)
        root = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.v{WIDTH}f64")
        weight = builder.fdiv(_all(1.0), builder.call(root, [apart]))
        weight = builder.select(inside, weight, _all(0.0))
        out = [builder.fadd(builder.extract_value(arguments[5], 0), weight)]
        for k in range(d):
            carried = builder.fmul(weight, part(d + k), flags=("contract",))
            out.append(builder.fadd(builder.extract_value(arguments[5], 1 + k), carried, flags=("contract",)))
        return context.make_tuple(builder, signature.return_type, out)

    return sums(data, types.intp, q, types.float64, types.float64, sums, dims), generate


@intrinsic
def _total(typing, vector):
    """Sum of the lanes of a vector."""

    def generate(context, builder, signature, arguments):
        lanes = [builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), k)) for k in range(WIDTH)]
        while len(lanes) > 1:
            lanes = [builder.fadd(a, b) for a, b in zip(lanes[::2], lanes[1::2], strict=True)]
        return lanes[0]

    return types.float64(vector), generate


# The walk along the boxes


@njit(cache=True, nogil=True)
def _far(q, boxes, box, reach2, dims):
    """Whether a box lies at least sqrt(reach2) away from q."""
    d = len(dims)
    total = 0.0
    for k in range(d):
        gap = max(max(boxes[box, k] - q[k], q[k] - boxes[box, d + k]), 0.0)
        total += gap * gap
    return total >= reach2


@njit(cache=True, nogil=True)
def _next_block(q, block, last, field, reach2, dims):
    """First block in ``[block, last)`` whose box is within reach of q; ``last`` when there is none."""
    top = len(field.level_at) - 2
    while block < last:
        level = 0  # the largest box that starts here and ends within the range; shifts, as division is slow
        while level < top and (block >> (level * SHIFT)) & (FAN - 1) == 0 and block + (FAN << (level * SHIFT)) <= last:
            level += 1
        while True:
            if _far(q, field.boxes, field.level_at[level] + (block >> (level * SHIFT)), reach2, dims):
                block += 1 << (level * SHIFT)
                break
            if level == 0:
                return block
            level -= 1
    return last


@njit(cache=True, nogil=True)
def add_ball(q, first, last, field, reach2, floor2, sums, dims):
    """``sums`` plus the points of blocks ``[first, last)`` strictly nearer to q than sqrt(reach2).

    ``sums`` are d + 1 vectors, of 1/distance and of velocity/distance; distances are floored at sqrt(floor2).
    """
    block = _next_block(q, first, last, field, reach2, dims)
    while block < last:
        for row in range(block * (BLOCK // WIDTH), (block + 1) * (BLOCK // WIDTH)):
            sums = _add_row(field.data, row, q, reach2, floor2, sums, dims)
        block = _next_block(q, block + 1, last, field, reach2, dims)
    return sums


@njit(cache=True, nogil=True)
def nearest(q, first, last, field, best2, best, dims):
    """Nearest point to q in blocks ``[first, last)``, given the best so far (squared distance, place in the data)."""
    d = len(dims)
    block = _next_block(q, first, last, field, best2, dims)
    while block < last:
        for p in range(BLOCK):
            place = (block * (BLOCK // WIDTH) + p // WIDTH) * 2 * d * WIDTH + p % WIDTH
            dist2 = 0.0
            for k in range(d):
                gap = field.data[place + k * WIDTH] - q[k]
                dist2 += gap * gap
            if dist2 < best2:
                best2, best = dist2, place
        block = _next_block(q, block + 1, last, field, best2, dims)
    return best2, best


@njit(cache=True, nogil=True)
def mean_velocity(sums, out, dims):
    """Inverse-distance mean of the velocities summed up, into ``out`` (d,); False, and nothing done, of no points."""
    weight = _total(sums[0])
    if weight == 0.0:
        return False
    for k in range(len(dims)):
        out[k] = _total(sums[1 + k]) / weight
    return True


@njit(cache=True, nogil=True)
def velocity_at(field, place, out, dims):
    """Velocity of the point that ``nearest`` found, into ``out`` (d,)."""
    for k in range(len(dims)):
        out[k] = field.data[place + (len(dims) + k) * WIDTH]


@njit(cache=True, nogil=True)
def velocity(q, lo, hi, field, reach2, floor2, out, dims):
    """Localised velocity at q of the class with leaf ranks ``[lo, hi)``, into ``out`` (d,).

    The inverse-distance mean of the velocities in the open ball of radius sqrt(reach2); of an empty ball, the velocity
    of the nearest point of the class (docs/algorithm.md, Dynamics; Hawasly et al. 2016, Section 3.1).
    """
    first, last = field.leaf_at[lo], field.leaf_at[hi]
    sums = add_ball(q, first, last, field, reach2, floor2, nothing(dims), dims)
    if not mean_velocity(sums, out, dims):
        _, place = nearest(q, first, last, field, np.inf, first * BLOCK * 2 * len(dims), dims)
        velocity_at(field, place, out, dims)


@njit(cache=True, nogil=True)
def departures(points, velocities, leaf_of, lo, hi, field, reach2, floor2, dims):
    """Velocity of training points minus that of the other leaves, in the ball, of the class ``[lo, hi)`` around theirs.

    Args:
        points, velocities: (n, d). leaf_of, lo, hi: (n,) ranks.

    Returns:
        (n, d); NaN where the ball holds no point of another leaf.
    """
    out = np.empty_like(points)
    for i in range(len(points)):
        leaf, q = leaf_of[i], points[i]
        sums = nothing(dims)
        sums = add_ball(q, field.leaf_at[lo[i]], field.leaf_at[leaf], field, reach2, floor2, sums, dims)
        sums = add_ball(q, field.leaf_at[leaf + 1], field.leaf_at[hi[i]], field, reach2, floor2, sums, dims)
        if mean_velocity(sums, out[i], dims):
            for k in range(len(dims)):
                out[i, k] = velocities[i, k] - out[i, k]
        else:
            out[i] = math.nan
    return out
