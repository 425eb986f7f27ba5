"""Localised velocities: inverse-distance means over the points of a class near a position (boxes.py)."""

# pyright: reportCallIssue=false
# (numba gives an intrinsic its typing context: it is called with one argument less than it is defined with)

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from wakefold.base.compile import inner, kernel
from wakefold.model.kernels.boxes import (
    AHEAD,
    WIDTH,
    WORD,
    all_lanes,
    bare,
    coordinates,
    data_of,
    fetch,
    hold,
    pointer,
    rows_near,
    scratch,
    spread,
    sum_of,
    vector_at,
)
from wakefold.model.kernels.simd import Vector

_VECTOR = Vector(types.float64)

# Sums over rows


@intrinsic
def nothing(typing, dims):
    """Sums of no points: d + 1 vectors of zeros."""
    result = types.UniTuple(_VECTOR, len(dims) + 1)

    def generate(context, builder, signature, arguments):
        return context.make_tuple(builder, result, [all_lanes(0.0, WIDTH)] * (len(dims) + 1))

    return result(dims), generate


@intrinsic
def _add_rows(typing, data, row, other, q, reach2, floor2, sums, dims):
    """Add the points of two rows strictly nearer to q than the reach to ``sums``: 1/distance, velocity/distance.

    Square roots and divisions bound the time (9 + 4 cycles for 4 points on Zen 3), so two rows share one division:
    1/a = b / (a b). Distances outside [floor, reach] are moved to its ends, which keeps the product finite.
    """
    d = len(dims)

    def generate(context, builder, signature, arguments):
        flat = data_of(context, builder, signature, arguments, 0)
        place = coordinates(builder, data_of(context, builder, signature, arguments, 3), d, WIDTH)
        reach, floor = spread(builder, arguments[4], WIDTH), spread(builder, arguments[5], WIDTH)
        kind = ir.VectorType(ir.DoubleType(), WIDTH)
        root = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.v{WIDTH}f64")

        def part(row, k):
            first = builder.mul(row, ir.Constant(WORD, 2 * d * WIDTH))
            return vector_at(builder, flat, builder.add(first, ir.Constant(WORD, k * WIDTH)), WIDTH)

        inside, distance = [], []
        for row in arguments[1:3]:
            gaps = [builder.fsub(part(row, k), place[k]) for k in range(d)]
            square = sum_of(builder, [builder.fmul(gap, gap) for gap in gaps])
            inside.append(builder.fcmp_ordered("<", square, reach))
            square = builder.select(builder.fcmp_ordered(">", square, floor), square, floor)
            square = builder.select(builder.fcmp_ordered("<", square, reach), square, reach)
            distance.append(builder.call(root, [square]))
        shared = builder.fdiv(all_lanes(1.0, WIDTH), builder.fmul(*distance))
        out = [builder.extract_value(arguments[6], k) for k in range(d + 1)]
        for row, within, opposite in zip(arguments[1:3], inside, distance[::-1], strict=True):
            weight = builder.select(within, builder.fmul(shared, opposite), all_lanes(0.0, WIDTH))
            out[0] = builder.fadd(out[0], weight)
            for k in range(d):
                carried = builder.fmul(weight, part(row, d + k), flags=("contract",))
                out[1 + k] = builder.fadd(out[1 + k], carried, flags=("contract",))
        return context.make_tuple(builder, signature.return_type, out)

    return sums(data, types.intp, types.intp, q, types.float64, types.float64, sums, dims), generate


@intrinsic
def _total(typing, vector):
    """Sum of the lanes of a vector."""

    def generate(context, builder, signature, arguments):
        lanes = [builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), k)) for k in range(WIDTH)]
        while len(lanes) > 1:
            lanes = [builder.fadd(a, b) for a, b in zip(lanes[::2], lanes[1::2], strict=True)]
        return lanes[0]

    return types.float64(vector), generate


@inner
def add_rows(q, rows, first, last, field, reach2, floor2, sums, dims):
    """``sums`` plus the points of ``rows[first:last]`` strictly nearer to q than sqrt(reach2).

    ``sums`` are d + 1 vectors, of 1/distance and of velocity/distance; distances are floored at sqrt(floor2). ``q``,
    ``rows`` and the arrays of the field are pointers (see ``Bare``).
    """
    # A pair of rows at a time: what is added up, and so the last bit of it, hangs on which rows make a pair.
    for i in range(first, last - 1, 2):
        fetch(field.data, np.intp(rows[i + AHEAD]), dims)
        fetch(field.data, np.intp(rows[i + AHEAD + 1]), dims)
        sums = _add_rows(field.data, np.intp(rows[i]), np.intp(rows[i + 1]), q, reach2, floor2, sums, dims)
    if (last - first) % 2 == 1:
        sums = _add_rows(field.data, np.intp(rows[last - 1]), field.rows, q, reach2, floor2, sums, dims)
    return sums


# Velocities


@inner
def mean_velocity(sums, out, dims):
    """Inverse-distance mean of the velocities summed up, to the pointer ``out``; False, and nothing done, of none."""
    weight = _total(sums[0])
    if weight == 0.0:
        return False
    for k in range(len(dims)):
        out[k] = _total(sums[1 + k]) / weight
    return True


@inner
def velocity_at(field, place, out, dims):
    """Velocity of the point that ``nearest`` found, to the pointer ``out``."""
    for k in range(len(dims)):
        out[k] = field.data[place + (len(dims) + k) * WIDTH]


@kernel
def departures(points, velocities, leaf_of, lo, hi, ground):
    """Velocity of training points minus that of the other leaves, in the ball, of the class ``[lo, hi)`` around theirs.

    Args:
        points, velocities: (n, d). leaf_of, lo, hi: (n,) ranks. ground: its classes are not asked for.

    Returns:
        (n, d); NaN where the ball holds no point of another leaf.
    """
    reach2, floor2, dims, leaf_at = ground.reach2, ground.floor2, ground.dims, ground.field.leaf_at
    d, field = len(dims), bare(ground.field)
    out, room = np.empty((len(points), d)), scratch(leaf_at)
    begin = np.intp(0)  # a literal would compile add_rows a second time
    for i in range(len(points)):
        leaf, q, at, sums = leaf_of[i], pointer(points, i * d), pointer(out, i * d), nothing(dims)
        for first, last in ((lo[i], leaf), (leaf + 1, hi[i])):
            rows, count = rows_near(q, leaf_at[first], leaf_at[last], field, reach2, pointer(room, 0), dims)
            sums = add_rows(q, rows, begin, count, field, reach2, floor2, sums, dims)
        known = mean_velocity(sums, at, dims)
        for k in range(d):
            out[i, k] = velocities[i, k] - at[k] if known else math.nan
    hold(room)
    return out
