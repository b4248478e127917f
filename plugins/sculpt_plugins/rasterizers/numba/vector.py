"""A vector of 16 float32 for numba kernels.

numba leaves the pixel loops scalar (wrap-around indices, branches, aliasing). The operations here emit LLVM's
``<16 x float>`` directly; LLVM maps it to one AVX-512, two AVX2 or four SSE or NEON registers, whichever there are.
"""

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

from .layout import BLOCK, LANES

_FLOAT = ir.FloatType()
_INT32 = ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, LANES)
_WORDS = ir.VectorType(_INT32, LANES)
_MASK_BITS = ir.IntType(LANES)
_FAST = ("fast",)


class VectorType(types.Type):
    def __init__(self):
        super().__init__(name=f"Vector{LANES}")


VECTOR = VectorType()


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


def _as_vector(context, builder, value, kind):
    """A scalar becomes a vector of copies of itself."""
    if isinstance(kind, VectorType):
        return value
    value = context.cast(builder, value, kind, types.float32)
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(_INT32, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(_INT32, LANES), [0] * LANES))


def _as_vectors(context, builder, values, kinds):
    return [_as_vector(context, builder, value, kind) for value, kind in zip(values, kinds, strict=True)]


def _as_words(context, builder, value, kind):
    """A vector of copies of an integer."""
    value = context.cast(builder, value, kind, types.uint32)
    undefined = ir.Constant(_WORDS, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(_INT32, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(_WORDS, [0] * LANES))


def _words_address(context, builder, array_kind, array):
    return builder.bitcast(context.make_array(array_kind)(context, builder, array).data, _WORDS.as_pointer())


def _load_words(builder, at):
    words = builder.load(at)
    words.align = 4
    return words


def _address(context, builder, array_kind, array, index, index_kind):
    data = context.make_array(array_kind)(context, builder, array).data
    return builder.gep(data, [context.cast(builder, index, index_kind, types.intp)], inbounds=True)


@intrinsic
def load(typing, array, index):
    """Elements index ... index + 15 of a flat array."""

    def generate(context, builder, signature, arguments):
        at = _address(context, builder, signature.args[0], arguments[0], arguments[1], signature.args[1])
        value = builder.load(builder.bitcast(at, _VECTOR.as_pointer()))
        value.align = 4
        return value

    return VECTOR(array, index), generate


@intrinsic
def store(typing, array, index, vector):
    """Inverse of load."""

    def generate(context, builder, signature, arguments):
        at = _address(context, builder, signature.args[0], arguments[0], arguments[1], signature.args[1])
        builder.store(arguments[2], builder.bitcast(at, _VECTOR.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, index, vector), generate


@intrinsic
def copies(typing, array, index):
    """A vector of copies of one element of a flat array."""

    def generate(context, builder, signature, arguments):
        at = _address(context, builder, signature.args[0], arguments[0], arguments[1], signature.args[1])
        return _as_vector(context, builder, builder.load(at), types.float32)

    return VECTOR(array, index), generate


@intrinsic
def splat(typing, value):
    """A vector of copies."""

    def generate(context, builder, signature, arguments):
        return _as_vector(context, builder, arguments[0], signature.args[0])

    return VECTOR(value), generate


@intrinsic
def lane_column(typing):
    """Column of each lane: of a pixel in its block, or of a block in its tile."""

    def generate(context, builder, signature, arguments):
        return ir.Constant(_VECTOR, [float(lane % BLOCK) for lane in range(LANES)])

    return VECTOR(), generate


@intrinsic
def lane_row(typing):
    """Row of each lane: of a pixel in its block, or of a block in its tile."""

    def generate(context, builder, signature, arguments):
        return ir.Constant(_VECTOR, [float(lane // BLOCK) for lane in range(LANES)])

    return VECTOR(), generate


@intrinsic
def larger(typing, left, right):
    """Elementwise maximum."""

    def generate(context, builder, signature, arguments):
        left, right = _as_vectors(context, builder, arguments, signature.args)
        return builder.select(builder.fcmp_ordered(">", left, right, flags=_FAST), left, right)

    return VECTOR(left, right), generate


@intrinsic
def smaller(typing, left, right):
    """Elementwise minimum."""

    def generate(context, builder, signature, arguments):
        left, right = _as_vectors(context, builder, arguments, signature.args)
        return builder.select(builder.fcmp_ordered("<", left, right, flags=_FAST), left, right)

    return VECTOR(left, right), generate


@intrinsic
def where_at_least(typing, value, limit, chosen, other):
    """chosen where value >= limit, else other."""

    def generate(context, builder, signature, arguments):
        value, limit, chosen, other = _as_vectors(context, builder, arguments, signature.args)
        return builder.select(builder.fcmp_ordered(">=", value, limit), chosen, other)

    return VECTOR(value, limit, chosen, other), generate


@intrinsic
def lanes_at_least(typing, value, limit):
    """An integer with bit l set where value >= limit in lane l."""

    def generate(context, builder, signature, arguments):
        value, limit = _as_vectors(context, builder, arguments, signature.args)
        bits = builder.bitcast(builder.fcmp_ordered(">=", value, limit), _MASK_BITS)
        return builder.zext(bits, ir.IntType(64))

    return types.int64(value, limit), generate


@intrinsic
def mark_lanes(typing, marks, value, limit, bit):
    """marks[l] |= bit where value >= limit in lane l, for a flat uint32 array. Returns those lanes as bits."""

    def generate(context, builder, signature, arguments):
        value, limit = _as_vectors(context, builder, arguments[1:3], signature.args[1:3])
        above = builder.fcmp_ordered(">=", value, limit)
        bit = _as_words(context, builder, arguments[3], signature.args[3])
        at = _words_address(context, builder, signature.args[0], arguments[0])
        marked = builder.select(above, bit, ir.Constant(_WORDS, None))
        store = builder.store(builder.or_(_load_words(builder, at), marked), at)
        store.align = 4
        return builder.zext(builder.bitcast(above, _MASK_BITS), ir.IntType(64))

    return types.int64(marks, value, limit, bit), generate


@intrinsic
def marked_lanes(typing, marks, bit):
    """The lanes l with marks[l] & bit as an integer's bits: mark_lanes the other way round."""

    def generate(context, builder, signature, arguments):
        bit = _as_words(context, builder, arguments[1], signature.args[1])
        at = _words_address(context, builder, signature.args[0], arguments[0])
        common = builder.and_(_load_words(builder, at), bit)
        marked = builder.icmp_unsigned("!=", common, ir.Constant(_WORDS, None))
        return builder.zext(builder.bitcast(marked, _MASK_BITS), ir.IntType(64))

    return types.int64(marks, bit), generate


@intrinsic
def lowest_bit(typing, mask):
    """Number of the lowest set bit of a positive int64."""

    def generate(context, builder, signature, arguments):
        wide = ir.IntType(64)
        kind = ir.FunctionType(wide, [wide, ir.IntType(1)])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.cttz.i64")
        mask = context.cast(builder, arguments[0], signature.args[0], types.int64)
        return builder.call(function, [mask, ir.Constant(ir.IntType(1), 1)])

    return types.int64(mask), generate


@intrinsic
def magnitude(typing, vector):
    """Elementwise absolute value."""

    def generate(context, builder, signature, arguments):
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fabs.v{LANES}f32")
        return builder.call(function, arguments)

    return VECTOR(vector), generate


def _shuffled_sum(builder, left, right, step):
    """Adds neighbours ``step`` apart; the lanes of ``left`` and ``right`` alternate in the result."""
    low, high = [], []
    for lane in range(8):
        odd = (lane // step) % 2
        start = lane - odd * step + 8 * odd
        low.append(start)
        high.append(start + step)
    picked = [
        builder.shuffle_vector(left, right, ir.Constant(ir.VectorType(_INT32, 8), lanes)) for lanes in (low, high)
    ]
    return builder.fadd(*picked, flags=_FAST)


@intrinsic
def add_sums_of_8(typing, array, index, v0, v1, v2, v3, v4, v5, v6, v7):
    """array[index + k] += sum of the lanes of vk: one tree of transposes instead of eight reductions."""

    def generate(context, builder, signature, arguments):
        level = list(arguments[2:])
        halves = [ir.Constant(ir.VectorType(_INT32, 8), list(range(start, start + 8))) for start in (0, 8)]
        level = [
            builder.fadd(*[builder.shuffle_vector(vector, vector, half) for half in halves], flags=_FAST)
            for vector in level
        ]
        for step in (1, 2, 4):
            level = [
                _shuffled_sum(builder, left, right, step) for left, right in zip(level[::2], level[1::2], strict=True)
            ]
        at = _address(context, builder, signature.args[0], arguments[0], arguments[1], signature.args[1])
        at = builder.bitcast(at, ir.VectorType(_FLOAT, 8).as_pointer())
        old = builder.load(at)
        old.align = 4
        builder.store(builder.fadd(old, level[0], flags=_FAST), at, align=4)
        return context.get_dummy_value()

    return types.void(array, index, v0, v1, v2, v3, v4, v5, v6, v7), generate


def _define_operator(python_operator, instruction):
    @intrinsic
    def operate(typing, left, right):
        def generate(context, builder, signature, arguments):
            left, right = _as_vectors(context, builder, arguments, signature.args)
            return getattr(builder, instruction)(left, right, flags=_FAST)

        return VECTOR(left, right), generate

    @overload(python_operator)
    def _(left, right):
        if isinstance(left, VectorType) or isinstance(right, VectorType):
            return lambda left, right: operate(left, right)
        return None


for _python_operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"),
    (operator.isub, "fsub"),
    (operator.imul, "fmul"),
):
    _define_operator(_python_operator, _instruction)


def _define_prefetch(for_writing):
    @intrinsic
    def prefetch(typing, array, index):
        def generate(context, builder, signature, arguments):
            at = _address(context, builder, signature.args[0], arguments[0], arguments[1], signature.args[1])
            byte = ir.IntType(8).as_pointer()
            kind = ir.FunctionType(ir.VoidType(), [byte, _INT32, _INT32, _INT32])
            function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
            options = [ir.Constant(_INT32, value) for value in (int(for_writing), 3, 1)]
            builder.call(function, [builder.bitcast(at, byte), *options])
            return context.get_dummy_value()

        return types.void(array, index), generate

    return prefetch


prefetch_to_read = _define_prefetch(for_writing=False)
prefetch_to_write = _define_prefetch(for_writing=True)


@intrinsic
def fetch_add(typing, array, index, amount):
    """array[index] += amount as one atomic operation on a flat int64 array; returns the value before."""

    def generate(context, builder, signature, arguments):
        at = _address(context, builder, signature.args[0], arguments[0], arguments[1], signature.args[1])
        step = context.cast(builder, arguments[2], signature.args[2], types.int64)
        return builder.atomic_rmw("add", at, step, "monotonic")

    return types.int64(array, index, amount), generate
