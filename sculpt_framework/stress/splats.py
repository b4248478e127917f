"""Gaussians on the screen at their extremes: the rasteriser in use in float32 against the reference in float64."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework import registry
from sculpt_framework.config import RasterizerConfig
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.precision import Comparison, compare
from sculpt_framework.types import Box, Camera

_CPU = torch.device("cpu")
_CLOSE = 1e-3
"""Relative error of an image or of its gradients: float32's rounding of screen positions, amplified by the slope of a
splat's flank."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Splats:
    """Everything a rasteriser takes, in float64."""

    means: Float[Tensor, "g 3"]
    scales: Float[Tensor, "g 3"]
    opacities: Float[Tensor, " g"]
    camera: Camera

    @property
    def rotations(self) -> Float[Tensor, "g 3 3"]:
        generator = torch.Generator().manual_seed(2)
        frames = torch.linalg.qr(torch.randn(len(self.means), 3, 3, dtype=torch.float64, generator=generator))[0]
        return frames * torch.sign(torch.det(frames))[:, None, None]

    @property
    def features(self) -> Float[Tensor, "g 3"]:
        return torch.rand(len(self.means), 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4))


def rasterizer(name: str) -> Rasterizer:
    config = registry.default("rasterizer", name)
    assert isinstance(config, RasterizerConfig)  # noqa: S101 - what the registry promises for the slot
    return config.build(_CPU)


def camera(width: int = 24, height: int = 24, focal: float = 24.0, center: tuple[float, float] | None = None) -> Camera:
    """At the origin, looking along z."""
    cx, cy = center or (0.5 * width, 0.5 * height)
    pose = torch.eye(4, dtype=torch.float64)
    return Camera(world_to_camera=pose, fx=focal, fy=focal, cx=cx, cy=cy, width=width, height=height)


def cloud(count: int = 40, distance: float = 2.0, spread: float = 0.35, scale: float = 0.06) -> Splats:
    """Round the point ``distance`` ahead of the camera; all lengths in the same units."""
    generator = torch.Generator().manual_seed(1)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, dtype=torch.float64, generator=generator)

    means = spread * (2.0 * uniform(count, 3) - 1.0) + torch.tensor([0.0, 0.0, distance], dtype=torch.float64)
    scales = scale * (0.5 + uniform(count, 3))
    return Splats(means=means, scales=scales, opacities=0.2 + 0.7 * uniform(count), camera=camera())


def splat_cases() -> Iterator[Case]:
    base = cloud()
    yield _case("cloud", "40 Gaussians, nothing extreme", base, 1e-4)
    for value in (0.9999, 1.0):
        opaque = replace(base, opacities=torch.full_like(base.opacities, value))
        yield _case(f"opacity-{value:g}", f"all opacities {value:g}: alpha is cut at 0.999", opaque)
    for scale in (1e-12, 1e-6, 1e3, 1e6):
        yield _case(f"scales-{scale:g}", f"standard deviations of about {scale:g} units", cloud(scale=scale))
    flat = replace(base, scales=base.scales * torch.tensor([1e-9, 1.0, 1.0], dtype=torch.float64))
    yield _case("no-thickness", "Gaussians with a billionth of their width as thickness, at all angles", flat)
    line = replace(base, scales=base.scales * torch.tensor([1e-9, 1e-9, 1.0], dtype=torch.float64))
    yield _case("lines", "Gaussians that are lines", line)
    place = torch.tensor([[0.05, -0.03, 2.0]], dtype=torch.float64)
    many = cloud(count=3000)
    together = replace(many, means=place.repeat(3000, 1), opacities=0.01 + 0.02 * many.opacities)
    yield _case("coincident-3000", "3000 faint Gaussians in one place", together)
    for distance in (0.011, 0.05, 0.3):
        near = cloud(distance=distance, spread=0.4 * distance, scale=0.1 * distance)
        yield _case(f"near-{distance:g}", f"Gaussians {distance:g} units from the camera, the near plane at 0.01", near)
    yield _case("around-the-camera", "Gaussians all round the camera, most outside the view", cloud(distance=0.0))
    for focal in (1.0, 1e4, 1e6):
        # The same picture, but for perspective: distance and focal length grow together.
        shown = cloud(distance=2.0 * focal / 24.0) if focal > 24 else base
        camera_there = camera(focal=focal)
        yield _case(f"focal-{focal:g}", f"focal length of {focal:g} px", replace(shown, camera=camera_there))
    for center in ((-200.0, 12.0), (1e4, -1e4)):
        # The object stands where this camera sees it.
        aside = torch.tensor(
            [(12.0 - center[0]) / 24.0 * 2.0, (12.0 - center[1]) / 24.0 * 2.0, 0.0], dtype=torch.float64
        )
        moved = replace(base, means=base.means + aside, camera=camera(center=center))
        yield _case(f"principal-point-{center[0]:g}", f"principal point at {center}, far off the image", moved)
    for width, height in ((1, 1), (1, 4000), (4000, 1)):
        shape = replace(base, camera=camera(width=width, height=height))
        yield _case(f"image-{width}x{height}", f"an image of {width} x {height} pixels", shape)
    for scale, shift in ((1e-6, 0.0), (1e6, 0.0), (1.0, 1e5), (1e-6, 1e5), (1e6, 1e5)):
        yield Case(
            id=f"scene-times-{scale:g}-plus-{shift:g}",
            group="operators",
            done=f"the cloud and its camera times {scale:g}, plus {shift:g}, brought to the object frame",
            expected="the same image as where nothing was moved",
            unit="relative error",
            limit=_CLOSE,
            measure=partial(_moved_scene, scale, shift),
        )


