"""Vectors of three numbers, as tuples, and what both directions need of a face. For the CPU's kernels."""

import math

import numpy as np
from numba import njit

from .limits import SQUARE

# No "nnan" and "ninf": a vertex that is not a number has to show in its Gaussians.
OPTIONS = {
    "fastmath": {"nsz", "arcp", "contract", "reassoc"},
    "error_model": "numpy",
    "cache": True,
    "nogil": True,
}
ZERO, ONE, TWO, HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
THIRD, TWO_THIRDS, ROOT_THIRD = np.float32(1 / 3), np.float32(2 / 3), np.float32(1 / math.sqrt(3.0))
# Functions of arrays are inlined: a call would count references to each of them, atomically.

CHUNK = 1024
"""Faces that a thread takes at a time; what is added up within them does not depend on the number of threads."""
_SQUARE, _FOURTH_POWER = np.float32(SQUARE), np.float32(SQUARE * SQUARE)


@njit(**OPTIONS)
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**OPTIONS)
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**OPTIONS)
def scaled(a, factor):
    return a[0] * factor, a[1] * factor, a[2] * factor


@njit(**OPTIONS)
def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(**OPTIONS)
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(**OPTIONS)
def unit(a):
    """Direction, and the length, rounded off far below any that counts."""
    size = math.sqrt(dot(a, a) + _FOURTH_POWER)
    return scaled(a, ONE / size), size


@njit(**OPTIONS)
def through_unit(to_direction, direction, size):
    """Gradient by a vector of what depends on its direction; the length is rounded off in any way."""
    return scaled(minus(to_direction, scaled(direction, dot(to_direction, direction))), ONE / size)


@njit(**OPTIONS)
def length(a):
    """Rounded off at the shortest length that is told from zero."""
    return math.sqrt(dot(a, a) + _SQUARE)


@njit(forceinline=True, **OPTIONS)
def row(array, index):
    return array[index, 0], array[index, 1], array[index, 2]


@njit(**OPTIONS)
def reference(edge, other, normal, steiner):
    """Both reference radii, as vectors in space."""
    if steiner:
        return scaled(edge, ROOT_THIRD), scaled(minus(other, scaled(edge, HALF)), TWO_THIRDS)
    along, _ = unit(edge)
    return scaled(edge, HALF), scaled(cross(normal, along), HALF * length(other))


@njit(**OPTIONS)
def flat_reference(x, p, q, other, steiner):
    """Entries (0, 0), (0, 1), (1, 1) of the reference radii in the face's frame; the fourth is 0."""
    if steiner:
        return x * ROOT_THIRD, (TWO * p - x) * THIRD, TWO_THIRDS * q
    return HALF * x, ZERO, HALF * length(other)
