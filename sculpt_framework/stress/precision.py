"""One computation in float32 and in float64 from the same inputs."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from sculpt_framework.stress.cases import Measured

Compute = Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
"""Named outputs from named inputs of one floating-point type, in that type."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Relative differences: norms over norms. Of values the worst tensor counts. Gradients are taken together, each by
    the share of its input's own size, which makes them comparable, and what is zero but for rounding harmless."""

    value_error: float
    gradient_error: float
    largest_gradient: float
    """Largest absolute entry of any float32 gradient, by the share of its input's size."""
    finite: bool

    @property
    def error(self) -> float:
        return max(self.value_error, self.gradient_error)

    def as_error(self) -> Measured:
        """The error is the figure."""
        note = f"values {self.value_error:.1e}, gradients {self.gradient_error:.1e}"
        return Measured(value=self.error if self.finite else math.nan, note=note, float32_error=self.error)

    def as_value_error(self) -> Measured:
        """The error of values alone: where a kink leaves the choice among gradients open."""
        note = f"gradients up to {self.largest_gradient:.1e}"
        return Measured(value=self.value_error if self.finite else math.nan, note=note, float32_error=self.value_error)

    def as_gradient(self) -> Measured:
        """The largest gradient is the figure: where rounding decides, float32 need only stay small and finite."""
        value = self.largest_gradient if self.finite else math.nan
        return Measured(value=value, note="" if self.finite else "not finite", float32_error=self.error)


def compare(compute: Compute, inputs: Mapping[str, Tensor], single: Compute | None = None) -> Comparison:
    """Values of ``compute`` and gradients of a fixed random weighting of them, by every input, in both types.

    Inputs are rounded to float32 first, so that both begin at the same numbers. ``single`` computes the float32 side
    where that is other code (a compiled kernel beside its reference).
    """
    rounded = {name: value.float() for name, value in inputs.items()}
    exact = _values_and_gradients(compute, {name: value.double() for name, value in rounded.items()})
    found = _values_and_gradients(single or compute, rounded)
    sizes = [float(value.double().square().mean().sqrt()) or 1.0 for value in rounded.values()]
    slopes = [
        torch.cat([size * slope.double().reshape(-1) for size, slope in zip(sizes, part[1], strict=True)])
        for part in (found, exact)
    ]
    values = zip(found[0], exact[0], strict=True)
    return Comparison(
        value_error=max((relative(single, double) for single, double in values), default=0.0),
        gradient_error=relative(*slopes),
        largest_gradient=float(slopes[0].abs().max()),
        finite=all(bool(torch.isfinite(each).all()) for part in (*exact, *found) for each in part),
    )


@contextmanager
def default_type(dtype: torch.dtype) -> Iterator[None]:
    """What is built meanwhile takes this type where it asks torch for its default."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def relative(found: Tensor, exact: Tensor) -> float:
    """Norm of the difference over the norm of ``exact``; of two zeros 0."""
    difference, size = float((found.double() - exact.double()).norm()), float(exact.double().norm())
    return difference / size if size > 0 else difference


def _values_and_gradients(compute: Compute, inputs: Mapping[str, Tensor]) -> tuple[list[Tensor], list[Tensor]]:
    leaves = {name: value.clone().requires_grad_(True) for name, value in inputs.items()}
    outputs = compute(leaves)
    generator = torch.Generator().manual_seed(5)
    total = torch.zeros((), dtype=next(iter(inputs.values())).dtype)
    for name in sorted(outputs):
        weights = torch.randn(outputs[name].shape, dtype=torch.float64, generator=generator)
        total = total + (weights.to(outputs[name]) * outputs[name]).sum()
    gradients: list[Tensor] = [torch.zeros_like(leaf) for leaf in leaves.values()]
    if total.requires_grad:
        given = torch.autograd.grad(total, list(leaves.values()), allow_unused=True)
        gradients = [zero if one is None else one for zero, one in zip(gradients, given, strict=True)]
    return [outputs[name].detach() for name in sorted(outputs)], gradients