def _case(name: str, done: str, splats: Splats, limit: float = _CLOSE) -> Case:
    return Case(
        id=f"splats-{name}",
        group="operators",
        done=done,
        expected="float32 as the reference in float64",
        unit="relative error",
        limit=limit,
        measure=lambda: against_reference(splats).as_error(),
    )


def against_reference(splats: Splats) -> Comparison:
    """Image and gradients beside those of the reference in float64."""
    backends = {torch.float64: rasterizer("reference"), torch.float32: rasterizer("numba")}

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        means = inputs["means"]
        out = backends[means.dtype].rasterize(
            means,
            inputs["scales"],
            inputs["rotations"],
            inputs["opacities"],
            inputs["features"],
            splats.camera.to(_CPU, means.dtype),
            means.new_tensor([0.2, 0.4, 0.6]),
            low_pass_px2=0.05,
            alpha_max=0.999,
        )
        return {"rgb": out.features, "alpha": out.alpha, "depth": out.depth}

    names = ("means", "scales", "rotations", "opacities", "features")
    return compare(compute, {name: getattr(splats, name) for name in names})


def _moved_scene(scale: float, shift: float) -> Measured:
    """World coordinates are float64 up to the object frame, which is what rasterisers see."""
    base = cloud()
    offset = torch.full((3,), shift, dtype=torch.float64)
    box = Box(
        minimum=scale * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64) + offset,
        maximum=scale * torch.tensor([1.0, 1.0, 3.0], dtype=torch.float64) + offset,
    )
    pose = base.camera.world_to_camera.clone()
    pose[:3, 3] = -offset
    there = box.camera_to_object(replace(base.camera, world_to_camera=pose))
    moved = replace(base, means=box.to_object(scale * base.means + offset), camera=there)
    still = replace(base, means=base.means - torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64))
    pose = torch.eye(4, dtype=torch.float64)
    pose[2, 3] = 2.0
    expected = _image(replace(still, camera=replace(base.camera, world_to_camera=pose)), "reference", torch.float64)
    found = _image(moved, "numba", torch.float32)
    error = float((found.double() - expected).norm() / expected.norm())
    return Measured(value=error, float32_error=error)


def _image(splats: Splats, name: str, dtype: torch.dtype) -> Float[Tensor, "h w 3"]:
    return (
        rasterizer(name)
        .rasterize(
            splats.means.to(dtype),
            splats.scales.to(dtype),
            splats.rotations.to(dtype),
            splats.opacities.to(dtype),
            splats.features.to(dtype),
            splats.camera.to(_CPU, dtype),
            torch.zeros(3, dtype=dtype),
            low_pass_px2=0.05,
            alpha_max=0.999,
        )
        .features
    )
