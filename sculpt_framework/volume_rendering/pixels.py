"""Pixels of the training images, to be drawn at random, and the rays through them."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.losses import TrainingImage
from sculpt_framework.types import Camera
from sculpt_framework.volume_rendering.stretches import Rays


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelBatch:
    rays: Rays
    premultiplied: Float[Tensor, "r 3"]
    """Colour times alpha."""
    alpha: Float[Tensor, " r"]


class Pixels:
    """All pixels of images that have masks. Their colours are kept as bytes, what else a ray needs is worked out."""

    def __init__(self, images: Sequence[TrainingImage]):
        """Raises ValueError for an image without a mask."""
        if any(image.alpha is None for image in images):
            raise ValueError("images without masks")
        cameras = [image.camera for image in images]
        device = cameras[0].world_to_camera.device
        sizes = torch.tensor([camera.width * camera.height for camera in cameras])
        self._first = torch.cat([sizes.new_zeros(1), sizes.cumsum(0)])
        self._widths = torch.tensor([camera.width for camera in cameras], device=device)
        poses = torch.stack([camera.world_to_camera for camera in cameras])
        lenses = [[float(each) for each in (camera.fx, camera.fy, camera.cx, camera.cy)] for camera in cameras]
        self._lens = torch.tensor(lenses, device=device, dtype=poses.dtype)
        self._turns, self._positions = poses[:, :3, :3], torch.stack([camera.position for camera in cameras])
        values = [_with_alpha(image) for image in images]
        self._values = torch.cat([(255 * value).round().to(torch.uint8) for value in values])

    def draw(self, count: int, generator: torch.Generator) -> PixelBatch:
        """So many pixels, uniformly at random over all images."""
        chosen = torch.randint(int(self._first[-1]), (count,), generator=generator)
        view = torch.searchsorted(self._first, chosen, right=True) - 1
        device = self._values.device
        place, view, chosen = (chosen - self._first[view]).to(device), view.to(device), chosen.to(device)
        width = self._widths[view]
        values = self._values[chosen].to(self._lens) / 255
        rays = _through(place % width, place // width, self._lens[view], self._turns[view], self._positions[view])
        return PixelBatch(rays=rays, premultiplied=values[:, :3], alpha=values[:, 3])


def rays_of(camera: Camera, first: int, last: int) -> Rays:
    """Through the centres of the pixels from number ``first`` to ``last`` (exclusive), in reading order."""
    return rays_at(camera, torch.arange(first, last, device=camera.world_to_camera.device))


def rays_at(camera: Camera, number: Int64[Tensor, " r"]) -> Rays:
    """Through the centres of pixels, by their numbers in reading order."""
    pose = camera.world_to_camera
    lens = torch.tensor([camera.fx, camera.fy, camera.cx, camera.cy], device=pose.device, dtype=pose.dtype)
    count = len(number)
    return _through(
        number % camera.width,
        number // camera.width,
        lens.expand(count, 4),
        pose[:3, :3].expand(count, 3, 3),
        camera.position.expand(count, 3),
    )


def _through(
    column: Int64[Tensor, " r"],
    row: Int64[Tensor, " r"],
    lens: Float[Tensor, "r 4"],
    turns: Float[Tensor, "r 3 3"],
    positions: Float[Tensor, "r 3"],
) -> Rays:
    """The rays of pixels: ``turns`` are the rotations of ``world_to_camera``."""
    x, y = (column + 0.5 - lens[:, 2]) / lens[:, 0], (row + 0.5 - lens[:, 3]) / lens[:, 1]
    local = torch.stack([x, y, torch.ones_like(x)], dim=1)
    directions = torch.einsum("rc,rcw->rw", local, turns)
    return Rays(origins=positions.contiguous(), directions=directions / directions.norm(dim=1, keepdim=True))


def _with_alpha(image: TrainingImage) -> Float[Tensor, "p 4"]:
    assert image.alpha is not None  # noqa: S101
    return torch.cat([image.premultiplied, image.alpha[..., None]], dim=2).reshape(-1, 4)
