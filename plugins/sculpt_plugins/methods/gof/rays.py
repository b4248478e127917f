"""Gaussians and a camera in, images out, differentiable in the Gaussians: the renderer of GOF."""

import math
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
from sculpt_framework.free_gaussians.tiles import TileLists, list_tiles
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Camera, Gaussians, Rendering

with kernel_cache("rays", Path(__file__).with_name("kernels.py"), Path(row_kernels.__file__)):
    from sculpt_plugins.methods.gof import kernels

_THINNEST = 1e-7
"""Object units: Gaussians are at least so thick."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """Gaussians as a camera has them, in its coordinates."""

    whites: Float[Tensor, "g 3 3"]
    """To standard deviations along the axes."""
    centers: Float[Tensor, "g 3"]
    axes: Float[Tensor, "g 3 3"]
    """Columns as long as the standard deviations."""
    opacities: Float[Tensor, " g"]

    @property
    def limits(self) -> Float[Tensor, " g"]:
        """Squared standard deviations beyond which an opacity counts as none."""
        return 2 * (self.opacities.detach().double() / row_kernels.ALPHA_MIN).log()

    @property
    def forms(self) -> Float[Tensor, "g 10"]:
        """Of the squared standard deviations at places: M^T M, M^T M mu and mu . M^T M mu; in double precision."""
        whites, centers = self.whites.detach().double(), self.centers.detach().double()
        square = whites.transpose(1, 2) @ whites
        across = torch.einsum("gij,gj->gi", square, centers)
        rows, columns = torch.triu_indices(3, 3)
        return torch.cat([square[:, rows, columns], across, (across * centers).sum(dim=1, keepdim=True)], dim=1)

    def tiles(self, camera: Camera) -> TileLists:
        frames = torch.cat([self.axes, self.centers[:, :, None]], dim=2).detach().double()
        return list_tiles(frames, self.limits, camera, tile=row_kernels.TILE, margin=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnRays:
    """Normals of the rendering face the camera. ``distortion`` is the sum over pairs of w_i w_j (m_i - m_j)^2, m the
    mapped depth; its weights have no gradient (program)."""

    rendering: Rendering
    distortion: Float[Tensor, "h w"]


def seen_by(gaussians: Gaussians, camera: Camera, smoothing: float) -> Seen:
    """Axes are orthonormal. Each Gaussian gains a variance of ``smoothing`` squared pixels at its depth, and loses
    opacity as its volume grows (Mip-Splatting, Yu et al. 2024, the smoothing in space, by the camera it is seen by)."""
    pose = camera.world_to_camera.to(gaussians.means)
    centers = gaussians.means @ pose[:3, :3].T + pose[:3, 3]
    pixel = centers[:, 2].detach().clamp(min=0) / math.sqrt(camera.fx * camera.fy)
    variance = gaussians.scales.square().clamp(min=_THINNEST**2)
    smooth = (variance + smoothing * pixel.square()[:, None]).sqrt()
    turns = pose[:3, :3] @ gaussians.rotations
    return Seen(
        whites=turns.transpose(1, 2) / smooth[:, :, None],
        centers=centers,
        axes=turns * smooth[:, None],
        opacities=gaussians.opacities * (variance.sqrt() / smooth).prod(dim=1),
    )


def draw_rays(gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"], smoothing: float) -> DrawnRays:
    """On the CPU. Those behind the camera, or with a frame that is not finite, are not drawn and have no gradient."""
    seen = seen_by(gaussians, camera, smoothing)
    colors = sh_to_rgb(gaussians.sh, gaussians.means, camera.position.to(gaussians.means))
    out, left, distortion = _Rays.apply(
        seen.whites, seen.centers, seen.opacities, colors, seen.tiles(camera), seen.limits, lens_values(camera),
        (camera.height, camera.width),
    )  # fmt: skip
    rgb = out[..., :3] + left[..., None] * background
    normal = out[..., 3:6] @ camera.world_to_camera[:3, :3].to(out)
    return DrawnRays(
        rendering=Rendering(rgb=rgb, alpha=1 - left, depth=out[..., 6], normal=normal), distortion=distortion
    )


class _Rays(torch.autograd.Function):
    """(colours, normals and depth added up, light left, distortion). Not differentiable twice, nor by the camera."""

    @staticmethod
    def forward(
        ctx, whites: Tensor, centers: Tensor, opacities: Tensor, colors: Tensor, tiles: TileLists, reach: Tensor,
        lens: np.ndarray, shape: tuple[int, int],
    ):  # fmt: skip
        share_threads()
        out = whites.new_empty(*shape, colors.shape[1] + 4)
        # Their differences are small: in single precision nothing would be left of them.
        moments = whites.new_empty(*shape, 3, dtype=torch.float64)
        left, last = whites.new_empty(shape), np.empty(shape, np.int32)
        limits = array_of(reach)
        given = (array_of(whites), array_of(centers), array_of(opacities), limits, array_of(colors), lens)
        listed = (tiles.lists, tiles.starts, tiles.columns)
        kernels.composite(*given, *listed, out.numpy(), moments.numpy(), left.numpy(), last)
        ctx.save_for_backward(whites, centers, opacities, colors, moments, left)
        ctx.given = limits, lens, tiles, last
        w0, w1, w2 = moments.unbind(dim=2)
        return out, left, (w0 * w2 - w1 * w1).to(whites)

    @staticmethod
    @once_differentiable
    def backward(ctx, to_out, to_left, to_distortion):  # pyright: ignore[reportIncompatibleMethodOverride]
        whites, centers, opacities, colors, moments, left = ctx.saved_tensors
        limits, lens, tiles, last = ctx.given
        share_threads()
        inputs = (whites, centers, opacities, colors)
        slopes = [each.new_zeros(row_kernels.BANDS, *each.shape) for each in inputs]
        kernels.differentiate(
            array_of(whites), array_of(centers), array_of(opacities), limits, array_of(colors), lens, tiles.lists,
            tiles.starts, tiles.columns, array_of(moments), array_of(left), last, array_of(to_out), array_of(to_left),
            array_of(to_distortion), *(slope.numpy() for slope in slopes),
        )  # fmt: skip
        return *(slope.sum(dim=0) for slope in slopes), None, None, None, None
