"""Colours by direction and their gradient, one Gaussian after the other, for the CPU.

In torch every harmonic is an array over all Gaussians, and so is every product that backpropagation keeps of them: ten
times the memory traffic of the coefficients themselves. Here they stay in registers.
"""

import math

import numpy as np
from numba import njit, prange

# No "nnan" and "ninf": what is not finite has to show in its Gaussian's colour.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc"}, "error_model": "numpy", "cache": True, "nogil": True}
_ZERO, _HALF, _TWO, _THREE, _FOUR = (np.float32(value) for value in (0, 0.5, 2, 3, 4))
_Y0 = np.float32(0.5 / math.sqrt(math.pi))
_Y1 = np.float32(math.sqrt(3 / (4 * math.pi)))
_Y2, _Y2_SQUARES, _Y2_AXIS = (np.float32(k * math.sqrt(n / math.pi)) for k, n in ((0.5, 15), (0.25, 15), (0.25, 5)))
_Y3_OUTER, _Y3_MIDDLE = np.float32(0.25 * math.sqrt(17.5 / math.pi)), np.float32(0.25 * math.sqrt(10.5 / math.pi))
_Y3, _Y3_SQUARES = np.float32(0.5 * math.sqrt(105 / math.pi)), np.float32(0.25 * math.sqrt(105 / math.pi))
_Y3_AXIS = np.float32(0.25 * math.sqrt(7 / math.pi))


@njit(forceinline=True, **_OPTIONS)
def _direction(means, position, n):
    """From the camera to a mean, and 1 / distance; 0 where the mean is at the camera."""
    x, y, z = means[n, 0] - position[0], means[n, 1] - position[1], means[n, 2] - position[2]
    squared = x * x + y * y + z * z
    inverse = np.float32(1) / np.sqrt(squared) if squared != _ZERO else _ZERO
    return x * inverse, y * inverse, z * inverse, inverse


@njit(forceinline=True, **_OPTIONS)
def _harmonics(x, y, z):
    xx, yy, zz = x * x, y * y, z * z
    return (
        _Y0,
        -_Y1 * y,
        _Y1 * z,
        -_Y1 * x,
        _Y2 * x * y,
        -_Y2 * y * z,
        _Y2_AXIS * (_TWO * zz - xx - yy),
        -_Y2 * x * z,
        _Y2_SQUARES * (xx - yy),
        -_Y3_OUTER * y * (_THREE * xx - yy),
        _Y3 * x * y * z,
        -_Y3_MIDDLE * y * (_FOUR * zz - xx - yy),
        _Y3_AXIS * z * (_TWO * zz - _THREE * xx - _THREE * yy),
        -_Y3_MIDDLE * x * (_FOUR * zz - xx - yy),
        _Y3_SQUARES * z * (xx - yy),
        -_Y3_OUTER * x * (xx - _THREE * yy),
    )


@njit(forceinline=True, **_OPTIONS)
def _slopes(x, y, z):
    """Derivatives of the harmonics, as the polynomials they are, by x, y and z."""
    xx, yy, zz = x * x, y * y, z * z
    six, eight = np.float32(6), np.float32(8)
    by_x = (
        _ZERO, _ZERO, _ZERO, -_Y1,
        _Y2 * y, _ZERO, -_TWO * _Y2_AXIS * x, -_Y2 * z, _TWO * _Y2_SQUARES * x,
        -six * _Y3_OUTER * x * y, _Y3 * y * z, _TWO * _Y3_MIDDLE * x * y, -six * _Y3_AXIS * x * z,
        -_Y3_MIDDLE * (_FOUR * zz - _THREE * xx - yy), _TWO * _Y3_SQUARES * x * z, -_THREE * _Y3_OUTER * (xx - yy),
    )  # fmt: skip
    by_y = (
        _ZERO, -_Y1, _ZERO, _ZERO,
        _Y2 * x, -_Y2 * z, -_TWO * _Y2_AXIS * y, _ZERO, -_TWO * _Y2_SQUARES * y,
        -_THREE * _Y3_OUTER * (xx - yy), _Y3 * x * z, -_Y3_MIDDLE * (_FOUR * zz - xx - _THREE * yy),
        -six * _Y3_AXIS * y * z, _TWO * _Y3_MIDDLE * x * y, -_TWO * _Y3_SQUARES * y * z, six * _Y3_OUTER * x * y,
    )  # fmt: skip
    by_z = (
        _ZERO, _ZERO, _Y1, _ZERO,
        _ZERO, -_Y2 * y, _FOUR * _Y2_AXIS * z, -_Y2 * x, _ZERO,
        _ZERO, _Y3 * x * y, -eight * _Y3_MIDDLE * y * z, _THREE * _Y3_AXIS * (_TWO * zz - xx - yy),
        -eight * _Y3_MIDDLE * x * z, _Y3_SQUARES * (xx - yy), _ZERO,
    )  # fmt: skip
    return by_x, by_y, by_z


@njit(parallel=True, **_OPTIONS)
def shade(sh, means, position, rgb, clamped):
    """Fill ``rgb`` [g, 3], and ``clamped`` [g, 3] where it would be negative, for ``sh`` [g, b, 3]."""
    for n in prange(sh.shape[0]):
        x, y, z, _ = _direction(means, position, n)
        harmonics = _harmonics(x, y, z)
        red, green, blue = _HALF, _HALF, _HALF
        for b in range(sh.shape[1]):
            red += harmonics[b] * sh[n, b, 0]
            green += harmonics[b] * sh[n, b, 1]
            blue += harmonics[b] * sh[n, b, 2]
        clamped[n, 0], clamped[n, 1], clamped[n, 2] = red < _ZERO, green < _ZERO, blue < _ZERO
        rgb[n, 0] = _ZERO if clamped[n, 0] else red
        rgb[n, 1] = _ZERO if clamped[n, 1] else green
        rgb[n, 2] = _ZERO if clamped[n, 2] else blue


@njit(parallel=True, **_OPTIONS)
def shade_backward(sh, means, position, clamped, to_rgb, to_sh, to_means):
    """Fill the gradients by ``sh`` and, unless ``to_means`` is empty, by ``means``."""
    for n in prange(sh.shape[0]):
        x, y, z, inverse = _direction(means, position, n)
        harmonics = _harmonics(x, y, z)
        red = _ZERO if clamped[n, 0] else to_rgb[n, 0]
        green = _ZERO if clamped[n, 1] else to_rgb[n, 1]
        blue = _ZERO if clamped[n, 2] else to_rgb[n, 2]
        for b in range(sh.shape[1]):
            to_sh[n, b, 0] = harmonics[b] * red
            to_sh[n, b, 1] = harmonics[b] * green
            to_sh[n, b, 2] = harmonics[b] * blue
        if to_means.shape[0] > 0:
            by_x, by_y, by_z = _slopes(x, y, z)
            to_x, to_y, to_z = _ZERO, _ZERO, _ZERO
            for b in range(1, sh.shape[1]):
                weight = sh[n, b, 0] * red + sh[n, b, 1] * green + sh[n, b, 2] * blue
                to_x += by_x[b] * weight
                to_y += by_y[b] * weight
                to_z += by_z[b] * weight
            # Of the unit vector by the mean: what is along it has no effect.
            along = to_x * x + to_y * y + to_z * z
            to_means[n, 0] = (to_x - along * x) * inverse
            to_means[n, 1] = (to_y - along * y) * inverse
            to_means[n, 2] = (to_z - along * z) * inverse
