"""Sizes and column numbers the kernels agree on."""

import math

import numpy as np

TILE_WIDTH = 8
TILE_HEIGHT = 16
LANES = 16
"""Floats in a vector: two rows of a tile. Filling 16 lanes with two rows is what counts, not the tile's size."""
BLOCK_ROWS = LANES // TILE_WIDTH
BLOCKS = TILE_HEIGHT // BLOCK_ROWS
"""Vectors in a tile; each is a block of two rows."""
PIXELS = TILE_WIDTH * TILE_HEIGHT

# A Gaussian's record, one cache line up to 7 features. With d = pixel - mean and u = SLANT dx + STEEP dy, the eighth
# part of log2(alpha) is LEVEL + CURVE dx^2 - u^2: a completed square, which cannot cancel to something positive.
MEAN_X, MEAN_Y = 0, 1
CURVE, SLANT, STEEP, LEVEL = 2, 3, 4, 5
DEPTH = 6
ROWS = 7
"""First and last row of pixels it reaches, 16 bits each, in the float's bits."""
SLOT = 8
"""Gradient row in band 0 (see backward.py), an integer in the float's bits."""
FEATURES = 9

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
