"""Triangles, the Gaussians on them and their constraints, at degenerate inputs."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework import registry
from sculpt_framework.binders import Binder, Binding
from sculpt_framework.config import BinderConfig, ConstraintConfig
from sculpt_framework.constraints import Constraint
from sculpt_framework.geometry import faces as geometry
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.precision import Compute, compare
from sculpt_framework.types import Surface

BARYCENTRIC = "face-barycentric"
CONSTRAINTS = ("mee-scale", "boundary", "spacing", "coverage")
_ROUNDING = 3e-5
"""Relative error of a well-posed float32 computation of some dozens of operations."""
_STEEPEST = 1e8
"""Of what rounding decides: the inverse of the smallest relative height that float32 can tell from none, and more."""


def triangle(base: float, height: float, lean: float = 0.5) -> Float[Tensor, "3 3"]:
    """In a plane askew to all axes; ``lean`` is where, along the base, the apex stands."""
    flat = torch.tensor([[0.0, 0.0, 0.0], [base, 0.0, 0.0], [lean * base, height, 0.0]], dtype=torch.float64)
    axis = torch.nn.functional.normalize(torch.tensor([0.3, 0.5, 0.81], dtype=torch.float64), dim=0)
    x, y, z = axis.tolist()
    turn = torch.matrix_exp(0.7 * torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64))
    return flat @ turn.T + torch.tensor([0.11, -0.07, 0.05], dtype=torch.float64)


TRIANGLES: Mapping[str, tuple[Tensor, bool]] = {
    # Corners, and whether rounding alone decides the shape, so that float32 and float64 need not agree.
    "equilateral": (triangle(0.04, 0.04 * 0.75**0.5), False),
    "needle-1e2": (triangle(1e-2, 1.0, 0.5), False),
    "needle-1e4": (triangle(1e-4, 1.0, 0.5), True),
    "needle-1e8": (triangle(1e-8, 1.0, 0.5), True),
    "cap-1e2": (triangle(1.0, 1e-2, 0.5), False),
    "cap-1e4": (triangle(1.0, 1e-4, 0.5), True),
    "cap-1e8": (triangle(1.0, 1e-8, 0.5), True),
    "line": (triangle(1.0, 0.0, 0.3), True),
    "two-corners-coincide": (triangle(0.0, 0.5, 0.5), True),
    "point": (triangle(0.0, 0.0, 0.5), True),
    "tiny-1e-12": (triangle(1e-12, 1e-12, 0.5) - triangle(1e-12, 1e-12, 0.5)[:1], True),
    "huge-1e6": (1e6 * triangle(1.0, 0.8, 0.5), False),
}


def face_cases() -> Iterator[Case]:
    """Frames, areas, Gaussians and each constraint on each triangle; then rows of the binder pushed to extremes."""
    for name, (corners, decided) in TRIANGLES.items():
        yield _case("frame", name, "normal, frame and area of a triangle", decided, partial(_frame, corners, decided))
        for form in ("steiner", "edges"):
            what = f"Gaussians on a triangle, reference {form}"
            yield _case(f"bind-{form}", name, what, decided, partial(_bound, corners, decided, form))
    for name in CONSTRAINTS:
        for shape in ("equilateral", "needle-1e4", "cap-1e8", "point"):
            corners, decided = TRIANGLES[shape]
            yield _case(name, shape, f"constraint {name}, K = 3", decided, partial(_constrained, corners, name, 3))
        for count in (1, 2, 6, 12):
            what = f"constraint {name}, K = {count}"
            measure = partial(_constrained, TRIANGLES["equilateral"][0], name, count)
            yield _case(f"{name}-k{count}", "equilateral", what, False, measure)
        yield _case(
            f"{name}-coincident",
            "equilateral",
            f"constraint {name}, all Gaussians of a face in one place",
            True,
            partial(_coincident, name),
        )
    for scale in (1e-12, 1e6):
        yield _case(
            f"scale-{scale:g}",
            "equilateral",
            f"Gaussians {scale:g} times as wide as their face, and the scale constraint",
            False,
            partial(_scaled, scale),
        )
    yield _case(
        "eigenvalues-equal", "equilateral", "both eigenvalues of M^-1 Sigma are 4", False, partial(_scaled, 2.0)
    )
    yield _case("saturated-logits", "equilateral", "barycentric logits of +-200", False, _saturated_logits)


def _case(operator: str, name: str, what: str, decided: bool, measure: Callable[[], Measured]) -> Case:
    """Where rounding decides the shape the gradient must stay small, elsewhere float32 must agree with float64."""
    return Case(
        id=f"{operator}-{name}",
        group="operators",
        done=f"{what}: {name.replace('-', ' ')}",
        expected="finite, bounded gradient" if decided else "float32 as float64",
        unit="largest gradient" if decided else "relative error",
        limit=_STEEPEST if decided else _ROUNDING,
        measure=measure,
    )


def _frame(corners: Tensor, decided: bool) -> Measured:
    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        each = inputs["corners"][None]
        return {"frame": geometry.tangent_frame(each), "area": geometry.face_areas(each)}

    found = compare(compute, {"corners": corners})
    return found.as_gradient() if decided else found.as_error()


def make_binder(count: int, reference: str = "steiner") -> Binder:
    """The barycentric binder with ``count`` Gaussians on a face, on it and not below it."""
    config = registry.default("binder", BARYCENTRIC)
    assert isinstance(config, BinderConfig)  # noqa: S101 - what the registry promises for the slot
    return replace(config, gaussians_per_face=count, reference=reference, fit_outline=False).build()  # pyright: ignore


def make_constraint(name: str) -> Constraint:
    config = registry.default("constraints", name)
    assert isinstance(config, ConstraintConfig)  # noqa: S101 - what the registry promises for the slot
    return config.build()


def bind(binder: Binder, corners: Float[Tensor, "3 3"], rows: Mapping[str, Tensor]) -> Binding:
    """On a surface of one face."""
    faces = torch.tensor([[0, 1, 2]])
    return binder.bind(
        Surface(vertices=corners, faces=faces, face_keys=torch.zeros(1, dtype=torch.int64)), rows, blur=0.0
    )


def rows_of(binder: Binder) -> dict[str, Tensor]:
    """New rows of one face, in float64, moved a little so that no two Gaussians are alike."""
    generator = torch.Generator().manual_seed(3)
    rows = binder.new_rows(1, torch.device("cpu"), torch.float64)
    return {n: r + 0.05 * torch.randn(r.shape, dtype=r.dtype, generator=generator) for n, r in rows.items()}


def _bound(corners: Tensor, decided: bool, reference: str) -> Measured:
    binder = make_binder(3, reference)

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        rows = {name: value for name, value in inputs.items() if name != "corners"}
        binding = bind(binder, inputs["corners"], rows)
        # The second-order shape, not the axes: those of a round Gaussian are arbitrary.
        factor = binding.rotations * binding.scales[:, :, None]
        return {"means": binding.means, "covariance": factor @ factor.transpose(2, 3)}

    found = compare(compute, {"corners": corners, **rows_of(binder)})
    return found.as_gradient() if decided else found.as_error()


def _penalty(name: str, count: int) -> Compute:
    binder, constraint = make_binder(count), make_constraint(name)

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        rows = {each: value for each, value in inputs.items() if each != "corners"}
        return {"penalty": constraint(bind(binder, inputs["corners"], rows))}

    return compute


def _constrained(corners: Tensor, name: str, count: int) -> Measured:
    binder = make_binder(count)
    rows = rows_of(binder)
    # Wide enough that the hinge of the scale constraint is at work.
    rows["log_ratios"] = rows["log_ratios"] + 1.5
    found = compare(_penalty(name, count), {"corners": corners, **rows})
    return found.as_gradient() if _rounding_decides(corners) else found.as_error()


def _rounding_decides(corners: Tensor) -> bool:
    return any(decided and torch.equal(corners, known) for known, decided in TRIANGLES.values())


def _coincident(name: str) -> Measured:
    binder = make_binder(3)
    rows = rows_of(binder)
    rows["barycentric_logits"] = torch.zeros_like(rows["barycentric_logits"])
    return compare(_penalty(name, 3), {"corners": TRIANGLES["equilateral"][0], **rows}).as_gradient()


def _scaled(scale: float) -> Measured:
    binder, constraint = make_binder(1), make_constraint("mee-scale")
    rows = binder.new_rows(1, torch.device("cpu"), torch.float64)
    rows["log_ratios"] = torch.full_like(rows["log_ratios"], math.log(scale))

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        each = {name: value for name, value in inputs.items() if name != "corners"}
        binding = bind(binder, inputs["corners"], each)
        return {"penalty": (1.0 + constraint(binding)).log(), "covariance": binding.tangent_covariance}

    # With one scale for all directions the eigenvalues are equal, and which of their vectors is steepest is open.
    return compare(compute, {"corners": TRIANGLES["equilateral"][0], **rows}).as_value_error()


def _saturated_logits() -> Measured:
    binder = make_binder(3)
    rows = rows_of(binder)
    rows["barycentric_logits"] = 200.0 * torch.eye(3, dtype=torch.float64)[None] - 200.0 * (
        1 - torch.eye(3, dtype=torch.float64)
    )

    def compute(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        each = {name: value for name, value in inputs.items() if name != "corners"}
        return {"means": bind(binder, inputs["corners"], each).means}

    return compare(compute, {"corners": TRIANGLES["equilateral"][0], **rows}).as_error()
