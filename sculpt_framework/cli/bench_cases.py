"""What ``sculpt-bench`` times: every case with all ways to compute it."""

import importlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sculpt_framework.cli.bench_splats import bumpy_sphere_camera, splats_on_bumpy_sphere
from sculpt_framework.errors import ComponentImportError, ConfigError, DeviceError

if TYPE_CHECKING:
    from types import ModuleType

    import torch
    from torch import Tensor

    from sculpt_framework.types import Camera

RASTER_CASES = (
    # Faces of the mesh, Gaussians per face, pixels along the image's side.
    (500, 1, 64),
    (10_000, 1, 400),
    (40_000, 1, 400),
    (40_000, 3, 400),
    (40_000, 1, 800),
    (160_000, 1, 800),
    (160_000, 3, 800),
)
CUDA_RASTER_CASES = (*RASTER_CASES, (300_000, 1, 800), (1_000_000, 1, 800), (3_000_000, 1, 800))
RASTERIZERS = {"cpu": ("numba",), "cuda": ("triton", "gsplat")}
DENSE_PAIRS = 10_000_000
"""Pixels times Gaussians beyond which the reference, which forms all of these pairs, is left out."""
LOW_PASS_PX2, ALPHA_MAX = 0.3, 0.999
OPERATIONS_PER_PAIR = 33 + 53
"""Additions and multiplications, forwards and backwards, on a pixel and a Gaussian that adds to its colour and
coverage: exponent, exponential, weight and sums, as the kernels of the backend numba have them."""


@dataclass(frozen=True, kw_only=True)
class Contender:
    """A way to compute a case: ``forward`` gives tensors, and what turns a pass's gradients back to none."""

    backend: str
    forward: "Callable[[], tuple[Tensor, ...]]"
    leaves: "Sequence[Tensor]"
    cuda: bool = False


@dataclass(frozen=True, kw_only=True)
class Case:
    """One line of the table for each of its contenders."""

    name: str
    contenders: list[Contender]
    amounts: dict[str, int]
    """How much of what a pass goes through: Gaussians, pixels, points."""
    operations: int | None = None
    """Floating-point operations that a pass cannot do without, where they were counted."""


def _chosen(cases: Sequence[int] | None, count: int) -> Sequence[int]:
    chosen = range(count) if cases is None else cases
    if any(not 0 <= number < count for number in chosen):
        raise ConfigError(f"--cases {' '.join(map(str, chosen))}: there are cases 0 to {count - 1}.")
    return chosen


def raster_cases(chosen: Sequence[int] | None, device_name: str, compare_prototype: Path | None) -> Iterator[Case]:
    """Colour and coverage of Gaussians on a bumpy sphere that fills two fifths of the image, by all that run there."""
    import torch

    prototype = None if compare_prototype is None else _prototype(compare_prototype)
    device = torch.device(device_name)
    cases = CUDA_RASTER_CASES if device_name == "cuda" else RASTER_CASES
    for number in _chosen(chosen, len(cases)):
        faces, per_face, size = cases[number]
        camera = bumpy_sphere_camera(size, device)
        splats = [tensor.to(device).requires_grad_(True) for tensor in splats_on_bumpy_sphere(faces, per_face)]
        dense = splats[0].shape[0] * size * size <= DENSE_PAIRS
        names = (*RASTERIZERS[device_name], *(("reference",) if dense else ()))
        contenders = [each for name in names if (each := _rasterizer(name, splats, camera, device)) is not None]
        if prototype is not None:
            contenders.append(_prototype_rasterizer(prototype, splats, camera))
        yield Case(
            name=f"{faces} faces x{per_face} {size}px",
            contenders=contenders,
            amounts={"gaussians": faces * per_face, "pixels": size * size},
            operations=None if device_name == "cuda" else raster_operations(splats, camera),
        )


def fma_peak() -> float:
    """Operations of float32 a second that one core does at best: fused multiply-adds on registers, nothing else."""
    import numpy as np

    from sculpt_framework.cli.bench_kernels import LANES, WAYS, operations_of

    best, times = 0.0, 20_000
    for chains, repeat in WAYS:
        values = np.zeros(chains * LANES, np.float32)
        repeat(values, 1)
        for _ in range(5):
            started = time.thread_time()
            repeat(values, times)
            best = max(best, operations_of(chains, times) / (time.thread_time() - started))
    return best


def raster_operations(splats: "list[Tensor]", camera: "Camera") -> int:
    """Of compositing alone, for pairs that count: alpha is 1/255 or more, and the pixel not yet saturated."""
    import torch

    from sculpt_framework.cli.bench_kernels import count_pairs
    from sculpt_framework.rasterizers import Rasterizer
    from sculpt_framework.rendering.projection import project

    means, scales, rotations, opacities, _ = (tensor.detach() for tensor in splats)
    screen = project(means, scales, rotations, camera, LOW_PASS_PX2)
    order = screen.depths.argsort()
    # Beyond this many deviations alpha is less than 1/255.
    reach = (2.0 * (opacities / Rasterizer.ALPHA_MIN).log().clamp(min=0.0)[:, None] * screen.covariances[:, ::2]).sqrt()
    drawn = (screen.means, screen.conics, opacities[:, None], reach)
    table = torch.cat(drawn, dim=1)[order][screen.depths[order] >= Rasterizer.NEAR].contiguous()
    limits = (Rasterizer.ALPHA_MIN, Rasterizer.TRANSMITTANCE_MIN, ALPHA_MAX)
    return OPERATIONS_PER_PAIR * count_pairs(table.numpy(), camera.width, camera.height, *limits)


