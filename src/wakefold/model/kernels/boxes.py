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
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from wakefold.base.compile import inner
from wakefold.model.kernels.simd import LANES, Vector

WIDTH = LANES["float64"]
FAN = LANES["float32"]
SHIFT = FAN.bit_length() - 1
_SINGLES, _DOUBLES = Vector(types.float32), Vector(types.float64)
WORD = ir.IntType(64)
AHEAD = 16  # rows are fetched so many before their use
CACHE_LINE = 64  # bytes
SPARE = FAN + AHEAD + 2  # elements of a list that are written or read beyond its end
FEW = 32  # rows that are sooner looked at than picked
SLACK = 1e-6  # relative; float32 rounds by 6e-8: the corner, the position, their difference, its square


class Field(NamedTuple):
    """Points and velocities in leaf order, and the boxes over them."""

    data: np.ndarray  # ((rows + 1) * 2 d * WIDTH,): in each row d positions, then d velocities; the last row is empty
    leaf_at: np.ndarray  # (M + 1,) first row of each leaf rank
    boxes: np.ndarray  # (nodes of all levels * 2 d * FAN,) float32: in each node d lower, d upper corners of FAN boxes
    level_at: np.ndarray  # (levels + 1,) first node of each level; the boxes of level 0 are those of the rows


class Ground(NamedTuple):
    """Where a particle moves: the classes, the points of the tracks and the ball around a position."""

    lo: np.ndarray  # (C,) first leaf rank of each class
    hi: np.ndarray  # (C,) and the one after its last
    field: Field
    reach2: float  # squared radius of the ball, square metres
    floor2: float  # squared smallest distance used in 1/distance
    dims: tuple[int, ...]  # d zeros


class Bare(NamedTuple):
    """A ``Field`` as helpers of kernels are told of it: pointers, and two numbers.

    An array handed to a helper takes seven words and two atomic operations on its count of references. As arrays, the
    field and the lists of rows took a third of the time of the velocities under small trees, and most of the time it
    took to compile them. Whoever makes pointers keeps the arrays.
    """

    data: Any
    leaf_at: Any
    boxes: Any
    level_at: Any
    rows: int  # the row of this number is the empty one
    top: int  # the highest level


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
    """Pointer to the first element of the array argument at a place, which may be that pointer."""
    if isinstance(signature.args[place], types.CPointer):
        return arguments[place]
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
def pointer(typing, array, element):
    """Pointer to an element of a flat or contiguous array, or so many elements on from a pointer; no bounds, no -1."""

    def generate(context, builder, signature, arguments):
        return builder.gep(data_of(context, builder, signature, arguments, 0), [arguments[1]])

    return types.CPointer(array.dtype)(array, types.intp), generate


@inner
def bare(field):
    """The ``Bare`` of a ``Field``."""
    leaf_at, level_at = field.leaf_at, field.level_at
    rows, top = leaf_at[len(leaf_at) - 1], len(level_at) - 2
    return Bare(pointer(field.data, 0), pointer(leaf_at, 0), pointer(field.boxes, 0), pointer(level_at, 0), rows, top)


@intrinsic
def hold(typing, array):
    """Keeps an array made in a kernel, of which pointers were taken, up to here."""
    return types.none(array), lambda context, builder, signature, arguments: context.get_dummy_value()


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


@inner
def scratch(leaf_at):
    """Room for two pairs of the lists that ``rows_near`` makes."""
    return np.empty(4 * (leaf_at[len(leaf_at) - 1] + SPARE), dtype=np.int32)


@inner
def rows_near(q, first, last, field, reach2, lists, dims):
    """Rows of ``[first, last)`` that may hold points within reach of q.

    Boxes are tested in float32, with a little added to the reach for its rounding: no row within reach is missed.

    Args:
        q: pointer to d coordinates. field: ``Bare``. lists: pointer to one half of what ``scratch`` made.

    Returns:
        pointer to the rows, in rising order, and how many they are.
    """
    here, there = lists, pointer(lists, field.rows + SPARE)
    if first >= last:
        return here, 0
    size = 0.0
    for k in range(len(dims)):
        size += abs(q[k])
    reach = np.float32((math.sqrt(reach2) * (1.0 + SLACK) + size * SLACK) ** 2)
    around = _around(q, dims)
    level, low, high = 0, first >> SHIFT, (last - 1) >> SHIFT  # nodes of this level
    while high - low >= FAN:
        level, low, high = level + 1, low >> SHIFT, high >> SHIFT
    count = high - low + 1
    for i in range(count):
        here[i] = np.int32(low + i)
    while True:
        shift = SHIFT * level
        begin, end, found = first >> shift, (last - 1) >> shift, 0  # boxes of this level
        for i in range(count):
            node = np.intp(here[i])
            mask = _touched(field.boxes, field.level_at[level] + node, around, reach)
            if node == begin >> SHIFT:
                mask &= -1 << (begin & (FAN - 1))
            if node == end >> SHIFT:
                mask &= (2 << (end & (FAN - 1))) - 1
            found = _append(there, found, node << SHIFT, mask)
        here, there, count = there, here, found
        if level == 0:
            return here, count
        level -= 1


