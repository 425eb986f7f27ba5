"""Explicit SIMD lanes for numba: a value that is one LLVM vector, and the few operations our kernels need.

Numba's loop vectoriser does not see through a dynamic programme run for several pairs at once; vector operations
written out do (a factor of ten). LLVM splits vectors to whatever registers the processor has, so the lane count
matters for speed only, never for results: no operation here mixes lanes.

A point of d coordinates in every lane is a tuple of d vectors. Flat arrays hold such points one after the other,
``array[(row * d + axis) * LANES + lane]``. ``axes``, any tuple of d integers, carries d in its type.

Everything lives at module level: intrinsics captured in closures would be compiled anew in every process. Numba's
cache on disk does not notice changes in this file; touch the kernels that use it after editing.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

# One AVX2 register, or a pair of NEON registers. Fixed, not asked of the processor: the kernels compiled for one count
# lie in numba's cache, and memory would be overrun if data of another count met them. Clear the cache to change it.
LANES = {"float32": 8, "float64": 4}


class Vector(types.Type):
    """Numba type of one float per lane."""

    def __init__(self, dtype: types.Float):
        self.dtype = dtype
        self.lanes = LANES[dtype.name]
        super().__init__(name=f"Vector({dtype}, {self.lanes})")


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    """A vector is an LLVM vector."""

    def __init__(self, manager, vector: Vector):
        element = ir.FloatType() if vector.dtype.bitwidth == 32 else ir.DoubleType()
        super().__init__(manager, vector, ir.VectorType(element, vector.lanes))


def _address(context, builder, array_type, array, element):
    """Pointer to the vector that starts at an element of a flat array, and the alignment it surely has."""
    data = context.make_array(array_type)(context, builder, array).data
    vector = context.get_data_type(Vector(array_type.dtype)).as_pointer()
    return builder.bitcast(builder.gep(data, [element]), vector), array_type.dtype.bitwidth // 8


@intrinsic
def lanes_of(typing, array):
    """Lanes of a vector of the array's dtype."""

    def generate(context, builder, signature, arguments):
        return context.get_constant(types.intp, Vector(array.dtype).lanes)

    return types.intp(array), generate


@intrinsic
def fill(typing, array, value):
    """A vector of the array's dtype with the same value in every lane."""
    vector = Vector(array.dtype)

    def generate(context, builder, signature, arguments):
        kind = context.get_data_type(vector)
        first = builder.insert_element(ir.Constant(kind, ir.Undefined), arguments[1], ir.Constant(ir.IntType(32), 0))
        everywhere = ir.Constant(ir.VectorType(ir.IntType(32), vector.lanes), [0] * vector.lanes)
        return builder.shuffle_vector(first, ir.Constant(kind, ir.Undefined), everywhere)

    return vector(array, array.dtype), generate


@intrinsic
def load(typing, array, row):
    """The vector ``array[row * LANES : (row + 1) * LANES]``."""
    vector = Vector(array.dtype)

    def generate(context, builder, signature, arguments):
        element = builder.mul(arguments[1], ir.Constant(arguments[1].type, vector.lanes))
        pointer, align = _address(context, builder, signature.args[0], arguments[0], element)
        return builder.load(pointer, align=align)

    return vector(array, types.intp), generate


@intrinsic
def store(typing, array, row, value):
    """``array[row * LANES : (row + 1) * LANES] = value``"""

    def generate(context, builder, signature, arguments):
        element = builder.mul(arguments[1], ir.Constant(arguments[1].type, value.lanes))
        pointer, align = _address(context, builder, signature.args[0], arguments[0], element)
        builder.store(arguments[2], pointer, align=align)
        return context.get_dummy_value()

    return types.none(array, types.intp, value), generate


