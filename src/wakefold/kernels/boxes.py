"""A tree of bounding boxes over the points of all tracks in leaf order: the rows of a class near a position.

The points lie in leaf order (rank), time inside a leaf, so a class is a contiguous slice and so are its boxes. A row is
``WIDTH`` points of one leaf, the last of a leaf filled up with points at infinity; each row has a box, each ``FAN``
boxes of one level make a node with one box on the level above. No hashing, no second index.

A query goes down the levels: all nodes reached on one level, then all on the next, the ``FAN`` boxes of a node in SIMD
lanes, the survivors appended without a branch: a mispredicted one costs as much as five points, and a query of a
whole harbour tests 1,500 nodes for 11,000 points. What is left is a list of rows.

``dims`` is a tuple of d zeros: its length is known when the kernel is compiled, so the loops over coordinates unroll.
"""

# pyright: reportCallIssue=false
# (numba gives an intrinsic its typing context: it is called with one argument less than it is defined with)

import math
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.simd import LANES, Vector

WIDTH = LANES["float64"]
FAN = LANES["float32"]
SHIFT = FAN.bit_length() - 1
_SINGLES = Vector(types.float32)
WORD = ir.IntType(64)
AHEAD = 16  # rows are fetched so many before their use
CACHE_LINE = 64  # bytes
SLACK = 1e-6  # relative; float32 rounds by 6e-8: the corner, the position, their difference, its square


class Field(NamedTuple):
    """Points and velocities in leaf order, and the boxes over them."""

    data: np.ndarray  # ((rows + 1) * 2 d * WIDTH,): in each row d positions, then d velocities; the last row is empty
    leaf_at: np.ndarray  # (M + 1,) first row of each leaf rank
    boxes: np.ndarray  # (nodes of all levels * 2 d * FAN,) float32: in each node d lower, d upper corners of FAN boxes
    level_at: np.ndarray  # (levels + 1,) first node of each level; the boxes of level 0 are those of the rows


def field(points, velocities, starts):
    """The field of points (P, d) and velocities (P, d) in leaf order; leaf r owns ``starts[r]:starts[r + 1]``."""
    d = points.shape[1]
    lengths = np.diff(starts)
    rows = -(-lengths // WIDTH)
    leaf_at = np.concatenate([[0], np.cumsum(rows)])
    slots = np.zeros(((leaf_at[-1] + 1) * WIDTH, 2 * d))
    slots[:, :d] = np.inf
    at = np.arange(len(points)) + np.repeat(leaf_at[:-1] * WIDTH - starts[:-1], lengths)
    slots[at, :d], slots[at, d:] = points, velocities
    first = np.repeat(starts[:-1], rows) + WIDTH * (np.arange(leaf_at[-1]) - np.repeat(leaf_at[:-1], rows))
    low, high = np.minimum.reduceat(points, first), np.maximum.reduceat(points, first)
    boxes, sizes = [], []
    while True:
        nodes = -(-len(low) // FAN)
        room = np.full((nodes * FAN - len(low), d), np.inf)  # boxes that are out of every reach fill the last node
        low, high = np.concatenate([low, room]), np.concatenate([high, -room])
        boxes.append(_in_lanes(np.hstack([low, high]).astype(np.float32), FAN))
        sizes.append(nodes)
        if nodes == 1:
            break
        low, high = low.reshape(nodes, FAN, d).min(axis=1), high.reshape(nodes, FAN, d).max(axis=1)
    return Field(_in_lanes(slots, WIDTH), leaf_at, np.concatenate(boxes), np.concatenate([[0], np.cumsum(sizes)]))


def _in_lanes(values, lanes):
    """Values (n * lanes, k) as a flat array (n, k, lanes)."""
    return values.reshape(-1, lanes, values.shape[1]).transpose(0, 2, 1).reshape(-1)


# Helpers of intrinsics


def all_lanes(value, lanes):
    return ir.Constant(ir.VectorType(ir.DoubleType(), lanes), [value] * lanes)


def spread(builder, value, lanes):
    """A vector with the same value in every lane."""
    kind = ir.VectorType(value.type, lanes)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    nowhere = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), nowhere)


def data_of(context, builder, signature, arguments, place):
    """Pointer to the first element of the array argument at a place."""
    return context.make_array(signature.args[place])(context, builder, arguments[place]).data


