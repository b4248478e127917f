"""Distances and what is made of them: interpolation, weights, softplus, extraction, harmonics, image losses."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework import registry
from sculpt_framework.config import ExtractorConfig, FieldConfig
from sculpt_framework.geometry.band import LEAST_DROP, crossing_weight, discover
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.precision import compare, default_type, relative

_CPU = torch.device("cpu")
_ROUNDING = 3e-5
_CELL = 0.05
_FIELD_CELLS = 128
EXTRACTORS = ("flexicubes", "marching-tetrahedra")


def surface_cases() -> Iterator[Case]:
    for name, inner, outer in (
        ("plain", 0.01, 0.03),
        ("one-zero", 0.0, 0.03),
        ("both-zero", 0.0, 0.0),
        ("denormal", 1e-40, 1e-40),
        ("equal", 0.02, 0.02),
        ("far-apart", 1e-12, 1.0),
    ):
        yield Case(
            id=f"crossing-{name}",
            group="operators",
            done=f"crossing of an edge with |sdf| {inner:g} and {outer:g} at its ends",
            expected="float32 as float64; gradient at most 1 / least drop",
            unit="relative error",
            limit=_ROUNDING,
            measure=partial(_crossing, inner, outer),
        )
    for name, raw in (("neutral", 0.0), ("saturated", 30.0), ("saturated-below", -30.0)):
        yield Case(
            id=f"cube-weights-{name}",
            group="operators",
            done=f"FlexiCubes weight 1 + 0.99 tanh(raw) at raw {raw:g}",
            expected="float32 as float64",
            unit="relative error",
            limit=_ROUNDING,
            measure=partial(_tanh_weight, raw),
        )
    for name, center in (("at-zero", 0.0), ("deep", -1e3), ("high", 1e3)):
        yield Case(
            id=f"softplus-{name}",
            group="operators",
            done=f"softplus(beta = 100) at {center:g}",
            expected="float32 as float64",
            unit="relative error",
            limit=_ROUNDING,
            measure=partial(_softplus, center),
        )
    for name in ("mlp", "hash-grid", "dense-grid"):
        for reach in (1.0, 1e6):
            yield Case(
                id=f"field-{name}-{reach:g}",
                group="operators",
                done=f"field {name} and its gradient at points up to {reach:g} units away, and at the origin",
                expected="float32 as float64",
                unit="relative error",
                limit=1e-4,
                measure=partial(_field, name, reach),
            )
    for name in EXTRACTORS:
        for kind in ("sphere", "zeros-at-corners", "nearly-flat", "steep"):
            yield Case(
                id=f"{name}-{kind}",
                group="operators",
                done=f"{name} of a sphere's distance, {_KINDS[kind]}",
                expected="finite vertices and gradients, float32 vertices as float64",
                unit="relative error",
                limit=1e-4,
                measure=partial(_extracted, name, kind),
            )
    for name, direction in (("pole", (0.0, 0.0, 1.0)), ("grazing", (1.0, 1e-7, -1e-7)), ("at-the-camera", (0.0,) * 3)):
        for distance in (1e-6, 1.0, 1e6):
            yield Case(
                id=f"harmonics-{name}-{distance:g}",
                group="operators",
                done=f"degree-3 harmonics seen along {name.replace('-', ' ')}, {distance:g} units away",
                expected="float32 as float64",
                unit="relative error",
                limit=_ROUNDING,
                measure=partial(_harmonics, direction, distance),
            )
    for name in ("equal", "black", "white", "checkerboard", "one-pixel", "out-of-range"):
        yield Case(
            id=f"photometric-{name}",
            group="operators",
            done=f"L1 and D-SSIM of images: {name.replace('-', ' ')}",
            expected="float32 kernels as torch in float64",
            unit="relative error",
            limit=1e-4,
            measure=partial(_photometric, name),
        )


def _crossing(inner: float, outer: float) -> Measured:
    least = LEAST_DROP * _CELL

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        # Of an edge from 1 to 2.
        return {"place": 1.0 + crossing_weight(inputs["ends"][0], inputs["ends"][1], least)}

    ends = torch.tensor([[inner], [outer]], dtype=torch.float64)
    leaf = ends.clone().requires_grad_(True)
    (slope,) = torch.autograd.grad(crossing_weight(leaf[0], leaf[1], least).sum(), [leaf])
    found = compare(compute, {"ends": ends}).as_error()
    steepest = float(slope.abs().max()) * least
    return replace(
        found, value=found.value if steepest <= 1.0 + 1e-9 else math.inf, note=f"gradient x least {steepest:.2g}"
    )


def _tanh_weight(raw: float) -> Measured:
    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {"weight": 1 + 0.99 * torch.tanh(inputs["raw"])}

    return compare(compute, {"raw": raw + 0.1 * _normal(16)}).as_error()


def _softplus(center: float) -> Measured:
    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return {"out": torch.nn.functional.softplus(inputs["x"], beta=100.0)}

    return compare(compute, {"x": center + 0.02 * _normal(16)}).as_error()


def _field(name: str, reach: float) -> Measured:
    config = registry.default("field", name)
    assert isinstance(config, FieldConfig)  # noqa: S101 - what the registry promises for the slot
    torch.manual_seed(0)
    field = config.build(_FIELD_CELLS, _CPU)
    with torch.no_grad():
        for parameter in field.parameters():
            parameter.add_(1e-3 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(9)))
    field.set_detail(2.0 / _FIELD_CELLS)
    double = config.build(_FIELD_CELLS, _CPU).double()
    double.load_state_dict(field.state_dict())
    double.set_detail(2.0 / _FIELD_CELLS)

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        points = inputs["points"]
        return {"sdf": (field if points.dtype == torch.float32 else double)(points)}

    # Not on cell walls of a grid, where the gradient jumps.
    points = torch.cat([reach * 0.37 * _normal(200, 3), torch.zeros(1, 3, dtype=torch.float64) + 1e-9])
    return compare(compute, {"points": points}).as_error()


_KINDS = {
    "sphere": "as it is",
    "zeros-at-corners": "exactly 0 at many grid corners",
    "nearly-flat": "times 1e-9",
    "steep": "times 1e6",
}


def _distance(kind: str, shift: Tensor) -> SdfFunction:
    def sdf(points: Tensor) -> Tensor:
        radius = torch.linalg.vector_norm(points - 0.003, dim=1)
        value = radius - 0.61 - shift.to(points)
        if kind == "zeros-at-corners":
            return torch.where(value.detach().abs() < 0.03, 0.0 * value, value)
        return value * {"sphere": 1.0, "nearly-flat": 1e-9, "steep": 1e6}[kind]

    return sdf


def _extracted(name: str, kind: str) -> Measured:
    """Extractors take the default type of torch when they are built."""
    config = registry.default("extractor", name)
    assert isinstance(config, ExtractorConfig)  # noqa: S101 - what the registry promises for the slot
    grid = grid_over_box(torch.ones(3), cells=20, level=0)
    found: list[tuple[Tensor, Tensor, Tensor]] = []
    for dtype in (torch.float32, torch.float64):
        with default_type(dtype):
            shift = torch.zeros((), dtype=dtype, requires_grad=True)
            sdf = _distance(kind, shift)
            seeds = discover(_distance("sphere", torch.zeros(())), grid, 0, margin=0.1)
            surface = config.build(grid, _CPU).extract(sdf, seeds).surface
            weights = torch.sin(torch.arange(surface.vertices.numel(), dtype=dtype)).reshape(-1, 3)
            slope = torch.zeros(())
            if surface.vertices.requires_grad:
                (slope,) = torch.autograd.grad((weights * surface.vertices).sum(), [shift])
            found.append((surface.vertices.detach(), slope, surface.face_keys))
    single, double = found
    if not torch.equal(single[2], double[2]):
        return Measured(value=math.inf, note="float32 and float64 connect the surface differently")
    error = relative(single[0], double[0])
    finite = all(bool(torch.isfinite(each).all()) for each in (*single[:2], *double[:2]))
    return Measured(
        value=error if finite else math.nan, note=f"gradient by an offset {float(single[1]):.3g}", float32_error=error
    )


def _harmonics(direction: tuple[float, ...], distance: float) -> Measured:
    sh = _normal(4, 16, 3)

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        place = inputs["mean"].expand(4, 3)
        return {"rgb": sh_to_rgb(inputs["sh"], place, torch.zeros_like(place[0]))}

    mean = distance * torch.tensor([direction], dtype=torch.float64)
    return compare(compute, {"mean": mean, "sh": 0.1 * sh}).as_error()


def _photometric(name: str) -> Measured:
    generator = torch.Generator().manual_seed(6)
    noise = torch.rand(24, 20, 3, dtype=torch.float64, generator=generator)
    squares = (torch.arange(24)[:, None] + torch.arange(20)).remainder(2).double()[..., None].expand(24, 20, 3)
    image, target = {
        "equal": (noise, noise),
        "black": (0.0 * noise, 0.0 * noise + 1e-3),
        "white": (0.0 * noise + 1.0, 0.0 * noise + 0.999),
        "checkerboard": (0.5 + 0.01 * noise, squares),
        "one-pixel": (noise[:1, :1], 1.0 - noise[:1, :1]),
        "out-of-range": (1e3 * noise, noise),
    }[name]

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        given = inputs["image"]
        # Beside 1, which SSIM is a difference from.
        return {"loss": 1.0 + l1_dssim(given, target.float().to(given.dtype), 0.2)}

    found = compare(compute, {"image": image})
    # Where both are equal the L1 term has a kink, and the loss is 0 but for rounding.
    return found.as_value_error() if name == "equal" else found.as_error()


def _normal(*shape: int) -> Float[Tensor, "..."]:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(8))