@intrinsic
def point(typing, array, row, axes):
    """The point ``row`` of every lane: a tuple of vectors, one per axis."""
    vector = Vector(array.dtype)
    result = types.UniTuple(vector, len(axes))

    def generate(context, builder, signature, arguments):
        whole = builder.mul(arguments[1], ir.Constant(arguments[1].type, len(axes) * vector.lanes))
        parts = []
        for axis in range(len(axes)):
            element = builder.add(whole, ir.Constant(whole.type, axis * vector.lanes))
            pointer, align = _address(context, builder, signature.args[0], arguments[0], element)
            parts.append(builder.load(pointer, align=align))
        return context.make_tuple(builder, result, parts)

    return result(array, types.intp, axes), generate


@intrinsic
def squared_distance(typing, a, b):
    """``(dx² + dy²) + dz²`` of two points in every lane.

    float64: each operation is rounded by itself, as no fast-math flag is set; LLVM may not fuse a product into the sum,
    and every lane gets the bits that plain arithmetic gives. float32: it may, where the processor can.
    """
    flags = ("contract",) if a.dtype.dtype.bitwidth == 32 else ()

    def generate(context, builder, signature, arguments):
        total = None
        for axis in range(len(a)):
            d = builder.fsub(builder.extract_value(arguments[0], axis), builder.extract_value(arguments[1], axis))
            square = builder.fmul(d, d, flags=flags)
            total = square if total is None else builder.fadd(total, square, flags=flags)
        return total

    return a.dtype(a, b), generate


@intrinsic
def furthest_squared(typing, low_a, high_a, low_b, high_b):
    """Largest squared distance of a point in one box and a point in the other, in every lane, as ``squared_distance``.

    Rounding is monotone, so no two points inside have a larger one (but for products fused into sums).
    """
    flags = ("contract",) if low_a.dtype.dtype.bitwidth == 32 else ()

    def generate(context, builder, signature, arguments):
        total = None
        for axis in range(len(low_a)):
            low_a_k, high_a_k, low_b_k, high_b_k = (builder.extract_value(each, axis) for each in arguments)
            up, down = builder.fsub(high_a_k, low_b_k), builder.fsub(high_b_k, low_a_k)
            d = builder.select(builder.fcmp_ordered(">", up, down, flags=("nnan", "nsz")), up, down)
            square = builder.fmul(d, d, flags=flags)
            total = square if total is None else builder.fadd(total, square, flags=flags)
        return total

    return low_a.dtype(low_a, high_a, low_b, high_b), generate


def _choose(comparison: str):
    @intrinsic
    def choose(typing, a, b):
        def generate(context, builder, signature, arguments):
            x, y = arguments
            # There is no NaN and no negative zero here; saying so makes this one instruction everywhere.
            test = builder.fcmp_ordered(comparison, x, y, flags=("nnan", "nsz"))
            return builder.select(test, x, y)

        return a(a, b), generate

    return choose


lower = _choose("<")
higher = _choose(">")


def _combine(operation: str):
    @intrinsic
    def combine(typing, a, b):
        def generate(context, builder, signature, arguments):
            return getattr(builder, operation)(*arguments)

        return a(a, b), generate

    return combine


plus = _combine("fadd")
minus = _combine("fsub")
times = _combine("fmul")


@intrinsic
def magnitude(typing, a):
    """Absolute value in every lane."""

    def generate(context, builder, signature, arguments):
        vector = signature.args[0]
        kind, name = arguments[0].type, f"llvm.fabs.v{vector.lanes}f{vector.dtype.bitwidth}"
        return builder.call(
            cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), name), arguments
        )

    return a(a), generate


@intrinsic
def within(typing, a, low, high):
    """Bit mask of the lanes with ``low <= a < high``, vectors; the first lane is the lowest bit."""

    def generate(context, builder, signature, arguments):
        x, low, high = arguments
        inside = builder.and_(builder.fcmp_ordered(">=", x, low), builder.fcmp_ordered("<", x, high))
        bits = ir.IntType(signature.args[0].lanes)
        return builder.zext(builder.bitcast(inside, bits), ir.IntType(64))

    return types.intp(a, low, high), generate
