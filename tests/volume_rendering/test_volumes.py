"""The volumes of the methods: known answers, gradients, what is said at their limits."""

import math
from dataclasses import replace

import pytest
import torch
from torch import nn
from torch.autograd import gradcheck

import sculpt_framework as sculpt
from sculpt_framework.volume_rendering.logistic import opacity
from sculpt_framework.volume_rendering.sdf_volume import bending, eikonal, slopes, values_around
from sculpt_framework.volume_rendering.stretches import OccupiedCells, Rays, stretches_of
from sculpt_framework.volume_rendering.weights import weigh
from sculpt_plugins.methods.nerf.config import NerfConfig
from sculpt_plugins.methods.nerf.volume import NerfVolume
from sculpt_plugins.methods.volsdf.volume import density

FULL = OccupiedCells(occupied=torch.ones(4, 4, 4, dtype=torch.bool), low=(-1.0, -1.0, -1.0), cell=0.5)
ALONG = Rays(origins=torch.tensor([[-2.0, 0.05, 0.05]]), directions=torch.tensor([[1.0, 0.0, 0.0]]))


def seen_depth(kind: str, sharpness: float, plane: float) -> tuple[float, float]:
    """Of a plane that faces the camera: where along x the ray's light comes from, on average, and how much does."""
    stretches = stretches_of(ALONG, FULL, 0.01)
    if kind == "neus":
        first, second = (plane - stretches.points(ALONG, share)[:, 0] for share in (0.0, 1.0))
        alphas = opacity(first, second, torch.tensor(sharpness))
    else:
        sdf = plane - stretches.points(ALONG, 0.5)[:, 0]
        alphas = -torch.expm1(-0.01 * density(sdf, torch.tensor(1 / sharpness)))
    weights, through = weigh(alphas, stretches)
    middle = stretches.points(ALONG, 0.5)[:, 0]
    return float((weights * middle).sum() / weights.sum()), float(1 - through)


@pytest.mark.parametrize("kind", ["neus", "volsdf"])
def test_a_plane_is_seen_where_it_is(kind: str):
    for plane in (-0.3, 0.2):
        where, alpha = seen_depth(kind, 200.0, plane)
        assert abs(where - plane) < 0.01
        assert alpha > 0.999


def test_neus_is_not_biased_where_volsdf_is_by_its_width():
    """NeuS' paper, fig. 2: the weight is symmetric about the surface at any sharpness; a density that follows the
    distance lets light in by about beta."""
    neus, _ = seen_depth("neus", 25.0, 0.0)
    volsdf, _ = seen_depth("volsdf", 25.0, 0.0)
    assert abs(neus) < 2e-3
    assert 0.2 / 25 < abs(volsdf) < 2 / 25


def test_opacities_stay_finite_far_inside_and_outside():
    far = torch.tensor([80.0, -80.0, 1e4, -1e4], requires_grad=True)
    found = opacity(far, far - 0.01, torch.tensor(500.0))
    found.sum().backward()
    assert torch.isfinite(found).all()
    assert far.grad is not None
    assert torch.isfinite(far.grad).all()
    assert found.detach()[1] == pytest.approx(1 - math.exp(-5), rel=1e-3)
    assert found.detach()[2] == 0
    dense = density(torch.tensor([1e4, -1e4, 0.0]), torch.tensor(0.01))
    assert dense.tolist() == pytest.approx([0, 100, 50])


def test_a_distance_that_grows_hides_nothing():
    first = torch.tensor([0.1, -0.2], dtype=torch.float64, requires_grad=True)
    found = opacity(first, first + 0.05, torch.tensor(30.0, dtype=torch.float64))
    found.sum().backward()
    assert found.tolist() == [0, 0]
    assert first.grad is not None
    assert first.grad.tolist() == [0, 0]


def test_slopes_of_opacity_and_density():
    sdf = torch.tensor([0.05, -0.02, 0.3, -0.4], dtype=torch.float64, requires_grad=True)
    sharpness = torch.tensor(12.0, dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda given, of: opacity(given, given - 0.03, of), (sdf, sharpness))
    beta = torch.tensor(0.1, dtype=torch.float64, requires_grad=True)
    assert gradcheck(density, (sdf, beta))


def test_nerf_hides_by_its_density_and_its_slope_is_known():
    """With nothing learned the logarithm of the density is 1 - 4 r^2, plus what the decoder's bias adds."""
    config = sculpt.methods["nerf"]()
    assert isinstance(config, NerfConfig)
    small = replace(config, radiance=replace(config.radiance, num_levels=2, log2_table=8, hidden_units=4))
    volume = NerfVolume(small).double()
    # Of the layer that says the density and the features for the colour.
    weight, bias = (parameter for parameter in volume.parameters() if len(parameter) == 1 + config.features)
    with torch.no_grad():
        weight.zero_()
        bias.zero_()
    rays = Rays(origins=ALONG.origins.double(), directions=ALONG.directions.double())
    stretches = stretches_of(rays, FULL, 0.05)
    exact = (1 - 4 * stretches.points(rays, 0.5).square().sum(dim=1)).exp()
    alphas = volume.alphas(rays, stretches)
    assert torch.allclose(alphas.detach(), 1 - (-0.05 * exact).exp(), rtol=1e-6)
    (slope,) = torch.autograd.grad(alphas.sum(), bias)
    assert float(slope[0]) == pytest.approx(float((0.05 * exact * (-0.05 * exact).exp()).sum()), rel=1e-6)
    assert slope[1:].abs().max() == 0


class Cone(nn.Module):
    def forward(self, points: torch.Tensor) -> torch.Tensor:
        return 2 * points[:, 0] - points[:, 1] + 0.5


def test_the_eikonal_term():
    points = torch.rand(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(slopes(Cone(), points, 0.01), torch.tensor([2.0, -1, 0], dtype=torch.float64), atol=1e-12)
    slope = torch.tensor([[0.0, 0, 0], [0.6, 0, 0.8], [3.0, 0, 0]], dtype=torch.float64, requires_grad=True)
    value = eikonal(slope)
    value.backward()
    assert float(value.detach()) == pytest.approx((1 + 0 + 4) / 3)
    assert slope.grad is not None
    assert slope.grad[0].tolist() == [0, 0, 0]
    assert gradcheck(eikonal, (slope.detach()[1:].requires_grad_(),))


class Ball(nn.Module):
    def forward(self, points: torch.Tensor) -> torch.Tensor:
        return points.norm(dim=1) - 0.5


def bent(points: torch.Tensor) -> torch.Tensor:
    return bending(values_around(Ball(), points, 0.01), Ball()(points), 0.01)


def test_bending_is_twice_the_mean_curvature_beside_the_surface():
    beside = torch.tensor([[0.5, 0, 0], [0, -0.3, 0.4], [0, 0, 0.52]], dtype=torch.float64)
    far = torch.tensor([[0.1, 0, 0], [0.9, 0, 0]], dtype=torch.float64)
    expected = (2 / beside.norm(dim=1)).mean()
    assert bent(torch.cat([beside, far])) == pytest.approx(float(expected), rel=1e-3)
    assert bent(far) == 0


def test_bending_has_its_gradient():
    around = torch.randn(2, 3, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    middle = torch.tensor([0.01, -0.02, 0.03, 0.2, -0.7], dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda a, m: bending(a, m, 0.1), (around, middle))
