"""What kernels share that draw Gaussians met by rays, a row of a tile's pixels at a time, on the CPU."""

from numba import njit

OPTIONS = {"fastmath": {"nsz", "contract"}, "error_model": "numpy", "cache": True, "nogil": True}
TILE = 16
BANDS = 8
"""Of tile rows, whose sums are kept apart: they do not depend on the number of threads."""
ALPHA_MIN, ALPHA_MAX, LEFT_MIN = 1.0 / 255.0, 0.99, 1e-4
NEAR, FAR = 0.2, 1000.0
"""Of what depths are mapped to for the distortion: m = far / (far - near) (1 - near / z), object units."""
MAP = FAR / (FAR - NEAR)


@njit(forceinline=True)
def exponential(y):
    """e^y for -6 <= y <= 0, relative error 1e-8: the sixteenth power of a short series.

    An opacity of at least ``ALPHA_MIN`` leaves no larger range, and without a call the loop around it becomes vector
    instructions.
    """
    y = y / 16
    p = 1 + y * (1 + y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + y * (1 / 720 + y * (1 / 5040)))))))
    p = p * p
    p = p * p
    p = p * p
    return p * p
