"""``sculpt-bench memory``: the memory of a rendering and its gradient, by the number of Gaussians and of pixels."""

import math
import multiprocessing
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from sculpt_framework.cli.bench_splats import bumpy_sphere_camera
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError
from sculpt_framework.memory import peak_bytes

if TYPE_CHECKING:
    from torch import Tensor

PROGRAM = "sculpt-bench memory"
_BLOCK = 10_000
"""Gaussians that are made at a time, so that making them takes no more memory than they do."""


@dataclass(frozen=True, kw_only=True)
class MemoryRequest:
    """Peak memory of a rendering on the CPU with its gradients, each case in a process of its own.

    The Gaussians cover a sphere as those of a mesh do: the more there are, the smaller they are. The last line tells
    the plane nearest to all cases: so many bytes per Gaussian and so many per pixel.
    """

    gaussians: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N")] = (100_000, 200_000, 400_000, 800_000)
    """Numbers of Gaussians."""
    sizes: Annotated[tuple[int, ...], tyro.conf.arg(metavar="PIXELS")] = (400, 800, 1600)
    """Sides of the square images."""
    threads: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """CPU threads."""
    json: Flag = False
    """Print JSON."""


@dataclass(frozen=True, kw_only=True)
class MemoryRow:
    """One case; megabytes are 2^20 bytes."""

    gaussians: int
    pixels: int
    peak_mb: float
    """Most memory in use during two renderings with their gradients, less what was in use before."""


@dataclass(frozen=True, kw_only=True)
class MemoryFit:
    """Least squares: bytes = constant + per_gaussian Gaussians + per_pixel pixels."""

    per_gaussian: float
    per_pixel: float
    constant_mb: float
    largest_error: float
    """Largest deviation of a case from the plane, as a share of the largest case."""


def bench_memory(words: Sequence[str]) -> None:
    """Measure and print. Raises ConfigError; exits as tyro does for ``--help`` and values of a wrong type."""
    request = tyro.cli(MemoryRequest, args=words, prog=PROGRAM)
    if min((*request.gaussians, *request.sizes, request.threads), default=0) < 1:
        raise ConfigError("--gaussians, --sizes and --threads take numbers from 1 upwards.")
    rows: list[MemoryRow] = []
    # A process that has not loaded torch starts each case anew, so that no case finds another's memory.
    context = multiprocessing.get_context("spawn")
    for count in request.gaussians:
        for size in request.sizes:
            with context.Pool(1) as pool:
                rows.append(pool.apply(_measure, (count, size, request.threads)))
            if not request.json:
                sys.stdout.write(f"{count:9} Gaussians {size:5} x {size:<5} {rows[-1].peak_mb:8.1f} MB\n")
                sys.stdout.flush()
    fit = plane(rows)
    if request.json:
        from sculpt_framework.export.json_text import json_text

        fitted = None if fit is None else asdict(fit)
        sys.stdout.write(json_text({"rows": [asdict(row) for row in rows], "fit": fitted}, indent=2) + "\n")
    elif fit is not None:
        sys.stdout.write(
            f"{fit.constant_mb:.1f} MB + {fit.per_gaussian:.0f} bytes per Gaussian + {fit.per_pixel:.0f} per pixel; "
            f"no case is further from it than {fit.largest_error:.1%} of the largest\n"
        )


def plane(rows: Sequence[MemoryRow]) -> MemoryFit | None:
    """The plane nearest to all cases; None where they do not tell one."""
    import numpy as np

    places = np.array([[row.gaussians, row.pixels, 1.0] for row in rows])
    peaks = np.array([row.peak_mb * 2**20 for row in rows])
    if np.linalg.matrix_rank(places) < 3:
        return None
    (per_gaussian, per_pixel, constant), *_ = np.linalg.lstsq(places, peaks, rcond=None)
    errors = np.abs(places @ (per_gaussian, per_pixel, constant) - peaks)
    return MemoryFit(
        per_gaussian=round(float(per_gaussian), 1),
        per_pixel=round(float(per_pixel), 1),
        constant_mb=round(float(constant) / 2**20, 2),
        largest_error=round(float(errors.max() / peaks.max()), 4),
    )


def _measure(count: int, size: int, threads: int) -> MemoryRow:
    """One case; runs in a process of its own."""
    import torch

    from sculpt_framework import registry
    from sculpt_framework.config import RasterizerConfig

    torch.set_num_threads(threads)
    config = registry.default("rasterizer", "numba")
    assert isinstance(config, RasterizerConfig)  # noqa: S101 - what the registry promises for the slot
    device = torch.device("cpu")
    rasterizer = config.build(device)

    def render(splats: "list[Tensor]", size: int) -> None:
        camera = bumpy_sphere_camera(size, device)
        for _ in range(2):
            for leaf in splats:
                leaf.grad = None
            means, scales, rotations, opacities, colors = splats
            background = torch.zeros(3)
            output = rasterizer.rasterize(
                means, scales, rotations, opacities, colors, camera, background, low_pass_px2=0.3, alpha_max=0.999
            )
            (output.features.sum() + output.alpha.sum()).backward()

    # Loads the kernels.
    render(splats_on_a_sphere(100), 16)
    splats = splats_on_a_sphere(count)
    before = peak_bytes()
    render(splats, size)
    return MemoryRow(gaussians=count, pixels=size * size, peak_mb=round((peak_bytes() - before) / 2**20, 1))


def splats_on_a_sphere(count: int) -> "list[Tensor]":
    """Means, scales, rotations, opacities and colours of flat Gaussians, evenly over a sphere of radius 0.8, that
    overlap as those on the faces of a mesh do."""
    import torch

    torch.manual_seed(0)
    means, rotations = torch.empty(count, 3), torch.empty(count, 3, 3)
    for first in range(0, count, _BLOCK):
        index = torch.arange(first, min(first + _BLOCK, count)) + 0.5
        z, angle = 1.0 - 2.0 * index / count, (index.double() * math.pi * (1.0 + 5.0**0.5) % (2.0 * math.pi)).float()
        radius = (1.0 - z * z).sqrt()
        normal = torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=1)
        along = torch.stack([-angle.sin(), angle.cos(), torch.zeros_like(z)], dim=1)
        block = slice(first, first + len(index))
        means[block] = 0.8 * normal
        rotations[block] = torch.stack([normal, along, torch.linalg.cross(normal, along)], dim=2)
    # Half of the edge of an equilateral triangle with the area that each has.
    half_edge = 0.8 * math.sqrt(4.0 * math.pi / count / 3.0**0.5)
    scales = torch.tensor([1e-2, 1.0, 1.0]).mul_(half_edge).repeat(count, 1)
    splats = [means, scales, rotations, torch.full((count,), 0.99), torch.rand(count, 3)]
    return [tensor.requires_grad_(True) for tensor in splats]
