"""Gaussians for tests, and one rendering with all its gradients."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_framework.types import Camera

INPUTS = ("means", "scales", "rotations", "opacities", "features", "world_to_camera")


@dataclass(frozen=True, kw_only=True)
class Splats:
    """Everything a rasteriser takes, in float64."""

    means: Tensor
    scales: Tensor
    rotations: Tensor
    opacities: Tensor
    features: Tensor
    camera: Camera
    background: Tensor
    low_pass_px2: float = 0.3
    alpha_max: float = 0.999


def random_rotations(count: int, generator: torch.Generator) -> Tensor:
    frames = torch.linalg.qr(torch.randn(count, 3, 3, dtype=torch.float64, generator=generator))[0]
    return frames * torch.sign(torch.det(frames))[:, None, None]


def random_splats(
    count: int = 150, channels: int = 3, width: int = 45, height: int = 37, seed: int = 0, focal: float = 50.0
) -> Splats:
    """A cloud in front of a camera that looks at it from two units away, off-centre, turned at random."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=generator)

    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = random_rotations(1, generator)[0]
    pose[:3, 3] = torch.tensor([0.1, -0.1, 2.0], dtype=torch.float64)
    return Splats(
        means=0.4 * torch.randn(count, 3, dtype=torch.float64, generator=generator),
        scales=0.01 + 0.1 * uniform(count, 3),
        rotations=random_rotations(count, generator),
        opacities=0.03 + 0.95 * uniform(count),
        features=uniform(count, channels),
        camera=Camera(
            world_to_camera=pose,
            fx=focal,
            fy=1.1 * focal,
            cx=0.5 * width + 3.0,
            cy=0.5 * height - 2.0,
            width=width,
            height=height,
        ),
        background=uniform(channels),
    )


def facing_splats(means: Tensor, scales: Tensor, opacity: float = 0.8, size: int = 32, focal: float = 32.0) -> Splats:
    """Gaussians given in the frame of a camera at the origin that looks along z."""
    count = means.shape[0]
    generator = torch.Generator().manual_seed(1)
    return Splats(
        means=means.double(),
        scales=scales.double(),
        rotations=torch.eye(3, dtype=torch.float64).repeat(count, 1, 1),
        opacities=torch.full((count,), opacity, dtype=torch.float64),
        features=torch.rand(count, 3, dtype=torch.float64, generator=generator),
        camera=Camera(
            world_to_camera=torch.eye(4, dtype=torch.float64),
            fx=focal,
            fy=focal,
            cx=size / 2,
            cy=size / 2,
            width=size,
            height=size,
        ),
        background=torch.zeros(3, dtype=torch.float64),
    )


def rendered(
    rasterizer: Rasterizer, splats: Splats, dtype: torch.dtype, device: torch.device | None = None
) -> tuple[RasterOutput, dict[str, Tensor]]:
    """The output, and the gradients by all inputs of a random weighting of features, alpha and depth; on the CPU."""
    device = device or torch.device("cpu")
    leaves = {name: getattr(splats, name) for name in INPUTS[:5]}
    leaves["world_to_camera"] = splats.camera.world_to_camera
    leaves = {name: leaf.to(device, dtype).clone().requires_grad_(True) for name, leaf in leaves.items()}
    pose = leaves["world_to_camera"]
    output = rasterizer.rasterize(
        *(leaves[name] for name in INPUTS[:5]),
        replace(splats.camera, world_to_camera=pose),
        splats.background.to(device, dtype),
        low_pass_px2=splats.low_pass_px2,
        alpha_max=splats.alpha_max,
    )
    weighted(output).backward()
    images = RasterOutput(
        features=output.features.detach().cpu(), alpha=output.alpha.detach().cpu(), depth=output.depth.detach().cpu()
    )
    return images, {name: leaf.grad.cpu() for name, leaf in leaves.items()}


def weighted(output: RasterOutput) -> Tensor:
    """The sum of features, alpha and depth, each number with a random weight of its own."""
    generator = torch.Generator().manual_seed(7)
    total = output.alpha.new_zeros(())
    for image in (output.features, output.alpha, output.depth):
        weights = torch.randn(image.shape, dtype=torch.float64, generator=generator)
        total = total + (image * weights.to(image)).sum()
    return total
