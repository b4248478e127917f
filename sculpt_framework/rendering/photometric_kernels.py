"""Value and gradient of the L1 + D-SSIM loss in one go, for the CPU.

An image of c channels is a matrix of rows of width x c floats, in which the neighbour k pixels along lies k c floats
further: every loop runs over contiguous floats and is left to the compiler to vectorise. It does so while few arrays
take part in a loop, which is why sums of eleven terms are made in three steps, and while numba knows a row to be
contiguous, which it does for the last axis of a whole array.
"""

import numpy as np
from numba import njit, prange

_RADIUS = 5
"""The window has 2 * 5 + 1 pixels (WINDOW in photometric.py) and is the same forwards and backwards."""
_TAPS = 2 * _RADIUS + 1
_WEIGHTS = np.exp(-((np.arange(_TAPS) - _RADIUS) ** 2) / (2.0 * 1.5**2))
_WEIGHTS /= _WEIGHTS.sum()
_W0, _W1, _W2, _W3, _W4, _W5 = (np.float32(weight) for weight in _WEIGHTS[_RADIUS:])
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_OPTIONS = {"fastmath": True, "error_model": "numpy", "cache": True, "nogil": True}


@njit(**_OPTIONS)
def _blur_row(source, step, out):
    """Window along a row; ``source`` has the row's floats with ``5 * step`` zeros before and after."""
    n = out.shape[0]
    center = source[_RADIUS * step : _RADIUS * step + n]
    left, right = source[4 * step : 4 * step + n], source[6 * step : 6 * step + n]
    for j in range(n):
        out[j] = _W0 * center[j] + _W1 * (left[j] + right[j])
    left, right = source[3 * step : 3 * step + n], source[7 * step : 7 * step + n]
    farther_left, farther_right = source[2 * step : 2 * step + n], source[8 * step : 8 * step + n]
    for j in range(n):
        out[j] += _W2 * (left[j] + right[j]) + _W3 * (farther_left[j] + farther_right[j])
    left, right = source[step : step + n], source[9 * step : 9 * step + n]
    farther_left, farther_right = source[:n], source[10 * step : 10 * step + n]
    for j in range(n):
        out[j] += _W4 * (left[j] + right[j]) + _W5 * (farther_left[j] + farther_right[j])


@njit(**_OPTIONS)
def _blur_column(ring, q, middle, out):
    """Window across rows ``middle - 5 ... middle + 5`` of quantity q in a ring of 11 rows of quantities."""
    n = out.shape[0]
    center = ring[middle % _TAPS, q]
    above, below = ring[(middle - 1) % _TAPS, q], ring[(middle + 1) % _TAPS, q]
    for j in range(n):
        out[j] = _W0 * center[j] + _W1 * (above[j] + below[j])
    above, below = ring[(middle - 2) % _TAPS, q], ring[(middle + 2) % _TAPS, q]
    far_above, far_below = ring[(middle - 3) % _TAPS, q], ring[(middle + 3) % _TAPS, q]
    for j in range(n):
        out[j] += _W2 * (above[j] + below[j]) + _W3 * (far_above[j] + far_below[j])
    above, below = ring[(middle - 4) % _TAPS, q], ring[(middle + 4) % _TAPS, q]
    far_above, far_below = ring[(middle - 5) % _TAPS, q], ring[(middle + 5) % _TAPS, q]
    for j in range(n):
        out[j] += _W4 * (above[j] + below[j]) + _W5 * (far_above[j] + far_below[j])


@njit(**_OPTIONS)
def _blur_products(x_row, y_row, step, padded, out):
    """x, y, x^2 + y^2 and x y of a row, blurred along it."""
    n, pad = x_row.shape[0], _RADIUS * step
    x, y = padded[0, pad : pad + n], padded[1, pad : pad + n]
    squares, product = padded[2, pad : pad + n], padded[3, pad : pad + n]
    for j in range(n):
        x[j] = x_row[j]
        y[j] = y_row[j]
    for j in range(n):
        squares[j] = x[j] * x[j] + y[j] * y[j]
        product[j] = x[j] * y[j]
    for q in range(4):
        _blur_row(padded[q], step, out[q])


@njit(**_OPTIONS)
def _distance(x, y):
    total = _ZERO
    for j in range(x.shape[0]):
        total += abs(x[j] - y[j])
    return total


