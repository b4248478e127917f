"""Adam on whole tensors, and on rows that have each taken a number of steps of their own, for the CPU."""

import math

import numpy as np
from numba import njit, prange

# No "nnan": a gradient that is not a number has to show in its row.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc"}, "error_model": "numpy", "cache": True, "nogil": True}
_ONE = np.float32(1)


@njit(forceinline=True, **_OPTIONS)
def _move(values, gradients, first, second, at, rate, beta1, beta2, eps):
    gradient = gradients[at]
    mean = first[at] + (gradient - first[at]) * (_ONE - beta1)
    square = second[at] * beta2 + gradient * gradient * (_ONE - beta2)
    first[at] = mean
    second[at] = square
    values[at] -= mean / (math.sqrt(square) + eps) * rate


@njit(parallel=True, **_OPTIONS)
def move_rows(values, gradients, first, second, steps, rates, beta1, beta2, eps):
    """Move ``values`` (n, c) and both moments. ``rates`` is by number of steps, bias correction included."""
    for i in prange(values.shape[0]):
        rate = rates[np.int64(steps[i])]
        for c in range(values.shape[1]):
            _move(values, gradients, first, second, (i, c), rate, beta1, beta2, eps)


@njit(parallel=True, **_OPTIONS)
def move_all(values, gradients, first, second, rate, beta1, beta2, eps):
    """Move ``values`` (n) and both moments. ``rate`` has its bias correction."""
    for i in prange(values.shape[0]):
        _move(values, gradients, first, second, i, rate, beta1, beta2, eps)
