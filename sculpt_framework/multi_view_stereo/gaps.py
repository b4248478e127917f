"""Gaps in depth maps, bridged by the planes around them.

Plain, glossy and dark pixels have no depth of their own, but most of them lie on the surface that their neighbours
show. Without these depths nothing would speak for the space in front of such pixels, and the fused shape would be the
visual hull there.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sculpt_framework.cpu_kernels import kernel_cache
from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps
from sculpt_framework.threads import in_threads

with kernel_cache("gaps", Path(__file__).with_name("gap_kernels.py")):
    from sculpt_framework.multi_view_stereo import gap_kernels as kernels

_REACH = 6
"""Pixels to each side of a pixel without depth in which planes are looked for."""
_LEAST = np.float32(0.4)
"""Share of the object's pixels there that must have one."""
_ALIKE = np.float32(0.6)
"""Share of these planes that must have nearly the same depth at the pixel. At the edge between two surfaces they have
not."""
_ROUNDS = 6
"""A gap is closed from its edge inwards, a few pixels each time: the middle of a wide one stays open."""


def bridged(maps: DepthMaps, near: float) -> DepthMaps:
    """The maps with depths in small gaps and along the edges of large ones, within the masks.

    Each is the median of the depths at which the planes of the pixels around meet the line of sight, of which three
    fifths or more must lie within ``near`` of it, in object units. What is known stays as it is.
    """
    depths, normals, confidence = maps.depths.copy(), maps.normals.copy(), maps.confidence.copy()

    def bridge(i: int) -> None:
        found, turned, sureness = np.zeros_like(depths[i]), np.zeros_like(normals[i]), np.zeros_like(depths[i])
        for _ in range(_ROUNDS):
            kernels.bridge(
                depths[i], normals[i], confidence[i], maps.views.inside[i], maps.views.lenses[i], _REACH, _LEAST,
                np.float32(near), _ALIKE, found, turned, sureness,
            )  # fmt: skip
            new = found > 0
            if not new.any():
                break
            depths[i][new], normals[i][new], confidence[i][new] = found[new], turned[new], sureness[new]

    in_threads(bridge, range(len(maps.views)))
    return replace(maps, depths=depths, normals=normals, confidence=confidence)
