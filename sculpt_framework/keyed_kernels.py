"""Adam on rows that have each taken a number of steps of their own, for the CPU."""

import math

import numpy as np
from numba import njit, prange

# No "nnan": a gradient that is not a number has to show in its row.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc"}, "error_model": "numpy", "cache": True, "nogil": True}
_ONE = np.float32(1)


@njit(parallel=True, **_OPTIONS)
def adam(values, gradients, first, second, steps, rates, beta1, beta2, eps):
    """Move ``values`` (n, c) and both moments. ``rates`` is by number of steps, bias correction included."""
    for i in prange(values.shape[0]):
        rate = rates[np.int64(steps[i])]
        for c in range(values.shape[1]):
            gradient = gradients[i, c]
            mean = first[i, c] + (gradient - first[i, c]) * (_ONE - beta1)
            square = second[i, c] * beta2 + gradient * gradient * (_ONE - beta2)
            first[i, c] = mean
            second[i, c] = square
            values[i, c] -= mean / (math.sqrt(square) + eps) * rate