@njit(**_OPTIONS)
def _differentiate_row(x, y, blurred, weight_l1, weight_ssim, out):
    """The chain rule through the means of x, x^2 + y^2 and x y, plus the sign of the difference."""
    by_mean, by_squares, by_product = blurred[0], blurred[1], blurred[2]
    for j in range(out.shape[0]):
        out[j] = weight_ssim * (by_mean[j] + _TWO * x[j] * by_squares[j] + y[j] * by_product[j])
    for j in range(out.shape[0]):
        distance = x[j] - y[j]
        out[j] += weight_l1 if distance > _ZERO else (-weight_l1 if distance < _ZERO else _ZERO)


@njit(**_OPTIONS)
def _compare_row(blurred, by_mean, by_squares, by_product):
    """SSIM summed over a row, and its derivatives by the blurred x, x^2 + y^2 and x y of each pixel.

    ``blurred`` is (4, n): x, y, x^2 + y^2, x y. The outputs may lie anywhere but on each other.
    """
    n = blurred.shape[1]
    mean_x, mean_y, squares, product = blurred[0], blurred[1], blurred[2], blurred[3]
    total = _ZERO
    # Three loops and not one: see the head of this file. by_squares carries the structure term in between.
    for j in range(n):
        means_product = mean_x[j] * mean_y[j]
        means_squared = mean_x[j] * mean_x[j] + mean_y[j] * mean_y[j]
        product[j] = _TWO * (product[j] - means_product) + _C2
        squares[j] = _ONE / (squares[j] - means_squared + _C2)
    for j in range(n):
        inverse = _ONE / (mean_x[j] * mean_x[j] + mean_y[j] * mean_y[j] + _C1)
        luminance = (_TWO * mean_x[j] * mean_y[j] + _C1) * inverse
        structure = product[j] * squares[j]
        total += luminance * structure
        by_mean[j] = _TWO * (
            structure * (mean_y[j] - luminance * mean_x[j]) * inverse
            + luminance * (structure * mean_x[j] - mean_y[j]) * squares[j]
        )
    for j in range(n):
        luminance = (_TWO * mean_x[j] * mean_y[j] + _C1) / (mean_x[j] * mean_x[j] + mean_y[j] * mean_y[j] + _C1)
        by_product[j] = _TWO * luminance * squares[j]
    for j in range(n):
        by_squares[j] = -np.float32(0.5) * by_product[j] * product[j] * squares[j]
    return total


@njit(parallel=True, **_OPTIONS)
def compare(image, target, step, strips, weight_l1, weight_ssim, similarity, difference, gradient):
    """Sums over each row of SSIM and of |x - y|, and the gradient of the weighted sum of both by ``image``.

    ``image``, ``target`` and ``gradient`` are (h, width * step) with ``step`` channels; a gradient of no rows is not
    computed. ``similarity`` and ``difference`` are (h,). The rows are cut into ``strips``, which does not change the
    result; of a strip's neighbours, up to ten rows on either side are computed again.
    """
    height, n = image.shape
    pad = _RADIUS * step
    differentiate = gradient.shape[0] > 0
    halo = _RADIUS if differentiate else 0
    for strip in prange(strips):
        first, end = height * strip // strips, height * (strip + 1) // strips
        padded = np.zeros((4, n + 2 * pad), np.float32)
        # The last eleven rows, blurred along: of x, y, x^2 + y^2 and x y; of the derivatives of SSIM.
        images = np.zeros((_TAPS, 4, n), np.float32)
        derivatives = np.zeros((_TAPS, 3, n), np.float32)
        blurred = np.empty((4, n), np.float32)
        for row in range(first - halo - _RADIUS, end + halo + _RADIUS):
            if 0 <= row < height:
                _blur_products(image[row], target[row], step, padded, images[row % _TAPS])
            else:
                images[row % _TAPS] = _ZERO
            middle = row - _RADIUS
            if middle < first - halo:
                continue
            if 0 <= middle < height:
                for q in range(4):
                    _blur_column(images, q, middle, blurred[q])
                total = _compare_row(
                    blurred, padded[0, pad : pad + n], padded[1, pad : pad + n], padded[2, pad : pad + n]
                )
                if first <= middle < end:
                    similarity[middle] = total
                    difference[middle] = _distance(image[middle], target[middle])
                if differentiate:
                    for q in range(3):
                        _blur_row(padded[q], step, derivatives[middle % _TAPS, q])
            elif differentiate:
                derivatives[middle % _TAPS] = _ZERO
            last = middle - _RADIUS
            if differentiate and last >= first:
                for q in range(3):
                    _blur_column(derivatives, q, last, blurred[q])
                _differentiate_row(image[last], target[last], blurred, weight_l1, weight_ssim, gradient[last])
