"""Every registered component, of this package or of another, keeps the contract of its slot."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from sculpt_framework import registry, testing
from sculpt_framework.binders import Binding
from sculpt_framework.config import ConstraintConfig
from sculpt_framework.constraints import Constraint
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig

CPU = torch.device("cpu")
CHECKS: dict[str, Callable[[Any], None]] = {
    "field": testing.check_field,
    "extractor": testing.check_extractor,
    "binder": testing.check_binder,
    "appearance": testing.check_appearance,
    "rasterizer": testing.check_rasterizer,
}
NEEDS_OTHER_MACHINES = {"triton", "gsplat"}


def registered(slot: str) -> list[str]:
    return [name for name in registry.names(slot) if name not in NEEDS_OTHER_MACHINES]


@pytest.mark.parametrize(("slot", "name"), [(slot, name) for slot in CHECKS for name in registered(slot)])
def test_component(slot: str, name: str):
    CHECKS[slot](registry.default(slot, name))


@pytest.mark.parametrize("name", registered("losses"))
def test_loss(name: str):
    extractor = FlexiCubesConfig(split="center", learn_weights=True, learn_deformation=True)
    testing.check_loss(registry.default("losses", name), extractor)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("gaussians_per_face", [1, 2, 3, 6])
@pytest.mark.parametrize("name", registered("constraints"))
def test_constraint(name: str, gaussians_per_face: int):
    binder = FaceBarycentricConfig(gaussians_per_face=gaussians_per_face)
    testing.check_constraint(registry.default("constraints", name), binder)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    "config",
    [
        FaceBarycentricConfig(gaussians_per_face=3, opacity="learnable"),
        FaceBarycentricConfig(reference="edges", rotation_rate=0.0, fit_outline=False),
    ],
)
def test_binder_in_its_other_ways(config: FaceBarycentricConfig):
    testing.check_binder(config)


class Negative(Constraint):
    def __call__(self, binding: Binding) -> Tensor:
        return -binding.scales.sum()


class NegativeConfig(ConstraintConfig):
    def build(self) -> Constraint:
        return Negative()


def test_checks_find_what_is_wrong(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(testing.ContractViolation, match="the penalty on a good face"):
        testing.check_constraint(NegativeConfig(weight=1.0), FaceBarycentricConfig())
    field = registry.default("field", "dense-grid")
    with pytest.raises(testing.ContractViolation, match="the centre is not inside"):
        testing.check_field(replace(field, sphere_radius=0.01))  # pyright: ignore
