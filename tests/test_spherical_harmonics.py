import math

import pytest
import torch

from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb, sh_to_rgb_in_torch, spherical_harmonics


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


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_mean_at_the_camera_has_the_constant_colour(dtype: torch.dtype):
    sh = torch.ones(1, 16, 3, dtype=dtype, requires_grad=True)
    means = torch.zeros(1, 3, dtype=dtype, requires_grad=True)
    rgb = sh_to_rgb(sh, means, torch.zeros(3, dtype=dtype))
    rgb.sum().backward()
    basis = spherical_harmonics(torch.zeros(1, 3, dtype=dtype), degree=3)
    torch.testing.assert_close(rgb, (0.5 + basis.sum()).expand(1, 3))
    torch.testing.assert_close(sh.grad, basis[..., None].expand(1, 16, 3))
    assert (means.grad == 0).all()


def harmonics_of_many(count: int, dtype: torch.dtype) -> tuple[torch.Tensor, ...]:
    """Coefficients, means and a camera among them; some of the colours are clamped."""
    generator = torch.Generator().manual_seed(count)
    sh = torch.randn(300, count, 3, generator=generator)
    means = torch.randn(300, 3, generator=generator)
    return tuple(each.to(dtype).requires_grad_() for each in (sh, means, torch.tensor([0.3, -0.2, 1.0])))


@pytest.mark.parametrize("count", [4, 9, 16])
def test_compiled_colours_and_gradients_are_those_of_torch(count: int):
    weights = torch.randn(300, 3, generator=torch.Generator().manual_seed(1))
    found = []
    for compute, dtype in ((sh_to_rgb, torch.float32), (sh_to_rgb_in_torch, torch.float64)):
        inputs = harmonics_of_many(count, dtype)
        rgb = compute(*inputs)
        assert 0.1 < (rgb == 0).double().mean() < 0.4
        (rgb * weights.to(dtype)).sum().backward()
        found.append([rgb.detach().double(), *(each.grad.double() for each in inputs)])
    for compiled, exact in zip(*found, strict=True):
        torch.testing.assert_close(compiled, exact, atol=2e-6 * float(exact.abs().max()), rtol=1e-4)


def test_places_that_are_not_learned_get_no_gradient():
    sh, means, camera = harmonics_of_many(16, torch.float32)
    sh_to_rgb(sh, means.detach(), camera.detach()).sum().backward()
    assert means.grad is None
    again = sh.detach().clone().requires_grad_()
    sh_to_rgb(again, means, camera).sum().backward()
    torch.testing.assert_close(sh.grad, again.grad, atol=0.0, rtol=0.0)


def test_compiled_colours_take_any_memory_layout():
    sh, means, camera = (each.detach() for each in harmonics_of_many(16, torch.float32))
    turned = sh.permute(2, 1, 0).contiguous().permute(2, 1, 0)
    assert not turned.is_contiguous()
    torch.testing.assert_close(sh_to_rgb(turned, means, camera), sh_to_rgb(sh, means, camera), atol=0.0, rtol=0.0)
    assert sh_to_rgb(sh[:0], means[:0], camera).shape == (0, 3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_is_no_number_shows_in_its_colour_alone(dtype: torch.dtype):
    sh, means, camera = (each.detach().clone() for each in harmonics_of_many(16, dtype))
    sh[3, 7, 1] = float("nan")
    means[5, 2] = float("nan")
    bad = torch.isnan(sh_to_rgb(sh, means, camera))
    expected = torch.zeros(300, 3, dtype=torch.bool)
    expected[3, 1] = expected[5] = True
    assert torch.equal(bad, expected)


def test_wrong_number_of_coefficients():
    with pytest.raises(ValueError, match="1, 4, 9 or 16"):
        sh_to_rgb(torch.zeros(2, 5, 3), torch.zeros(2, 3), torch.zeros(3))
