"""Rendered depth maps to a closed shape: truncated signed distances, averaged (Curless and Levoy 1996)."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from sculpt_framework.cpu_kernels import array_of, kernel_cache, share_threads
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.types import Camera, Rendering

with kernel_cache("tsdf", Path(__file__).with_name("tsdf_kernels.py")):
    from sculpt_framework.shape_from_images import tsdf_kernels

_TRUNCATION = 4.0
"""Cells in front of and behind a depth within which it says how far the surface is."""
_COVERED = 0.5
"""Opacity of a pixel from which on there is something at it."""


def fuse_renderings(renderings: Iterable[tuple[Camera, Rendering]], grid: Grid) -> Volume:
    """The mean truncated distance at the corners of the grid, in object units, negative inside; cameras in its frame.

    What lies in an image, and in each behind what it shows, is inside: the shape is closed by what hides it. What lies
    in no image is outside.
    """
    share_threads()
    shape = [count + 1 for count in grid.shape]
    sums, counts, shown = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, bool)
    truncation, low = np.float32(_TRUNCATION * grid.cell), np.array(grid.origin, np.float32)
    for camera, rendering in renderings:
        covered = rendering.alpha > _COVERED
        depth = rendering.depth / rendering.alpha.clamp(min=_COVERED)
        pose = array_of(camera.world_to_camera[:3].float().cpu())
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
        tsdf_kernels.add_view(
            low, np.float32(grid.cell), pose, lens, array_of(depth.cpu()), array_of(covered.cpu()), truncation, sums,
            counts, shown,
        )  # fmt: skip
    unseen = np.where(shown, np.float32(-1), np.float32(1))
    mean = np.where(counts > 0, sums / np.maximum(counts, 1), unseen) * truncation
    x, y, z = (start - 0.5 * grid.cell for start in grid.origin)
    return Volume(values=mean, origin=(x, y, z), cell=grid.cell)


def surface_of(volume: Volume, grid: Grid, device: torch.device) -> tuple[SdfFunction, Int64[Tensor, " s"]]:
    """What an extractor takes: a volume of values at the corners of a grid as a function, and the keys, ascending, of
    the cells in which it changes its sign."""
    inside = torch.from_numpy(volume.values < 0)
    x, y, z = grid.shape
    corners = [inside[i : i + x, j : j + y, k : k + z] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    count = torch.stack(corners).sum(dim=0)
    return volume.interpolator(device), grid.corner_keys(((count > 0) & (count < 8)).nonzero()).to(device)
