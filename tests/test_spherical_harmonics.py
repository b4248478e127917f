import math

import pytest
import torch

from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb, spherical_harmonics


def _fibonacci_sphere(count: int) -> torch.Tensor:
    index = torch.arange(count, dtype=torch.float64) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = math.pi * (1.0 + math.sqrt(5.0)) * index
    radius = (1.0 - z * z).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=1)


def test_basis_is_orthonormal_on_the_sphere():
    basis = spherical_harmonics(_fibonacci_sphere(20_000), degree=3)
    gram = basis.T @ basis * (4.0 * math.pi / basis.shape[0])
    torch.testing.assert_close(gram, torch.eye(16, dtype=torch.float64), atol=2e-4, rtol=0.0)


@pytest.mark.parametrize(
    ("index", "direction", "value"),
    [
        # The constants printed in the 3DGS paper's code, at directions where one term is left.
        (0, (0.0, 0.0, 1.0), 0.28209479177387814),
        (1, (0.0, 1.0, 0.0), -0.4886025119029199),
        (2, (0.0, 0.0, 1.0), 0.4886025119029199),
        (3, (1.0, 0.0, 0.0), -0.4886025119029199),
        (6, (0.0, 0.0, 1.0), 2 * 0.31539156525252005),
        (8, (1.0, 0.0, 0.0), 0.5462742152960396),
        (9, (0.0, 1.0, 0.0), 0.5900435899266435),
        (12, (0.0, 0.0, 1.0), 2 * 0.3731763325901154),
        (15, (1.0, 0.0, 0.0), -0.5900435899266435),
    ],
)
def test_known_values(index: int, direction: tuple[float, float, float], value: float):
    basis = spherical_harmonics(torch.tensor([direction], dtype=torch.float64), degree=3)
    assert basis[0, index].item() == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize("count", [1, 4, 9, 16])
def test_gradients(count: int):
    generator = torch.Generator().manual_seed(count)
    sh = (0.1 * torch.randn(5, count, 3, dtype=torch.float64, generator=generator)).requires_grad_(True)
    means = torch.randn(5, 3, dtype=torch.float64, generator=generator).requires_grad_(True)
    camera = torch.tensor([0.3, -0.2, 3.0], dtype=torch.float64, requires_grad=True)
    inputs = (sh,) if count == 1 else (sh, means, camera)
    assert torch.autograd.gradcheck(lambda *given: sh_to_rgb(*given, *(means, camera)[len(given) - 1 :]), inputs)


def test_constant_band_reads_no_positions():
    sh = torch.ones(2, 1, 3, requires_grad=True)
    means = torch.full((2, 3), float("nan"), requires_grad=True)
    rgb = sh_to_rgb(sh, means, torch.zeros(3))
    rgb.sum().backward()
    assert means.grad is None
    torch.testing.assert_close(rgb, torch.full((2, 3), 0.5 + 0.28209479177387814))


def test_colour_is_clamped_at_zero():
    sh = torch.full((1, 1, 3), -5.0, requires_grad=True)
    rgb = sh_to_rgb(sh, torch.zeros(1, 3), torch.zeros(3))
    rgb.sum().backward()
    assert (rgb == 0).all()
    assert (sh.grad == 0).all()


def test_mean_at_the_camera_is_finite():
    sh = torch.ones(1, 16, 3, dtype=torch.float64, requires_grad=True)
    means = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    sh_to_rgb(sh, means, torch.zeros(3, dtype=torch.float64)).sum().backward()
    assert torch.isfinite(sh.grad).all()
    assert torch.isfinite(means.grad).all()


def test_wrong_number_of_coefficients():
    with pytest.raises(ValueError, match="1, 4, 9 or 16"):
        sh_to_rgb(torch.zeros(2, 5, 3), torch.zeros(2, 3), torch.zeros(3))