def _rasterizer(name: str, splats: "list[Tensor]", camera: "Camera", device: "torch.device") -> Contender | None:
    """A backend's passes; None, and a line that says why, where it cannot run here."""
    import torch

    from sculpt_framework import registry
    from sculpt_framework.config import RasterizerConfig

    config = registry.default("rasterizer", name)
    assert isinstance(config, RasterizerConfig)  # noqa: S101 - what the registry promises for the slot
    try:
        rasterizer = config.build(device)
    except (ComponentImportError, DeviceError) as error:
        sys.stderr.write(f"{name} left out: {error}\n")
        return None
    background = torch.zeros(3, device=device)

    def forward() -> "tuple[Tensor, ...]":
        means, scales, rotations, opacities, colors = splats
        output = rasterizer.rasterize(
            means,
            scales,
            rotations,
            opacities,
            colors,
            camera,
            background,
            low_pass_px2=LOW_PASS_PX2,
            alpha_max=ALPHA_MAX,
        )
        return output.features, output.alpha

    return Contender(backend=name, forward=forward, leaves=splats, cuda=device.type == "cuda")


def _prototype(folder: Path) -> "ModuleType":
    """The module raster_proto of a folder, which imports its neighbours by plain names."""
    if not (folder / "raster_proto.py").is_file():
        raise ConfigError(f"--compare-prototype {folder}: there is no raster_proto.py in that folder.")
    sys.path.insert(0, str(folder))
    return importlib.import_module("raster_proto")


def _prototype_rasterizer(prototype: "ModuleType", splats: "list[Tensor]", camera: "Camera") -> Contender:
    def forward() -> "tuple[Tensor, ...]":
        from sculpt_framework.cpu_kernels import share_threads

        share_threads()
        lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        return prototype.render(*splats, camera.world_to_camera, *lens)[:2]

    return Contender(backend="prototype", forward=forward, leaves=splats)


def loss_cases(chosen: Sequence[int] | None) -> Iterator[Case]:
    import torch

    from sculpt_framework.rendering.photometric import l1_dssim, l1_dssim_in_torch

    sizes = (200, 400, 800)
    for number in _chosen(chosen, len(sizes)):
        size = sizes[number]
        target = torch.rand(size, size, 3, generator=torch.Generator().manual_seed(0))
        image = (0.9 * target + 0.05).requires_grad_(True)

        yield _against_torch(
            f"{size}x{size}x3",
            partial(l1_dssim, image, target, 0.2),
            partial(l1_dssim_in_torch, image, target, 0.2),
            leaves=[image],
            amounts={"pixels": size * size},
        )


def color_cases(chosen: Sequence[int] | None) -> Iterator[Case]:
    """Spherical harmonics of Gaussians around the camera, with and without a gradient by their positions."""
    import torch

    from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb, sh_to_rgb_in_torch

    cases = [(count, degree, moving) for count in (100_000, 400_000) for degree in (1, 3) for moving in (0, 1)]
    for number in _chosen(chosen, len(cases)):
        count, degree, moving = cases[number]
        generator = torch.Generator().manual_seed(0)
        sh = (0.3 * torch.randn(count, (degree + 1) ** 2, 3, generator=generator)).requires_grad_(True)
        means = torch.randn(count, 3, generator=generator).requires_grad_(bool(moving))
        camera = torch.zeros(3)

        yield _against_torch(
            f"{count} Gaussians, degree {degree}{' d/dx' if moving else ''}",
            partial(sh_to_rgb, sh, means, camera),
            partial(sh_to_rgb_in_torch, sh, means, camera),
            leaves=[sh, means],
            amounts={"gaussians": count},
        )


def field_cases(chosen: Sequence[int] | None) -> Iterator[Case]:
    """Points on a sphere, as they are near a surface, with and without a gradient by their positions."""
    import torch

    from sculpt_framework.encodings.hash_grid import HashEncoding, encode_in_torch

    cases = [
        (count, log2_table, 8, 2, moving) for log2_table in (17, 19) for count in (50_000, 200_000) for moving in (0, 1)
    ]
    # As many numbers per point as above, of which a corner has twice as many.
    cases += [(50_000, 17, 4, 4, moving) for moving in (0, 1)]
    for number in _chosen(chosen, len(cases)):
        count, log2_table, levels, features, moving = cases[number]
        encoding = HashEncoding(
            levels=levels,
            features_per_level=features,
            log2_table=log2_table,
            base_resolution=8,
            finest_resolution=256,
            init_scale=0.1,
        )
        directions = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
        points = (0.6 * directions / directions.norm(dim=1, keepdim=True)).requires_grad_(bool(moving))
        tables = list(encoding.tables)

        yield _against_torch(
            f"{count} points 2^{log2_table} {levels}x{features}{' d/dx' if moving else ''}",
            partial(encoding, points),
            partial(encode_in_torch, points, tables, encoding.resolutions),
            leaves=[points, *tables],
            amounts={"points": count},
        )


def _against_torch(
    name: str,
    compiled: "Callable[[], Tensor]",
    in_torch: "Callable[[], Tensor]",
    *,
    leaves: "Sequence[Tensor]",
    amounts: dict[str, int],
) -> Case:
    """Kernels beside their twin in torch."""
    return Case(
        name=name,
        contenders=[
            Contender(backend="numba", forward=lambda: (compiled(),), leaves=leaves),
            Contender(backend="torch", forward=lambda: (in_torch(),), leaves=leaves),
        ],
        amounts=amounts,
    )
