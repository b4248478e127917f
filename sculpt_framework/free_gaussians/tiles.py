"""Which Gaussians, exactly projected, lie in which tile of an image."""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, Int32, Int64
from numpy import ndarray
from torch import Tensor

from sculpt_framework.cpu_kernels import kernel_cache
from sculpt_framework.types import Camera

with kernel_cache("tiles", Path(__file__).with_name("tile_kernels.py")):
    from sculpt_framework.free_gaussians import tile_kernels

_NEAREST = 1e-2
"""Object units in front of the camera: Gaussians whose centre is nearer are not drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TileLists:
    lists: Int32[ndarray, " n"]
    """Gaussians of each tile, nearest first, tile by tile."""
    starts: Int64[ndarray, " t"]
    """Where those of each tile begin, and the end."""
    columns: int
    """Tiles in a row."""


def list_tiles(
    frames: Float[Tensor, "g 3 k"], limits: Float[Tensor, " g"], camera: Camera, *, tile: int, margin: float
) -> TileLists:
    """The last column of a frame is the Gaussian's centre in camera coordinates, the others its axes, each as long as
    its standard deviation: two of a disk, three of an ellipsoid. ``limits`` are the squared standard deviations that
    count; ``margin`` pixels around the centre count as well. On the CPU, in double precision.

    Gaussians behind the camera, with a frame that is not finite or without anything that counts are in no tile. The rim
    is a conic in the image, whose bounds follow from its dual; that of one which reaches behind the camera may be
    anywhere.
    """
    columns, rows = -(-camera.width // tile), -(-camera.height // tile)
    depth = frames[:, 2, -1]
    drawn = torch.isfinite(frames).all(dim=2).all(dim=1) & (depth > _NEAREST) & (limits > 0)
    signs = torch.cat([limits[:, None].expand(-1, frames.shape[2] - 1), torch.full_like(limits, -1.0)[:, None]], dim=1)
    ahead, sizes = frames[:, 2], (camera.width, camera.height)
    whole = (signs * ahead * ahead).sum(dim=1)
    low, high = [], []
    for axis, (focal, centre, size) in enumerate(
        zip((camera.fx, camera.fy), (camera.cx, camera.cy), sizes, strict=True)
    ):
        row = focal * frames[:, axis] + centre * ahead
        middle = (signs * row * ahead).sum(dim=1) / whole
        half = (middle.square() - (signs * row * row).sum(dim=1) / whole).clamp(min=0).sqrt()
        point = focal * frames[:, axis, -1] / depth + centre
        first = torch.where(whole < 0, torch.minimum(middle - half, point - margin), 0.0)
        last = torch.where(whole < 0, torch.maximum(middle + half, point + margin), float(size))
        low.append(first.nan_to_num(0).clamp(0, size))
        high.append(last.nan_to_num(0).clamp(0, size))
    most = torch.tensor([columns, rows])
    first = (torch.stack(low, dim=1) / tile).floor().long()
    last = (torch.stack(high, dim=1) / tile).ceil().long().minimum(most)
    boxes = torch.stack([first[:, 0], last[:, 0], first[:, 1], last[:, 1]], dim=1)
    seen = (drawn & (boxes[:, 1] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 2])).nonzero()[:, 0]
    order = seen[depth[seen].argsort(stable=True)]
    lists, starts = tile_kernels.tile_lists(order.numpy(), boxes.numpy(), columns, rows)
    return TileLists(lists=lists, starts=starts, columns=columns)
