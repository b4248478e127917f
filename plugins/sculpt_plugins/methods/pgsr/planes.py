"""Planes per pixel: their depths, and how well they match another view (Chen et al. 2024, IV-B)."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from sculpt_framework.losses import TrainingImage
from sculpt_framework.rendering.depth_normals import pixel_rays, rays_through
from sculpt_framework.types import Camera

_HALF = 3
"""Pixels on each side of a patch: seven by seven (program; eleven by eleven in one version of IV-B)."""
_STEEPEST = 1e-3
"""Cosine between ray and plane below which the plane has no depth."""
_WORST_PIXELS = 1.0
"""A point that misses itself by more is hidden in the other view (program)."""
_EVEN = 1e-6
"""Variance of a patch, of grey in [0, 1], that counts as none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneMaps:
    """Of the planes n . x = d in camera coordinates, the sums of weight times n and d."""

    normal: Float[Tensor, "h w 3"]
    distance: Float[Tensor, "h w"]
    covered: Bool[Tensor, "h w"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    missed: Float[Tensor, ""]
    """Mean of w times the pixels by which points miss themselves, w = exp(-pixels)."""
    unlike: Float[Tensor, ""]
    """Mean of w (1 - NCC)."""


def depths_of(maps: PlaneMaps, camera: Camera) -> Float[Tensor, "h w"]:
    """Camera z of the planes at their pixels; 0 where there is none, or it is seen edge on."""
    facing = (maps.normal * pixel_rays(camera, maps.normal)).sum(dim=2)
    known = maps.covered & (facing.detach() < -_STEEPEST)
    return torch.where(known, maps.distance / torch.where(known, facing, 1.0), 0.0)


def match_planes(
    maps: PlaneMaps,
    image: TrainingImage,
    other_maps: PlaneMaps,
    other: TrainingImage,
    samples: int,
    generator: torch.Generator,
) -> Match:
    """Compare covered pixels, chosen at random, with another view. Gradients reach ``maps`` alone.

    A point goes to the other view by its plane and comes back by the other's; patches are laid onto the plane. Those
    that the other image does not show whole have no say.
    """
    zero = maps.distance.sum() * 0.0
    height, width = maps.covered.shape
    inner = torch.zeros_like(maps.covered)
    inner[_HALF : height - _HALF, _HALF : width - _HALF] = True
    places = (maps.covered & inner & (depths_of(maps, image.camera).detach() > 0)).nonzero()
    if len(places) == 0:
        return Match(missed=zero, unlike=zero)
    # None twice: gradients of the same pixel would be added up by threads in any order.
    chosen = places[torch.randperm(len(places), generator=generator)[:samples].to(places.device)]
    rows, columns = chosen[:, 0], chosen[:, 1]
    normal, distance = maps.normal[rows, columns], maps.distance[rows, columns]
    offsets = torch.arange(-_HALF, _HALF + 1, device=rows.device)
    down, right = (each.reshape(-1) for each in torch.meshgrid(offsets, offsets, indexing="ij"))
    patch_rows, patch_columns = rows[:, None] + down, columns[:, None] + right
    rays = rays_through(image.camera, patch_columns + 0.5, patch_rows + 0.5).to(normal)
    facing = (rays * normal[:, None]).sum(dim=2)
    met = (facing < -_STEEPEST).all(dim=1)
    points = rays * (distance[:, None] / torch.where(facing < -_STEEPEST, facing, -1.0))[..., None]
    between = other.camera.world_to_camera.double() @ image.camera.world_to_camera.double().inverse()
    between = between.to(points)
    there = points @ between[:3, :3].T + between[:3, 3]
    ahead = (there[..., 2] > 1e-6).all(dim=1)
    pixels = _pixels(there, other.camera)
    middle = len(down) // 2
    depth_there = _sample(depths_of(other_maps, other.camera)[..., None], pixels[:, middle])[:, 0]
    ray_there = rays_through(other.camera, pixels[:, middle, 0], pixels[:, middle, 1])
    back = ((ray_there * depth_there[:, None]) - between[:3, 3]) @ between[:3, :3]
    home = torch.stack([columns + 0.5, rows + 0.5], dim=1).to(back)
    missed = (_pixels(back, image.camera) - home).norm(dim=1)
    size = pixels.new_tensor([other.camera.width, other.camera.height])
    inside = ((pixels > 0.5) & (pixels < size - 0.5)).all(dim=2).all(dim=1)
    seen = met & ahead & inside & (depth_there > 0) & (back[:, 2].detach() > 1e-6) & (missed.detach() < _WORST_PIXELS)
    # What is not seen has no say, and its numbers may be anything.
    missed = torch.where(seen, missed, 0.0)
    weight = torch.where(seen, (-missed.detach()).exp(), 0.0)
    own = _grey(image)[patch_rows, patch_columns]
    ncc = correlation(own, _sample(_grey(other)[..., None], pixels.reshape(-1, 2))[:, 0].reshape(own.shape))
    count = seen.sum().clamp(min=1)
    unlike = torch.where(seen, weight * (1 - ncc), 0.0)
    return Match(missed=(weight * missed).sum() / count, unlike=unlike.sum() / count)


def correlation(first: Float[Tensor, "n p"], second: Float[Tensor, "n p"]) -> Float[Tensor, " n"]:
    """Normalised cross-correlation of patches; 1, without gradient, where either is even."""
    first, second = first - first.mean(dim=1, keepdim=True), second - second.mean(dim=1, keepdim=True)
    both = first.square().mean(dim=1) * second.square().mean(dim=1)
    textured = both > _EVEN**2
    product = (first * second).mean(dim=1)
    return torch.where(textured, product * torch.where(textured, both, 1.0).rsqrt(), 1.0)


def _pixels(local: Float[Tensor, "*n 3"], camera: Camera) -> Float[Tensor, "*n 2"]:
    """Of points in camera coordinates; a point that is not in front of the camera is taken to be just so."""
    depth = local[..., 2].clamp(min=1e-6)
    return torch.stack(
        [local[..., 0] / depth * camera.fx + camera.cx, local[..., 1] / depth * camera.fy + camera.cy], dim=-1
    )


def _grey(image: TrainingImage) -> Float[Tensor, "h w"]:
    return image.premultiplied.mean(dim=2)


def _sample(image: Float[Tensor, "h w c"], pixels: Float[Tensor, "n 2"]) -> Float[Tensor, "n c"]:
    """Bilinear between pixels' centres; 0 outside of the image."""
    size = pixels.new_tensor([image.shape[1], image.shape[0]])
    unit = (2 * pixels / size - 1)[None, None]
    found = functional.grid_sample(image.movedim(2, 0)[None].to(pixels), unit, align_corners=False)
    return found[0, :, 0].T
