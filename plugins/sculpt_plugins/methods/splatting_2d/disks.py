"""Flat Gaussians and a camera in, images out, differentiable in the disks: the renderer of 2DGS."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.cpu_kernels import array_of, kernel_cache, share_threads
from sculpt_framework.export.mesh_pixels import lens_values
from sculpt_framework.free_gaussians import row_kernels
from sculpt_framework.free_gaussians.drawing import facing
from sculpt_framework.free_gaussians.tiles import list_tiles
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Camera, Gaussians, Rendering

with kernel_cache("disks", Path(__file__).with_name("kernels.py"), Path(row_kernels.__file__)):
    from sculpt_plugins.methods.splatting_2d import kernels

_BLUR = 3.0
"""Pixels around a disk's centre in which its blur may count."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnDisks:
    """Normals of the rendering face the camera. ``distortion`` is the sum over pairs of w_i w_j (m_i - m_j)^2 (paper,
    eq. 13, squared as in its program), m the mapped depth."""

    rendering: Rendering
    distortion: Float[Tensor, "h w"]
    median: Float[Tensor, "h w"]
    """Depth of the farthest disk that more than half of the light reaches (paper, appendix on depths), 0 where there
    is none. It has no gradient."""


def draw_disks(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> DrawnDisks:
    """The thinnest axis of each Gaussian, column 0, counts for nothing but its normal. On the CPU.

    A disk seen edge on, or smaller than a pixel, is the blur around its centre. Those behind the camera, or with a
    frame that is not finite, are not drawn and have no gradient.
    """
    pose = camera.world_to_camera.to(gaussians.means)
    rotation, shift = pose[:3, :3], pose[:3, 3]
    axes = gaussians.rotations[:, :, 1:] * gaussians.scales[:, None, 1:]
    frames = torch.cat([rotation @ axes, (gaussians.means @ rotation.T + shift)[:, :, None]], dim=2)
    colors = sh_to_rgb(gaussians.sh, gaussians.means, camera.position.to(gaussians.means))
    features = torch.cat([colors, facing(gaussians.rotations[:, :, 0], gaussians.means, camera)], dim=1)
    out, left, distortion, median = _Disks.apply(frames, gaussians.opacities, features, camera)
    rgb = out[..., :3] + left[..., None] * background
    rendering = Rendering(rgb=rgb, alpha=1 - left, depth=out[..., 6], normal=out[..., 3:6])
    return DrawnDisks(rendering=rendering, distortion=distortion, median=median)


class _Disks(torch.autograd.Function):
    """(features and depth added up, light left, distortion, median). Not differentiable twice, nor by the camera."""

    @staticmethod
    def forward(ctx, frames: Tensor, opacities: Tensor, features: Tensor, camera: Camera):
        share_threads()
        lens = lens_values(camera)
        reach = 2 * (opacities.detach().double() / row_kernels.ALPHA_MIN).log()
        tiles = list_tiles(frames.detach().double(), reach, camera, tile=row_kernels.TILE, margin=_BLUR)
        lists, starts, columns = tiles.lists, tiles.starts, tiles.columns
        shape = (camera.height, camera.width)
        out = frames.new_empty(*shape, features.shape[1] + 1)
        # Their differences are small: in single precision nothing would be left of them.
        moments = frames.new_empty(*shape, 3, dtype=torch.float64)
        left, median, last = frames.new_empty(shape), frames.new_empty(shape), np.empty(shape, np.int32)
        limits = array_of(reach)
        given = (array_of(frames), array_of(opacities), limits, array_of(features), lens, lists, starts, columns)
        kernels.composite(*given, out.numpy(), moments.numpy(), left.numpy(), last, median.numpy())
        ctx.save_for_backward(frames, opacities, features, moments, left)
        ctx.mark_non_differentiable(median)
        ctx.lists = limits, lens, lists, starts, columns, last
        w0, w1, w2 = moments.unbind(dim=2)
        return out, left, (w0 * w2 - w1 * w1).to(frames), median

    @staticmethod
    @once_differentiable
    def backward(ctx, to_out, to_left, to_distortion, _):  # pyright: ignore[reportIncompatibleMethodOverride]
        frames, opacities, features, moments, left = ctx.saved_tensors
        limits, lens, lists, starts, columns, last = ctx.lists
        share_threads()
        to_frames = frames.new_zeros(row_kernels.BANDS, *frames.shape)
        to_opacities = opacities.new_zeros(row_kernels.BANDS, *opacities.shape)
        to_features = features.new_zeros(row_kernels.BANDS, *features.shape)
        kernels.differentiate(
            array_of(frames), array_of(opacities), limits, array_of(features), lens, lists, starts, columns,
            array_of(moments), array_of(left), last, array_of(to_out), array_of(to_left), array_of(to_distortion),
            to_frames.numpy(), to_opacities.numpy(), to_features.numpy(),
        )  # fmt: skip
        return to_frames.sum(dim=0), to_opacities.sum(dim=0), to_features.sum(dim=0), None
