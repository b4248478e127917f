"""The renderer of GOF: against the same in plain torch, closed forms, gradients."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from sculpt_framework.free_gaussians.row_kernels import ALPHA_MAX, ALPHA_MIN, FAR, NEAR
from sculpt_framework.types import Camera, Gaussians
from sculpt_plugins.methods.gof.rays import draw_rays
from tests.free_gaussians.shapes import CAMERA, ball

BLACK = torch.zeros(3, dtype=torch.float64)


def blobs(count: int, seed: int = 0, size: float = 0.4) -> Gaussians:
    random = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random, dtype=torch.float64)

    turns, _ = torch.linalg.qr(draw(count, 3, 3) - 0.5)
    return Gaussians(
        means=0.8 * (2 * draw(count, 3) - 1),
        scales=size * (0.1 + draw(count, 3)),
        rotations=turns,
        opacities=0.2 + 0.7 * draw(count),
        sh=draw(count, 1, 3) - 0.5,
        face=torch.full((count,), -1),
    )


def in_torch(gaussians: Gaussians, camera: Camera, smoothing: float) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """(colours over black, alpha, depth, normal, distortion with weights held) from the covariances."""
    local = gaussians.means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    rows, columns = torch.meshgrid(
        torch.arange(camera.height).double(), torch.arange(camera.width).double(), indexing="ij"
    )
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    ray = torch.stack([x, y, torch.ones_like(x)], dim=2) @ camera.world_to_camera[:3, :3]
    rgb, normal = torch.zeros(*x.shape, 3, dtype=torch.float64), torch.zeros(*x.shape, 3, dtype=torch.float64)
    depth, light, alphas, mapped = torch.zeros_like(x), torch.ones_like(x), torch.zeros_like(x), []
    for g in local[:, 2].argsort().tolist():
        variance = gaussians.scales[g].square()
        smooth = variance + smoothing * (local[g, 2].detach() / camera.fx).square()
        inverse = gaussians.rotations[g] @ torch.diag(1 / smooth) @ gaussians.rotations[g].T
        offset = gaussians.means[g] - camera.position
        peak = (ray @ inverse @ offset) / (ray @ inverse * ray).sum(dim=2)
        left = offset - peak[..., None] * ray
        value = (-0.5 * (left @ inverse * left).sum(dim=2)).exp()
        opacity = gaussians.opacities[g] * (variance / smooth).sqrt().prod()
        alpha = (opacity * value).clamp(max=ALPHA_MAX)
        alpha = torch.where((alpha < ALPHA_MIN) | (peak <= 1e-2) | (local[g, 2] <= 1e-2), 0.0, alpha)
        weight = light * alpha
        plane = -torch.nn.functional.normalize(ray @ inverse, dim=2)
        rgb = rgb + weight[..., None] * (0.5 + gaussians.sh[g, 0] * 0.5 / math.sqrt(math.pi))
        normal = normal + weight[..., None] * plane
        depth, light, alphas = depth + weight * peak, light * (1 - alpha), alphas + weight
        mapped.append((weight.detach(), FAR / (FAR - NEAR) * (1 - NEAR / torch.where(weight > 0, peak, 1.0))))
    distortion = torch.zeros_like(x)
    for i, (first, m) in enumerate(mapped):
        for second, n in mapped[:i]:
            distortion = distortion + first * second * (m - n).square()
    return rgb, alphas, depth, normal, distortion


def images(gaussians: Gaussians, camera: Camera, smoothing: float) -> tuple[Tensor, ...]:
    drawn = draw_rays(gaussians, camera, BLACK, smoothing)
    rendering = drawn.rendering
    assert rendering.normal is not None
    return rendering.rgb, rendering.alpha, rendering.depth, rendering.normal, drawn.distortion


@pytest.mark.slow
@pytest.mark.parametrize("smoothing", [0.0, 2.0])
def test_it_draws_and_slopes_are_as_in_torch(smoothing: float):
    given = blobs(12)
    names = ("means", "scales", "rotations", "opacities", "sh")
    random, slopes, outputs = torch.Generator(), [], []
    for draw in (images, in_torch):
        inputs = {name: getattr(given, name).clone().requires_grad_() for name in names}
        found = draw(replace(given, **inputs), CAMERA, smoothing)
        to = [torch.rand(each.shape, generator=random.manual_seed(1), dtype=torch.float64) for each in found]
        torch.stack([(each * by).sum() for each, by in zip(found, to, strict=True)]).sum().backward()
        outputs.append(found)
        slopes.append([inputs[name].grad for name in names])
    assert 0.5 < float(outputs[1][1].detach().max()) < 1
    for own, other in zip(*outputs, strict=True):
        assert torch.allclose(own, other, atol=1e-9)
    for own, other in zip(*slopes, strict=True):
        assert torch.allclose(own, other, atol=1e-8, rtol=1e-6)


def test_slopes():
    some = blobs(3, seed=2)
    camera = replace(CAMERA, width=9, height=8, cx=4.5, cy=4.0, fx=12.0, fy=12.0)
    to = torch.rand(8, 9, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(3))

    def value(means: Tensor, scales: Tensor, rotations: Tensor, opacities: Tensor, sh: Tensor) -> Tensor:
        # Smoothing holds the depth and the distortion its weights; both are compared with torch above.
        given = replace(some, means=means, scales=scales, rotations=rotations, opacities=opacities, sh=sh)
        rgb, alpha, depth, normal, _ = images(given, camera, 0.0)
        return (torch.cat([rgb, normal, alpha[..., None], depth[..., None]], dim=2) * to).sum()

    inputs = [some.means, some.scales, some.rotations, some.opacities, some.sh]
    assert gradcheck(value, [each.clone().requires_grad_() for each in inputs], atol=1e-5, rtol=1e-3)


def test_alpha_of_a_ball_is_that_of_its_distance_from_the_ray():
    drawn = draw_rays(ball(), CAMERA, BLACK, 0.0).rendering
    x, y = (20.5 - CAMERA.cx) / CAMERA.fx, (4.5 - CAMERA.cy) / CAMERA.fy
    squared = 9 * (1 - 1 / (x * x + y * y + 1))
    assert float(drawn.alpha[4, 20]) == pytest.approx(0.9 * math.exp(-0.5 * squared / 0.25), rel=1e-9)
    # The peak is where the ray is nearest to the centre, and the normal is along the ray.
    assert float(drawn.depth[4, 20] / drawn.alpha[4, 20]) == pytest.approx(3 / (x * x + y * y + 1), rel=1e-9)
    assert drawn.normal is not None
    ray = torch.tensor([x, y, 1.0]).double() @ CAMERA.world_to_camera[:3, :3]
    assert torch.allclose(drawn.normal[4, 20] / drawn.alpha[4, 20], -ray / ray.norm(), atol=1e-9)


def test_smoothing_widens_and_thins():
    drawn = draw_rays(ball(radius=1e-4), CAMERA, BLACK, 0.2).rendering
    variance = 1e-8 + 0.2 * (3 / 40) ** 2
    opacity = 0.9 * (1e-8 / variance) ** 1.5
    assert opacity < ALPHA_MIN
    assert float(drawn.alpha.max()) == 0
    drawn = draw_rays(ball(radius=0.1), CAMERA, BLACK, 0.2).rendering
    assert 0.7 < float(drawn.alpha.max()) < 0.9 * (0.01 / (0.01 + 0.2 * (3 / 40) ** 2)) ** 1.5 + 1e-9


@pytest.mark.parametrize(
    "change",
    [
        {"means": torch.tensor([[0.0, 0, -4]]).double()},
        {"means": torch.tensor([[0.0, 0, -3]]).double()},
        {"means": torch.tensor([[float("nan"), 0, 0]]).double()},
        {"opacities": torch.zeros(1).double()},
    ],
    ids=["behind the camera", "at the camera", "not a number", "clear"],
)
def test_what_cannot_be_seen_is_not_drawn(change: dict[str, Tensor]):
    found = images(replace(ball(), **change), CAMERA, 0.2)
    for image in found:
        assert (image == 0).all()


def test_a_disk_seen_edge_on_has_finite_slopes():
    scales = torch.tensor([[0.0, 0.5, 0.5]], dtype=torch.float64, requires_grad=True)
    found = images(replace(ball(), scales=scales), replace(CAMERA, cx=12.0), 0.2)
    torch.stack([image.sum() for image in found]).sum().backward()
    assert all(torch.isfinite(image).all() for image in found)
    assert scales.grad is not None
    assert torch.isfinite(scales.grad).all()
