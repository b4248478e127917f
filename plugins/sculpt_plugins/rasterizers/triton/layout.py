"""Sizes, limits and rows the kernels agree on.

A record describes one Gaussian on the screen: ``mean_x, mean_y, curve, slant | steep, level, depth, feature 0 |
features 1 to 4 | ...``, in quads of floats, so that a lane fetches four at once. With d = pixel - mean and
u = slant dx + steep dy, log2(alpha) is level + curve dx^2 - u^2: a completed square, which cannot cancel to something
positive however long and thin the Gaussian is.

A row of sums belongs to one entry of one tile's list. With (x, y) = pixel - centre of the tile, s = alpha dL/dalpha and
the weights w these are the ``sums of s, s x, s y, s x^2, s x y, s y^2; the centre's x and y | sums of w dL/ddepth,
w dL/dfeature 0, ...``, in quads, too.
"""

import math

import triton
import triton.language as tl

TILE = tl.constexpr(8)
"""Pixels along a tile's side."""
BLOCK = tl.constexpr(16)
"""Entries of a tile's list that are worked on at once: the least number of rows a matrix unit takes."""
GAUSSIANS = tl.constexpr(128)
"""Gaussians per program where a lane has one Gaussian to itself."""
CHANNELS = 7
"""Features in one pass, at most: with the depth they are the eight columns of a matrix unit's smallest product."""

NEAR = tl.constexpr(1e-2)
ALPHA_MIN = tl.constexpr(1.0 / 255.0)
TRANSMITTANCE_MIN = tl.constexpr(1e-4)
LARGEST = tl.constexpr(1e18)
"""A Gaussian with a projected value beyond this is not drawn: its squares would leave the range of float32."""
LOG2_OF_255 = tl.constexpr(math.log2(255.0))
HALF_LOG2_E = tl.constexpr(0.5 * math.log2(math.e))
"""exp(-q / 2) = 2 ** (-HALF_LOG2_E q)."""


def record_width(channels: int) -> int:
    """Floats per record."""
    return 8 + 4 * math.ceil((channels - 1) / 4)


def sums_width(channels: int) -> int:
    """Floats per row of sums."""
    return 8 + 4 * math.ceil((channels + 1) / 4)


@triton.jit
def split_quads(quads):
    """The columns of an (n, 4) tensor."""
    even, odd = tl.split(tl.reshape(quads, (quads.shape[0], 2, 2)))
    first, third = tl.split(even)
    second, fourth = tl.split(odd)
    return first, second, third, fourth


@triton.jit
def load_quad(pointer, offsets, mask):
    """Four floats from each of the offsets, as four tensors; zeros where masked."""
    quads = tl.load(pointer + offsets[:, None] + tl.arange(0, 4)[None, :], mask=mask[:, None], other=0.0)
    return split_quads(quads)


@triton.jit
def store_quad(pointer, offsets, first, second, third, fourth, mask):
    quads = tl.reshape(tl.join(tl.join(first, third), tl.join(second, fourth)), (offsets.shape[0], 4))
    tl.store(pointer + offsets[:, None] + tl.arange(0, 4)[None, :], quads, mask=mask[:, None])
