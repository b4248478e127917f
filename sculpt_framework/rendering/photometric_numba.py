"""L1 + D-SSIM with its gradient in two fused passes, for the CPU: numpy and numba only.

The image is read as rows of width x channels numbers, so that every inner loop runs over contiguous memory: a vertical
tap is another row, a horizontal tap is ``channels`` numbers further on. Each thread works on whole rows.
"""

import numpy as np
from numba import njit, prange

_OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}
RADIUS = 5
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_MEANS = 5
_PARTIALS = 3


@njit(**_OPTIONS)
def _add_row(weight, source, total):
    for i in range(source.shape[0]):
        total[i] += weight * source[i]


@njit(**_OPTIONS)
def _add_moments(weight, x, y, sums):
    """Weighted x, y, x^2, y^2, xy of one row onto the five rows of ``sums``."""
    mean_x, mean_y, square_x, square_y, product = sums[0], sums[1], sums[2], sums[3], sums[4]
    for i in range(x.shape[0]):
        a, b = weight * x[i], weight * y[i]
        mean_x[i] += a
        mean_y[i] += b
        square_x[i] += a * x[i]
        square_y[i] += b * y[i]
        product[i] += a * y[i]


@njit(**_OPTIONS)
def _blur_along(window, padded, channels, out):
    """Horizontal taps of a row that has RADIUS pixels of zeros at both ends."""
    count = out.shape[0]
    out[:] = np.float32(0.0)
    for tap in range(2 * RADIUS + 1):
        _add_row(window[tap], padded[tap * channels : tap * channels + count], out)


@njit(parallel=True, **_OPTIONS)
def similarity(x, y, channels, window, partials, row_ssim, row_l1):
    """Sums over each row of SSIM and |x - y|, and the partial derivatives of SSIM by the blurred x, x^2 and xy.

    x and y are [h, w * channels]; ``partials`` is [3, h, w * channels].
    """
    height, width = x.shape
    edge = RADIUS * channels
    for row in prange(height):
        sums = np.zeros((_MEANS, width + 2 * edge), np.float32)
        blurred = np.empty((_MEANS, width), np.float32)
        inner = sums[:, edge : edge + width]
        for tap in range(2 * RADIUS + 1):
            source = row + tap - RADIUS
            if 0 <= source < height:
                _add_moments(window[tap], x[source], y[source], inner)
        for moment in range(_MEANS):
            _blur_along(window, sums[moment], channels, blurred[moment])
        mx, my, exx, eyy, exy = blurred[0], blurred[1], blurred[2], blurred[3], blurred[4]
        by_mean, by_square, by_product = partials[0, row], partials[1, row], partials[2, row]
        a_row, b_row = x[row], y[row]
        total, absolute = np.float32(0.0), np.float32(0.0)
        for i in range(width):
            m1, m2 = mx[i], my[i]
            a1 = np.float32(2.0) * m1 * m2 + _C1
            a2 = np.float32(2.0) * (exy[i] - m1 * m2) + _C2
            b1 = m1 * m1 + m2 * m2 + _C1
            b2 = exx[i] - m1 * m1 + eyy[i] - m2 * m2 + _C2
            inverse = np.float32(1.0) / (b1 * b2)
            ssim = a1 * a2 * inverse
            over_b2 = ssim * b1 * inverse
            by_product[i] = np.float32(2.0) * a1 * inverse
            by_square[i] = -over_b2
            by_mean[i] = np.float32(2.0) * (m2 * (a2 - a1) * inverse + m1 * (over_b2 - ssim * b2 * inverse))
            total += ssim
            absolute += abs(a_row[i] - b_row[i])
        row_ssim[row] = total
        row_l1[row] = absolute


@njit(parallel=True, **_OPTIONS)
def gradient(x, y, channels, window, partials, weight_l1, weight_ssim, out):
    """d/dx of weight_l1 * sum |x - y| + weight_ssim * sum SSIM. The blur is its own adjoint."""
    height, width = x.shape
    edge = RADIUS * channels
    for row in prange(height):
        sums = np.zeros((_PARTIALS, width + 2 * edge), np.float32)
        blurred = np.empty((_PARTIALS, width), np.float32)
        inner = sums[:, edge : edge + width]
        for tap in range(2 * RADIUS + 1):
            source = row + tap - RADIUS
            if 0 <= source < height:
                for partial in range(_PARTIALS):
                    _add_row(window[tap], partials[partial, source], inner[partial])
        for partial in range(_PARTIALS):
            _blur_along(window, sums[partial], channels, blurred[partial])
        by_mean, by_square, by_product = blurred[0], blurred[1], blurred[2]
        a_row, b_row, target = x[row], y[row], out[row]
        for i in range(width):
            difference = a_row[i] - b_row[i]
            sign = np.float32(difference > 0) - np.float32(difference < 0)
            slope = by_mean[i] + np.float32(2.0) * a_row[i] * by_square[i] + b_row[i] * by_product[i]
            target[i] = weight_l1 * sign + weight_ssim * slope
