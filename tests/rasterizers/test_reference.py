"""The definition itself: gradients against finite differences, and images with known answers."""

import math
from dataclasses import replace

import pytest
import torch

from sculpt_framework.rasterizers import Rasterizer
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig
from tests.rasterizers.splats import INPUTS, facing_splats, random_splats, rendered

CPU = torch.device("cpu")


def test_gradients_by_finite_differences():
    splats = random_splats(count=5, channels=2, width=6, height=5, focal=6.0)
    splats = replace(splats, scales=splats.scales + 0.3)
    rasterizer = ReferenceRasterizerConfig().build(CPU)

    def images(*leaves):
        output = rasterizer.rasterize(
            *leaves[:5],
            replace(splats.camera, world_to_camera=leaves[5]),
            splats.background,
            low_pass_px2=0.3,
            alpha_max=0.999,
        )
        return output.features, output.alpha, output.depth

    leaves = [getattr(splats, name).clone() for name in INPUTS[:5]] + [splats.camera.world_to_camera.clone()]
    assert torch.autograd.gradcheck(images, [leaf.requires_grad_(True) for leaf in leaves])


def test_one_gaussian_in_closed_form():
    splats = facing_splats(torch.tensor([[0.0, 0.0, 2.0]]), torch.tensor([[0.1, 0.2, 0.5]]), opacity=0.6)
    output, _ = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    # On the axis the Jacobian is focal length / depth, and depth does not widen the splat.
    variance_x, variance_y = (32.0 / 2.0 * 0.1) ** 2 + 0.3, (32.0 / 2.0 * 0.2) ** 2 + 0.3
    dx, dy = 14.5 - 16.0, 18.5 - 16.0
    alpha = 0.6 * math.exp(-0.5 * (dx * dx / variance_x + dy * dy / variance_y))
    assert output.alpha[18, 14].item() == pytest.approx(alpha)
    assert output.depth[18, 14].item() == pytest.approx(2.0 * alpha)
    torch.testing.assert_close(output.features[18, 14], alpha * splats.features[0])
    assert output.alpha[0, 0].item() == 0.0


def test_order_ceiling_and_stop():
    """Three opaque screen-filling splats: the ceiling holds, the nearest wins, and the third is never reached."""
    means = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])
    splats = facing_splats(means, torch.full((3, 3), 1e3), opacity=1.0, size=4)
    splats = replace(splats, alpha_max=0.995)
    output, gradients = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    expected = 0.995 * splats.features[1] + 0.005 * 0.995 * splats.features[2]
    torch.testing.assert_close(output.features[2, 1], expected, rtol=1e-6, atol=1e-6)
    assert 1.0 - output.alpha[2, 1].item() < Rasterizer.TRANSMITTANCE_MIN
    assert (gradients["features"][0] == 0).all()
    assert (gradients["opacities"] == 0).all()


def test_pieces_change_nothing():
    whole = rendered(ReferenceRasterizerConfig().build(CPU), random_splats(count=40), torch.float64)
    cut = rendered(ReferenceRasterizerConfig(pairs_at_once=5000).build(CPU), random_splats(count=40), torch.float64)
    torch.testing.assert_close(whole[0].features, cut[0].features)
    for name in INPUTS:
        torch.testing.assert_close(whole[1][name], cut[1][name])


def test_a_crop_is_a_window_of_the_image():
    splats = random_splats(width=60, height=50)
    rasterizer = ReferenceRasterizerConfig().build(CPU)
    whole, _ = rendered(rasterizer, splats, torch.float64)
    window, _ = rendered(rasterizer, replace(splats, camera=splats.camera.crop(30, 20, 24, 18)), torch.float64)
    inside = whole.features[20:38, 30:54]
    # Splats that reach in from far outside the window are linearised at its margin, as 3DGS does at the image's.
    assert (window.features - inside).abs().median() < 1e-12
    torch.testing.assert_close(window.features, inside, rtol=0.0, atol=2e-2)


def test_no_gaussians():
    splats = facing_splats(torch.zeros(0, 3), torch.zeros(0, 3))
    output, _ = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    assert (output.alpha == 0).all()
