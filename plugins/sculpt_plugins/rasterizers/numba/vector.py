"""A vector of 16 float32 for numba kernels.

numba leaves the pixel loops scalar (wrap-around indices, branches, aliasing). The operations here emit LLVM's
``<16 x float>`` directly; LLVM maps it to one AVX-512, two AVX2 or four SSE or NEON registers, whichever there are.
"""

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

from .layout import LANES, TILE_WIDTH

_FLOAT = ir.FloatType()
_INT32 = ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, LANES)
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


def _as_vectors(context, builder, values, signature):
    return [_as_vector(context, builder, value, kind) for value, kind in zip(values, signature.args, strict=True)]


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
def splat(typing, value):
    """A vector of copies."""

    def generate(context, builder, signature, arguments):
        return _as_vector(context, builder, arguments[0], signature.args[0])

    return VECTOR(value), generate


@intrinsic
def lane_column(typing):
    """Column of each lane within the tile."""

    def generate(context, builder, signature, arguments):
        return ir.Constant(_VECTOR, [float(lane % TILE_WIDTH) for lane in range(LANES)])

    return VECTOR(), generate


@intrinsic
def lane_row(typing):
    """Row of each lane within its block."""

    def generate(context, builder, signature, arguments):
        return ir.Constant(_VECTOR, [float(lane // TILE_WIDTH) for lane in range(LANES)])

    return VECTOR(), generate


@intrinsic
def larger(typing, left, right):
    """Elementwise maximum."""

    def generate(context, builder, signature, arguments):
        left, right = _as_vectors(context, builder, arguments, signature)
        return builder.select(builder.fcmp_ordered(">", left, right, flags=_FAST), left, right)

    return VECTOR(left, right), generate


@intrinsic
def smaller(typing, left, right):
    """Elementwise minimum."""

    def generate(context, builder, signature, arguments):
        left, right = _as_vectors(context, builder, arguments, signature)
        return builder.select(builder.fcmp_ordered("<", left, right, flags=_FAST), left, right)

    return VECTOR(left, right), generate


@intrinsic
def where_at_least(typing, value, limit, chosen, other):
    """chosen where value >= limit, else other."""

    def generate(context, builder, signature, arguments):
        value, limit, chosen, other = _as_vectors(context, builder, arguments, signature)
        return builder.select(builder.fcmp_ordered(">=", value, limit), chosen, other)

    return VECTOR(value, limit, chosen, other), generate


@intrinsic
def any_at_least(typing, value, limit):
    """Whether value >= limit in some lane."""

    def generate(context, builder, signature, arguments):
        value, limit = _as_vectors(context, builder, arguments, signature)
        bits = builder.bitcast(builder.fcmp_ordered(">=", value, limit), _MASK_BITS)
        return builder.icmp_unsigned("!=", bits, ir.Constant(_MASK_BITS, 0))

    return types.boolean(value, limit), generate


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
            left, right = _as_vectors(context, builder, arguments, signature)
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