def vector_at(builder, pointer, index, lanes):
    """The vector of floats that starts at an element."""
    kind = ir.VectorType(pointer.type.pointee, lanes).as_pointer()
    return builder.load(builder.bitcast(builder.gep(pointer, [index]), kind), align=4)


def coordinates(builder, pointer, d, lanes):
    """The d coordinates of a position, each in every lane."""
    return [spread(builder, builder.load(builder.gep(pointer, [ir.Constant(WORD, k)])), lanes) for k in range(d)]


def sum_of(builder, terms, flags=()):
    total = terms[0]
    for term in terms[1:]:
        total = builder.fadd(total, term, flags=flags)
    return total


@intrinsic
def fetch(typing, data, row, dims):
    """Start to read a row of the data, d cache lines, into the nearest cache.

    Lists of rows jump about in memory: without it a neighbour costs 1.6 ns, with it 1.05 (210,000 points, 7 MB). Any
    index will do, beyond the end too: no memory fault comes of it. Boxes gain nothing from it.
    """

    def generate(context, builder, signature, arguments):
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        start = builder.bitcast(data_of(context, builder, signature, arguments, 0), byte)
        first = builder.mul(arguments[1], ir.Constant(WORD, len(dims) * CACHE_LINE))
        for k in range(len(dims)):
            place = builder.gep(start, [builder.add(first, ir.Constant(WORD, k * CACHE_LINE))])
            builder.call(prefetch, [place, *(ir.Constant(number, x) for x in (0, 3, 1))])  # read, keep, data
        return context.get_dummy_value()

    return types.none(data, types.intp, dims), generate


# The way down the boxes


@intrinsic
def _around(typing, q, dims):
    """The coordinates of q as float32, each in every lane: a tuple of d vectors."""
    result = types.UniTuple(_SINGLES, len(dims))

    def generate(context, builder, signature, arguments):
        place = data_of(context, builder, signature, arguments, 0)
        parts = [builder.load(builder.gep(place, [ir.Constant(WORD, k)])) for k in range(len(dims))]
        return context.make_tuple(
            builder, result, [spread(builder, builder.fptrunc(x, ir.FloatType()), FAN) for x in parts]
        )

    return result(q, dims), generate


@intrinsic
def _touched(typing, boxes, node, q, reach2):
    """Bit mask of the boxes of a node less than sqrt(reach2) away from q, a tuple of d vectors."""
    d = len(q)

    def generate(context, builder, signature, arguments):
        flat = data_of(context, builder, signature, arguments, 0)
        first = builder.mul(arguments[1], ir.Constant(WORD, 2 * d * FAN))
        zero = ir.Constant(ir.VectorType(ir.FloatType(), FAN), [0.0] * FAN)
        squares = []
        for k in range(d):
            low, high = (
                vector_at(builder, flat, builder.add(first, ir.Constant(WORD, side * FAN)), FAN) for side in (k, d + k)
            )
            x = builder.extract_value(arguments[2], k)
            below, above = builder.fsub(low, x), builder.fsub(x, high)
            gap = builder.select(builder.fcmp_ordered(">", below, above), below, above)
            gap = builder.select(builder.fcmp_ordered(">", gap, zero), gap, zero)
            squares.append(builder.fmul(gap, gap))
        close = builder.fcmp_ordered("<=", sum_of(builder, squares), spread(builder, arguments[3], FAN))
        return builder.zext(builder.bitcast(close, ir.IntType(FAN)), WORD)

    return types.intp(boxes, types.intp, q, types.float32), generate


_BYTE = ir.IntType(8)
_SET_BITS = ir.Constant(  # for each mask the numbers of its set bits, then anything
    ir.ArrayType(ir.VectorType(_BYTE, FAN), 1 << FAN),
    [
        ir.Constant(ir.VectorType(_BYTE, FAN), sorted(range(FAN), key=lambda k: not mask >> k & 1))
        for mask in range(1 << FAN)
    ],
)


