"""The scale constraint and its gradient by the covariances, for the CPU: what ``constraint.py`` does in torch."""

import math

import numpy as np
from numba import njit, prange

_OPTIONS = {
    "fastmath": {"nsz", "arcp", "contract", "reassoc"},
    "error_model": "numpy",
    "cache": True,
    "nogil": True,
}
_ZERO, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
CHUNK = 1024
"""Faces that are added up together, so that the sum does not depend on the number of threads."""


@njit(parallel=True, **_OPTIONS)
def excess(metric, covariance, limit, tiny, sums, gradient):
    """Fill, by chunks of faces, the sums of what the eigenvalues exceed the limit by, and their gradient.

    ``metric`` is (f, 2, 2), ``covariance`` (f, k, 2, 2); ``gradient`` has its shape, or no entries.
    """
    faces, per_face = covariance.shape[0], covariance.shape[1]
    for chunk in prange(sums.shape[0]):
        total = 0.0
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, faces)):
            a, b, c = metric[i, 0, 0], metric[i, 0, 1], metric[i, 1, 1]
            inverse = _ONE / max(a * c - b * b, tiny * tiny)
            slope, root_inverse = b / a, math.sqrt(inverse)
            for k in range(per_face):
                p, q, r = covariance[i, k, 0, 0], covariance[i, k, 0, 1], covariance[i, k, 1, 1]
                first = p / a
                second = (r - _TWO * slope * q + slope * slope * p) * a * inverse
                mixed = (q - slope * p) * root_inverse
                half = _HALF * (first - second)
                root = math.sqrt(half * half + mixed * mixed + tiny)
                above = _HALF * (first + second) + root - limit
                to_p = to_q = to_r = _ZERO
                if not above <= _ZERO:  # what is not a number shows
                    total += above
                    by_first, by_mixed = _HALF + _HALF * half / root, mixed / root * root_inverse
                    by_second = (_ONE - by_first) * a * inverse
                    to_p = by_first / a + by_second * slope * slope - by_mixed * slope
                    to_q = by_mixed - _TWO * slope * by_second
                    to_r = by_second
                if gradient.shape[0] > 0:
                    gradient[i, k, 0, 0], gradient[i, k, 0, 1] = to_p, to_q
                    gradient[i, k, 1, 0], gradient[i, k, 1, 1] = _ZERO, to_r
        sums[chunk] = total