# The nearest point


@intrinsic
def _nearer(typing, data, row, q, found, dims):
    """``found`` and a row of points: in each lane the least squared distance from q and the first row that has it."""
    d = len(dims)

    def generate(context, builder, signature, arguments):
        flat = data_of(context, builder, signature, arguments, 0)
        place = coordinates(builder, arguments[2], d, WIDTH)
        first = builder.mul(arguments[1], ir.Constant(WORD, 2 * d * WIDTH))
        gaps = [
            builder.fsub(vector_at(builder, flat, builder.add(first, ir.Constant(WORD, k * WIDTH)), WIDTH), place[k])
            for k in range(d)
        ]
        square = sum_of(builder, [builder.fmul(gap, gap) for gap in gaps])
        row = spread(builder, builder.sitofp(arguments[1], ir.DoubleType()), WIDTH)
        best, rows = (builder.extract_value(arguments[3], k) for k in range(2))
        less = builder.fcmp_ordered("<", square, best)
        out = [builder.select(less, square, best), builder.select(less, row, rows)]
        return context.make_tuple(builder, signature.return_type, out)

    return found(data, types.intp, q, found, dims), generate


@intrinsic
def _nothing_near(typing, dims):
    """What ``_nearer`` starts from."""
    result = types.UniTuple(_DOUBLES, 2)

    def generate(context, builder, signature, arguments):
        return context.make_tuple(builder, result, [all_lanes(math.inf, WIDTH), all_lanes(-1.0, WIDTH)])

    return result(dims), generate


@intrinsic
def _nearest_of(typing, found, dims):
    """Least squared distance of the lanes, and the place in the data of the first point that has it."""
    d, result = len(dims), types.Tuple((types.float64, types.intp))

    def generate(context, builder, signature, arguments):
        best = row = lane = None
        for k in range(WIDTH):
            at = ir.Constant(ir.IntType(32), k)
            x, r = (builder.extract_element(builder.extract_value(arguments[0], j), at) for j in range(2))
            if best is None:
                best, row, lane = x, r, ir.Constant(WORD, 0)
                continue
            tie = builder.and_(builder.fcmp_ordered("==", x, best), builder.fcmp_ordered("<", r, row))
            less = builder.or_(builder.fcmp_ordered("<", x, best), tie)
            best, row = builder.select(less, x, best), builder.select(less, r, row)
            lane = builder.select(less, ir.Constant(WORD, k), lane)
        row = builder.mul(builder.fptosi(row, WORD), ir.Constant(WORD, 2 * d * WIDTH))
        return context.make_tuple(builder, result, [best, builder.add(row, lane)])

    return result(found, dims), generate


@inner
def nearest(q, first, last, field, best2, best, lists, dims):
    """Nearest point to q in rows ``[first, last)``, given the best so far (squared distance, place in the data).

    The first of several. A few rows are looked at one and all, of many only those within reach of the best so far.

    Args:
        q, field, lists: see ``rows_near``; the lists are not those that hold anything.
    """
    found, bound = _nothing_near(dims), best2
    if last - first <= FEW:
        for row in range(first, last):
            found = _nearer(field.data, row, q, found, dims)
    else:
        if bound == math.inf:
            for row in range(first, last, (last - first) // FEW):
                found = _nearer(field.data, row, q, found, dims)
            bound, _ = _nearest_of(found, dims)
        rows, count = rows_near(q, first, last, field, bound, lists, dims)
        found = _nothing_near(dims)
        for i in range(count):
            found = _nearer(field.data, np.intp(rows[i]), q, found, dims)
    distance2, place = _nearest_of(found, dims)
    return (distance2, place) if distance2 < best2 else (best2, best)
