"""The whole chain, field to loss, in float32 as it is trained and in float64 by the reference."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework import registry
from sculpt_framework.appearances import bands
from sculpt_framework.config import FieldConfig
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.fields import Field
from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import Grid, grid_over_box
from sculpt_framework.losses import ImageLoss, Target, ViewsLoss
from sculpt_framework.sculpting.config import SculptingConfig, of_sculpting
from sculpt_framework.sculpting.gaussian_scene import assemble
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.precision import default_type, relative
from sculpt_framework.stress.splats import rasterizer
from sculpt_framework.types import Surface

GRADIENT_LIMIT = 1e-4
"""Of float32 against float64, on inputs that are not degenerate."""
_CPU = torch.device("cpu")
_PIXELS, _CELLS = 32, 14
_SMALL_FIELDS: Mapping[str, Mapping[str, object]] = {
    "hash-grid": {"num_levels": 4, "log2_table": 13, "finest_resolution": 32},
    "dense-grid": {"resolution": 24},
    "mlp": {"hidden_layers": 3, "hidden_units": 32, "skip_layer": 2, "frequencies": 3},
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk:
    """What came out of one walk through the chain and back."""

    gradients: Mapping[str, Float[Tensor, " n"]]
    """By "field", "extractor" and "rows", each its parameters laid end to end."""
    surface: Surface


def chain_cases() -> Iterator[Case]:
    for method in ("gaussian-sculpting", "gaussian-sculpting-paper"):
        for field in _SMALL_FIELDS:
            yield Case(
                id=f"chain-{method}-{field}",
                group="operators",
                done=f"field {field} to loss and back, with extractor, binder, losses and constraints of {method}",
                expected="gradients in float32 as in float64",
                unit="relative error",
                limit=GRADIENT_LIMIT,
                measure=partial(_compared, method, field),
            )
    for kind in ("flat", "folded"):
        yield Case(
            id=f"chain-degenerate-{kind}",
            group="operators",
            done=f"the same where most faces are degenerate: a field times 1e-6 and {_DEGENERATE[kind]}",
            expected="finite gradients in float32 and float64",
            unit="gradients not finite",
            limit=0.0,
            measure=partial(_degenerate, kind),
        )


_DEGENERATE = {"flat": "rounded, so that crossings lie on grid corners", "folded": "with rows pushed to 30"}


def walk(method: SculptingConfig, field: str, dtype: torch.dtype, degenerate: str | None = None) -> Walk:
    """One outer step's objective and gradients, with the inner loop's constraints added, on a bumpy sphere.

    The parameters are the same numbers for both types: drawn in float32, then widened.
    """
    kind = registry.default("field", field)
    assert isinstance(kind, FieldConfig)  # noqa: S101 - what the registry promises for the slot
    torch.manual_seed(0)
    made = replace(kind, **_SMALL_FIELDS[field]).build(_CELLS, _CPU)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.add_(3e-3 * torch.randn(parameter.shape, generator=generator))
    made = made.to(dtype)
    grid = grid_over_box(torch.ones(3), cells=_CELLS, level=0)
    made.set_detail(grid.cell)
    with default_type(dtype):
        return _walk(method, made, grid, dtype, degenerate)


def _walk(method: SculptingConfig, field: Field, grid: Grid, dtype: torch.dtype, degenerate: str | None) -> Walk:
    def sdf(points: Tensor) -> Tensor:
        value = field(points)
        if degenerate == "flat":
            # The straight-through value of a rounded distance: most crossings fall on corners.
            rounded = (value.detach() / grid.cell).round() * grid.cell
            value = 1e-6 * (value - value.detach() + rounded)
        return value

    extractor = method.extractor.build(grid, _CPU)
    extraction = extractor.extract(sdf, discover(field, grid, 0, lipschitz=1.5))
    binder = method.binder.build()
    new = binder.new_rows(len(extraction.surface.faces), _CPU, dtype)
    push = 30.0 if degenerate == "folded" else 0.1
    rows = {
        name: (row + push * torch.sin(torch.arange(row.numel(), dtype=dtype)).reshape(row.shape)).requires_grad_(True)
        for name, row in new.items()
    }
    binding = binder.bind(extraction.surface, rows, blur=0.01)
    count = binding.opacities.numel()
    sh = 0.3 * torch.sin(torch.arange(count * bands(1) * 3, dtype=dtype)).reshape(*binding.opacities.shape, bands(1), 3)
    gaussians = assemble(binding, sh)
    camera = demo_cameras(1, _PIXELS)[0].to(_CPU, dtype)
    backend = rasterizer("numba" if dtype == torch.float32 else "reference")
    rendering = backend.render(gaussians, camera, torch.full((3,), 0.3, dtype=dtype), low_pass_px2=0.05)
    target = _target(dtype)
    total = torch.zeros((), dtype=dtype)
    for config in method.losses:
        term = config.build()
        if isinstance(term, ViewsLoss):
            continue  # It takes no Gaussians, and vertices in no other precision: its own check is in the tests.
        value = term(rendering, target) if isinstance(term, ImageLoss) else term(extraction)
        total = total + config.weight * value
    for config in method.constraints:
        total = total + config.weight * config.build()(binding)
    leaves = {
        "field": [p for p in field.parameters() if p.requires_grad],
        "extractor": [leaf for table in extractor.tables.values() for leaf in table.leaves.values()],
        "rows": list(rows.values()),
    }
    every = [leaf for part in leaves.values() for leaf in part]
    given = torch.autograd.grad(total, every, allow_unused=True)
    slopes = iter(torch.zeros_like(leaf) if slope is None else slope for leaf, slope in zip(every, given, strict=True))
    gradients = {
        name: torch.cat([next(slopes).reshape(-1) for _ in part] or [torch.zeros(0, dtype=dtype)])
        for name, part in leaves.items()
    }
    return Walk(gradients=gradients, surface=extraction.surface.detach())


def _target(dtype: torch.dtype) -> Target:
    """Smooth colours and a disc, neither anywhere equal to what is rendered."""
    rows = torch.arange(_PIXELS, dtype=dtype)[:, None, None] / _PIXELS
    columns = torch.arange(_PIXELS, dtype=dtype)[None, :, None] / _PIXELS
    waves = 0.5 + 0.4 * torch.sin(7.0 * rows + torch.arange(3, dtype=dtype)) * torch.cos(5.0 * columns)
    radius = torch.hypot(rows - 0.5, columns - 0.48)[..., 0]
    return Target(rgb=waves, alpha=torch.sigmoid(40.0 * (0.27 - radius)))


def _compared(method: str, field: str) -> Measured:
    config = of_sculpting(registry.load_method(method)())
    single, double = (walk(config, field, dtype) for dtype in (torch.float32, torch.float64))
    if not torch.equal(single.surface.face_keys, double.surface.face_keys):
        return Measured(value=float("inf"), note="float32 and float64 connect the surface differently")
    errors = {name: relative(single.gradients[name], double.gradients[name]) for name in single.gradients}
    note = f"{len(single.surface.faces)} faces; " + ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
    finite = all(bool(torch.isfinite(g).all()) for w in (single, double) for g in w.gradients.values())
    worst = max(errors.values())
    return Measured(value=worst if finite else float("nan"), note=note, float32_error=worst)


def _degenerate(kind: str) -> Measured:
    config = of_sculpting(registry.load_method("gaussian-sculpting")())
    broken, largest = 0, 0.0
    for dtype in (torch.float32, torch.float64):
        found = walk(config, "hash-grid", dtype, kind)
        for slopes in found.gradients.values():
            broken += int((~torch.isfinite(slopes)).sum())
            largest = max(largest, float(slopes.abs().max()) if slopes.numel() else 0.0)
    return Measured(value=float(broken), note=f"largest gradient {largest:.2g}")
