import math

import pytest
import torch

from sculpt_framework.binders import Binding
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.binders.face_barycentric.placement import placement
from sculpt_plugins.constraints.boundary.config import BoundaryConfig
from sculpt_plugins.constraints.coverage.config import CoverageConfig
from sculpt_plugins.constraints.mee_scale.config import MeeScaleConfig
from sculpt_plugins.constraints.spacing.config import SpacingConfig
from tests.components.test_binder import rows_of, some_triangles, triangle_surface

EQUILATERAL = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0.5, math.sqrt(0.75), 0]]], dtype=torch.float64)


def bound(corners, k=1, scale=1.0, reference="steiner") -> Binding:
    binder = FaceBarycentricConfig(gaussians_per_face=k, scale=scale, reference=reference).build()
    surface = triangle_surface(corners)
    return binder.bind(surface, rows_of(binder, surface), blur=0.0)


def with_barycentrics(weights) -> Binding:
    count = weights.shape[1]
    binding = bound(EQUILATERAL.expand(weights.shape[0], 3, 3), k=count)
    return Binding(**{**vars(binding), "barycentrics": weights})


@pytest.mark.parametrize(("scale", "penalty"), [(0.5, 0.0), (1.0, 0.0), (2.0, 3.0)])
def test_steiner_eigenvalue_is_the_squared_ratio(scale, penalty):
    constraint = MeeScaleConfig(limit=1.0).build()
    value = constraint(bound(some_triangles(), scale=scale))
    torch.testing.assert_close(value, torch.tensor(penalty, dtype=torch.float64), atol=1e-5, rtol=1e-5)


def test_steiner_value_does_not_depend_on_the_order_of_vertices_and_the_paper_s_does():
    scalene = torch.tensor([[[0.0, 0, 0], [3, 0, 0], [0.2, 1, 0]]], dtype=torch.float64)
    turned = scalene[:, [1, 2, 0]]
    for form, same in (("steiner", True), ("edges", False)):
        constraint = MeeScaleConfig(form=form, limit=0.1).build()
        first, second = constraint(bound(scalene)), constraint(bound(turned))
        assert torch.allclose(first, second, rtol=1e-4) is same


def test_the_paper_s_diagonal_does_not_enclose_an_equilateral_triangle():
    """DESIGN: its corners lie at 1.33 where an enclosing ellipse has at most 1."""
    corners = bound(EQUILATERAL).tangent_corners[0]
    edges = corners[1:] - corners[:1]
    radii = 0.5 * edges.norm(dim=1)
    assert ((corners / radii).square().sum(1)).max() == pytest.approx(4 / 3, rel=1e-6)


def test_repeated_eigenvalues_have_a_gradient():
    binding = bound(EQUILATERAL, scale=2.0)
    covariance = binding.tangent_covariance.detach().requires_grad_()
    value = MeeScaleConfig().build()(Binding(**{**vars(binding), "tangent_covariance": covariance}))
    value.backward()
    assert covariance.grad is not None
    assert torch.isfinite(covariance.grad).all()
    assert covariance.grad.abs().sum() > 0


@pytest.mark.parametrize("config", [BoundaryConfig(), SpacingConfig(), CoverageConfig(), MeeScaleConfig(limit=0.2)])
def test_gradients(config):
    constraint = config.build()
    weights = torch.rand(2, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) + 0.1
    weights = (weights / weights.sum(2, keepdim=True)).requires_grad_()
    base = bound(some_triangles(2), k=4, scale=0.8)
    spread = base.tangent_covariance.detach() * torch.tensor([[1.0, 1.0], [1.0, 1.3]], dtype=torch.float64)
    spread.requires_grad_()

    def value(weights, spread):
        symmetric = 0.5 * (spread + spread.transpose(2, 3))
        return constraint(Binding(**{**vars(base), "barycentrics": weights, "tangent_covariance": symmetric}))

    assert torch.autograd.gradcheck(value, (weights, spread))