@intrinsic
def _append(typing, out, count, base, mask):
    """``out[count:] = base + (numbers of the set bits of the mask)``; writes FAN elements, returns the new count."""

    def generate(context, builder, signature, arguments):
        word = ir.IntType(32)
        table = cgutils.global_constant(builder, "set_bits", _SET_BITS)
        bits = builder.load(builder.gep(table, [ir.Constant(WORD, 0), arguments[3]]), align=FAN)
        kind = ir.VectorType(word, FAN)
        found = builder.add(builder.zext(bits, kind), spread(builder, builder.trunc(arguments[2], word), FAN))
        place = builder.gep(data_of(context, builder, signature, arguments, 0), [arguments[1]])
        builder.store(found, builder.bitcast(place, kind.as_pointer()), align=4)
        return builder.add(arguments[1], builder.ctpop(arguments[3]))

    return types.intp(out, types.intp, types.intp, types.intp), generate


@kernel
def scratch(field):
    """Room for the lists of ``near``."""
    return np.empty((2, field.leaf_at[-1] + FAN + AHEAD + 2), dtype=np.int32)


@kernel
def near(q, first, last, field, reach2, lists, dims):
    """Rows of ``[first, last)`` that may hold points within reach of q.

    Boxes are tested in float32, with a little added to the reach for its rounding: no row within reach is missed.

    Returns:
        which of the two lists holds the rows, in rising order, and how many they are.
    """
    if first >= last:
        return 0, 0
    size = 0.0
    for k in range(len(dims)):
        size += abs(q[k])
    reach = np.float32((math.sqrt(reach2) * (1.0 + SLACK) + size * SLACK) ** 2)
    around = _around(q, dims)
    level, low, high = 0, first >> SHIFT, (last - 1) >> SHIFT  # nodes of this level
    while high - low >= FAN:
        level, low, high = level + 1, low >> SHIFT, high >> SHIFT
    side, count = 0, high - low + 1
    for i in range(count):
        lists[0, i] = low + i
    while True:
        shift = SHIFT * level
        begin, end = first >> shift, (last - 1) >> shift  # boxes of this level
        here, there, found = lists[side], lists[1 - side], 0
        for i in range(count):
            node = np.intp(here[i])
            mask = _touched(field.boxes, field.level_at[level] + node, around, reach)
            if node == begin >> SHIFT:
                mask &= -1 << (begin & (FAN - 1))
            if node == end >> SHIFT:
                mask &= (2 << (end & (FAN - 1))) - 1
            found = _append(there, found, node << SHIFT, mask)
        side, count = 1 - side, found
        if level == 0:
            return side, count
        level -= 1


# The nearest point


@inner
def _far(q, boxes, node, child, reach2, dims):
    """Whether a box surely lies at least sqrt(reach2) away from q; its corners are rounded to float32."""
    d = len(dims)
    first = node * 2 * d * FAN + child
    total = 0.0
    for k in range(d):
        low, high = np.float64(boxes[first + k * FAN]), np.float64(boxes[first + (d + k) * FAN])
        gap = max(max(low - SLACK * abs(low) - q[k], q[k] - high - SLACK * abs(high)), 0.0)
        total += gap * gap
    return total >= reach2


@inner
def _next_row(q, row, last, field, reach2, dims):
    """First row in ``[row, last)`` whose box is within reach of q; ``last`` when there is none."""
    top = len(field.level_at) - 2
    while row < last:
        level = 0  # the largest box that starts here and ends within the range
        while level < top and (row >> (level * SHIFT)) & (FAN - 1) == 0 and row + (FAN << (level * SHIFT)) <= last:
            level += 1
        while True:
            box = row >> (level * SHIFT)
            if _far(q, field.boxes, field.level_at[level] + (box >> SHIFT), box & (FAN - 1), reach2, dims):
                row += 1 << (level * SHIFT)
                break
            if level == 0:
                return row
            level -= 1
    return last


@inner
def nearest(q, first, last, field, best2, best, dims):
    """Nearest point to q in rows ``[first, last)``, given the best so far (squared distance, place in the data)."""
    d = len(dims)
    row = _next_row(q, first, last, field, best2, dims)
    while row < last:
        for place in range(row * 2 * d * WIDTH, row * 2 * d * WIDTH + WIDTH):
            dist2 = 0.0
            for k in range(d):
                gap = field.data[place + k * WIDTH] - q[k]
                dist2 += gap * gap
            if dist2 < best2:
                best2, best = dist2, place
        row = _next_row(q, row + 1, last, field, best2, dims)
    return best2, best
