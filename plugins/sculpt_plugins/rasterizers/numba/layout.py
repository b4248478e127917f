"""Sizes and column numbers the kernels agree on."""

import math

import numpy as np

BLOCK = 4
"""Pixels along a block's side; a block's pixels fill one vector."""
TILE = 16
"""Pixels along a tile's side. A tile's blocks fill one vector, too, so that one test of a Gaussian finds them all."""
LANES = 16
PIXELS = TILE * TILE
"""Stored block by block: pixel 16 b + l is lane l of block b."""

# A Gaussian's record, one cache line up to 8 features. With d = pixel - mean and u = SLANT dx + STEEP dy, the eighth
# part of log2(alpha) is LEVEL + CURVE dx^2 - u^2: a completed square, which cannot cancel to something positive.
MEAN_X, MEAN_Y = 0, 1
CURVE, SLANT, STEEP, LEVEL = 2, 3, 4, 5
DEPTH = 6
SLOT = 7
"""Gradient row in band 0 (see backward.py), an integer in the float's bits."""
FEATURES = 8

# A row of sums over pixels of s = alpha dL/dalpha and of the weights w.
SUM_X, SUM_U, SUM_XX, SUM_XU, SUM_UU, SUM_ONE, SUM_DEPTH, SUM_FEATURES = range(8)

NEAR = np.float32(1e-2)
ALPHA_MIN = np.float32(1.0 / 255.0)
TRANSMITTANCE_MIN = np.float32(1e-4)
LARGEST = np.float32(1e18)
"""A Gaussian with a projected value beyond this is not drawn: its squares would leave the range of float32."""

EIGHTH = math.log2(math.e) / 16.0
"""Turns d^T K d into the eighth part of a base-2 exponent: exp(-q / 2) = 2 ** (8 * -EIGHTH * q)."""


def record_width(channels: int) -> int:
    """Floats per record: whole cache lines."""
    return 16 * math.ceil((FEATURES + channels) / 16)


def sums_width(channels: int) -> int:
    """Floats per gradient row: half a cache line for one feature, one for up to six, then eight features at a time."""
    if channels == 1:
        return 8
    return 16 + 8 * math.ceil(max(channels - 6, 0) / 8)