def test_known_values():
    center = torch.full((1, 1, 3), 1 / 3, dtype=torch.float64)
    assert float(BoundaryConfig().build()(with_barycentrics(center))) == pytest.approx(math.exp(-10 / 3))
    corners = torch.eye(3, dtype=torch.float64)[None]
    assert float(CoverageConfig().build()(with_barycentrics(corners))) == 0
    assert float(SpacingConfig().build()(with_barycentrics(corners))) == pytest.approx(math.sqrt(2) - 1 / math.sqrt(3))
    # K = 2 on the edge of the simplex: no pair spans all three coordinates.
    pair = torch.tensor([[[0.9, 0.05, 0.05], [0.05, 0.9, 0.05]]], dtype=torch.float64)
    assert float(CoverageConfig().build()(with_barycentrics(pair))) >= 0.2


def test_one_gaussian_has_no_neighbour():
    binding = bound(some_triangles())
    assert float(SpacingConfig().build()(binding)) == 0
    assert float(CoverageConfig().build()(binding)) == 0


def test_coincident_gaussians_have_a_finite_gradient():
    weights = torch.full((1, 3, 3), 1 / 3, dtype=torch.float64, requires_grad=True)
    total = SpacingConfig().build()(with_barycentrics(weights)) + CoverageConfig().build()(with_barycentrics(weights))
    total.backward()
    assert weights.grad is not None
    assert torch.isfinite(weights.grad).all()


@pytest.mark.parametrize("form", ["steiner", "edges"])
def test_needles_and_points_have_finite_penalties(form):
    for corners in ([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-9, 0]], [[0.0, 0, 0], [0, 0, 0], [0, 0, 0]]):
        triangle = torch.tensor([corners], dtype=torch.float64, requires_grad=True)
        value = MeeScaleConfig(form=form, limit=0.1).build()(bound(triangle, k=2))
        value.backward()
        assert math.isfinite(float(value.detach()))
        assert triangle.grad is not None
        assert torch.isfinite(triangle.grad).all()


def test_starts_satisfy_what_their_number_allows():
    """The placement tables against the losses they start under (docs/background/choices.md)."""
    coverage = {k: float(CoverageConfig().build()(with_barycentrics(placement(k)[None]))) for k in (3, 4, 6, 9, 12)}
    assert coverage[12] <= coverage[3]
    assert all(value < 0.35 for value in coverage.values())


@pytest.mark.parametrize("reference", ["steiner", "edges"])
@pytest.mark.parametrize("limit", [1.0, 0.05])
def test_the_kernel_of_the_scale_constraint_is_the_twin(reference, limit):
    """Ratios on both sides of the limit, a needle, and a face of no area."""
    corners = torch.cat([some_triangles(3000), EQUILATERAL, EQUILATERAL * torch.tensor([1.0, 1e-5, 0.0])])
    corners = torch.cat([corners, corners[:1, [0, 0, 0]]])
    surface = triangle_surface(corners)
    binder = FaceBarycentricConfig(gaussians_per_face=2, reference=reference, fit_outline=False).build()
    rows = rows_of(binder, surface)
    rows["log_ratios"] += torch.randn(rows["log_ratios"].shape, generator=torch.Generator().manual_seed(1))
    rows["rotation"] += 0.3
    found = []
    for dtype in (torch.float32, torch.float64):
        binding = binder.bind(surface, rows, blur=0.0)
        covariance = binding.tangent_covariance.to(dtype).detach().requires_grad_()
        parts = {**vars(binding), "tangent_covariance": covariance}
        parts["tangent_corners"] = binding.tangent_corners.to(dtype)
        value = MeeScaleConfig(form=reference, limit=limit).build()(Binding(**parts))
        (2.0 * value).backward()
        found.append((value.detach().double(), covariance.grad.double()))
    torch.testing.assert_close(found[0][0], found[1][0], rtol=1e-5, atol=0)
    assert (found[1][1] != 0).any(dim=(2, 3)).double().mean() > 0.1
    torch.testing.assert_close(found[0][1], found[1][1], rtol=1e-3, atol=1e-6 * float(found[1][1].abs().max()))


def test_the_scale_constraint_repeats_to_the_last_bit_on_any_number_of_threads():
    before, found = torch.get_num_threads(), []
    binding = bound(some_triangles(5000).float(), scale=1.5)
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        found.append(MeeScaleConfig(limit=0.3).build()(binding))
    torch.set_num_threads(before)
    assert found[0] > 0
    assert found[0] == found[1] == found[2]
