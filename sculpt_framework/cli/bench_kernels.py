"""Kernels of ``sculpt-bench``: what the CPU could do at best, and how much there is to do."""

import math

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 16
"""Floats of a vector; LLVM makes as many registers of it as the processor needs."""
_FLOAT = ir.FloatType()
_VECTOR = ir.VectorType(_FLOAT, LANES)
_UNROLLED = 64


def _define_rounds(chains):
    @intrinsic
    def rounds(typing, array):
        """_UNROLLED times x = 0.5 x + 1 on each of the array's ``chains`` vectors, which depend on nothing else."""

        def generate(context, builder, signature, arguments):
            data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
            kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
            fma = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{LANES}f32")
            half, one = (ir.Constant(_VECTOR, [value] * LANES) for value in (0.5, 1.0))
            places = [
                builder.bitcast(builder.gep(data, [ir.Constant(ir.IntType(64), chain * LANES)]), _VECTOR.as_pointer())
                for chain in range(chains)
            ]
            values = [builder.load(place, align=4) for place in places]
            for _ in range(_UNROLLED):
                values = [builder.call(fma, [value, half, one]) for value in values]
            for value, place in zip(values, places, strict=True):
                builder.store(value, place, align=4)
            return context.get_dummy_value()

        return types.void(array), generate

    return rounds


_rounds_of_6, _rounds_of_10 = _define_rounds(6), _define_rounds(10)


@njit
def _repeat_6(array, times):
    for _ in range(times):
        _rounds_of_6(array)  # pyright: ignore[reportCallIssue] - numba passes the typing context


@njit
def _repeat_10(array, times):
    for _ in range(times):
        _rounds_of_10(array)  # pyright: ignore[reportCallIssue]


WAYS = ((6, _repeat_6), (10, _repeat_10))
"""Vectors at a time, and the function of an array of them: some processors want more, others have not the registers."""


def operations_of(chains: int, times: int) -> int:
    """Additions and multiplications of a call."""
    return 2 * times * _UNROLLED * chains * LANES


@njit
def count_pairs(table, width, height, alpha_min, transmittance_min, alpha_max):
    """Pairs of a pixel and a Gaussian that add to the image; rows by depth: mean, conic, opacity, reach (g, 8)."""
    left = np.ones((height, width), np.float32)
    pairs = 0
    for i in range(table.shape[0]):
        x, y, xx, xy, yy, opacity = table[i, 0], table[i, 1], table[i, 2], table[i, 3], table[i, 4], table[i, 5]
        for row in range(max(math.floor(y - table[i, 6 + 1]), 0), min(math.ceil(y + table[i, 6 + 1]), height)):
            for column in range(max(math.floor(x - table[i, 6]), 0), min(math.ceil(x + table[i, 6]), width)):
                dx, dy = column + 0.5 - x, row + 0.5 - y
                alpha = opacity * math.exp(-0.5 * (xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy))
                if alpha >= alpha_min and left[row, column] >= transmittance_min:
                    left[row, column] *= 1.0 - min(alpha, alpha_max)
                    pairs += 1
    return pairs
