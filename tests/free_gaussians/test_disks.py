"""The renderer of 2DGS: against the same in plain torch, known answers, gradients."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

import sculpt_framework as sculpt
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.free_gaussians.row_kernels import ALPHA_MAX, ALPHA_MIN, FAR, NEAR
from sculpt_framework.free_gaussians.surface_terms import normal_difference
from sculpt_framework.stress.small import small_scene
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.methods.splatting_2d.disks import draw_disks
from tests.learning import beginning_of

CAMERA = Camera(
    world_to_camera=torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]], dtype=torch.float64),
    fx=40.0, fy=44.0, cx=12.5, cy=9.0, width=26, height=20,
)  # fmt: skip
BLACK = torch.zeros(3, dtype=torch.float64)


def disks(count: int, seed: int = 0, size: float = 0.3) -> Gaussians:
    random = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random, dtype=torch.float64)

    turns, _ = torch.linalg.qr(draw(count, 3, 3) - 0.5)
    return Gaussians(
        means=0.8 * (2 * draw(count, 3) - 1),
        scales=torch.cat([torch.zeros(count, 1, dtype=torch.float64), size * (0.3 + draw(count, 2))], dim=1),
        rotations=turns,
        opacities=0.2 + 0.7 * draw(count),
        sh=draw(count, 1, 3) - 0.5,
        face=torch.full((count,), -1),
    )


def in_torch(gaussians: Gaussians, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """(colours over black, alpha, depth) by the ray's own meeting with each disk's plane."""
    order = (gaussians.means @ camera.world_to_camera[2, :3]).argsort()
    rows, columns = torch.meshgrid(
        torch.arange(camera.height).double(), torch.arange(camera.width).double(), indexing="ij"
    )
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    ray = torch.stack([x, y, torch.ones_like(x)], dim=2) @ camera.world_to_camera[:3, :3]
    start = camera.position
    rgb, depth = torch.zeros(*x.shape, 3, dtype=torch.float64), torch.zeros_like(x)
    light = torch.ones_like(x)
    for g in order.tolist():
        normal, axes = gaussians.rotations[g, :, 0], gaussians.rotations[g, :, 1:]
        along = ((gaussians.means[g] - start) @ normal) / (ray @ normal)
        across = (start + along[..., None] * ray - gaussians.means[g]) @ axes / gaussians.scales[g, 1:]
        value = (-0.5 * across.square().sum(dim=2)).exp()
        local = camera.world_to_camera[:3, :3] @ gaussians.means[g] + camera.world_to_camera[:3, 3]
        right = columns + 0.5 - (local[0] / local[2] * camera.fx + camera.cx)
        down = rows + 0.5 - (local[1] / local[2] * camera.fy + camera.cy)
        blurred = (-(right.square() + down.square())).exp()
        met = (value >= blurred) & (along > 0)
        alpha = (gaussians.opacities[g] * torch.where(met, value, blurred)).clamp(max=ALPHA_MAX)
        alpha = torch.where(alpha < ALPHA_MIN, 0.0, alpha)
        weight = light * alpha
        rgb += weight[..., None] * (0.5 + gaussians.sh[g, 0] * 0.5 / math.sqrt(math.pi))
        depth += weight * torch.where(met, along, local[2])
        light = light * (1 - alpha)
    return rgb, 1 - light, depth


@pytest.mark.slow
def test_it_draws_what_torch_does():
    some = disks(12, size=0.6)
    drawn, (rgb, alpha, depth) = draw_disks(some, CAMERA, BLACK).rendering, in_torch(some, CAMERA)
    assert float(alpha.max()) > 0.5
    assert torch.allclose(drawn.rgb, rgb, atol=1e-6)
    assert torch.allclose(drawn.alpha, alpha, atol=1e-6)
    assert torch.allclose(drawn.depth, depth, atol=1e-6)


def test_a_disk_that_faces_the_camera():
    one = Gaussians(
        means=torch.zeros(1, 3, dtype=torch.float64),
        scales=torch.tensor([[0.0, 0.5, 0.5]], dtype=torch.float64),
        rotations=torch.tensor([[[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]], dtype=torch.float64),
        opacities=torch.tensor([0.9], dtype=torch.float64),
        sh=torch.zeros(1, 1, 3, dtype=torch.float64),
        face=torch.full((1,), -1),
    )
    found = draw_disks(one, CAMERA, BLACK)
    y = (9.5 - 9.0) / 44 * 3 / 0.5
    assert float(found.rendering.alpha[9, 12]) == pytest.approx(0.9 * math.exp(-0.5 * y * y), rel=1e-6)
    depth = found.rendering.depth / found.rendering.alpha
    assert torch.allclose(depth[5:15, 8:18], torch.full((10, 10), 3.0, dtype=torch.float64))
    assert found.rendering.normal is not None
    assert (found.rendering.normal[9, 12, :2] == 0).all()
    assert float(found.rendering.normal[9, 12, 2]) < 0
    assert float(found.distortion.abs().max()) < 1e-12
    # Edge on there is a dot, and no number that is not one.
    edge = replace(one, rotations=one.rotations[:, :, [1, 0, 2]])
    dot = draw_disks(edge, CAMERA, BLACK).rendering
    assert torch.isfinite(dot.depth).all()
    assert float(dot.alpha[9, 12]) > 0.5
    # Behind the camera there is nothing.
    gone = draw_disks(replace(one, means=one.means - torch.tensor([0, 0, 4.0])), CAMERA, BLACK).rendering
    assert float(gone.alpha.abs().max()) == 0


def test_the_distortion_of_two_disks():
    two = replace(
        disks(2),
        means=torch.tensor([[0.0, 0, 0], [0, 0, 0.5]], dtype=torch.float64),
        scales=torch.tensor([[0.0, 5, 5]] * 2, dtype=torch.float64),
        rotations=torch.tensor([[[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]] * 2, dtype=torch.float64),
        opacities=torch.tensor([0.5, 0.8], dtype=torch.float64),
    )
    found = draw_disks(two, CAMERA, BLACK).distortion[9, 12]
    m = [FAR / (FAR - NEAR) * (1 - NEAR / z) for z in (3.0, 3.5)]
    assert float(found) == pytest.approx(0.5 * 0.5 * 0.8 * (m[0] - m[1]) ** 2, rel=1e-3)


def test_the_median_depth_is_of_the_disk_at_which_half_of_the_light_is_gone():
    two = replace(
        disks(2),
        means=torch.tensor([[0.0, 0, 0], [0, 0, 0.5]], dtype=torch.float64),
        scales=torch.tensor([[0.0, 0.3, 0.3]] * 2, dtype=torch.float64),
        rotations=torch.tensor([[[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]] * 2, dtype=torch.float64),
    )
    for front, depth in ((0.4, 3.5), (0.6, 3.0)):
        opacities = torch.tensor([front, 0.8], dtype=torch.float64)
        median = draw_disks(replace(two, opacities=opacities), CAMERA, BLACK).median
        assert float(median[9, 12]) == pytest.approx(depth)
        assert float(median[0, 0]) == 0


@pytest.mark.slow
def test_slopes():
    some = disks(3, seed=2)
    camera = replace(CAMERA, width=9, height=8, cx=4.5, cy=4.0, fx=12.0, fy=12.0)
    to = torch.rand(8, 9, 9, dtype=torch.float64, generator=torch.Generator().manual_seed(3))

    def value(means: Tensor, scales: Tensor, rotations: Tensor, opacities: Tensor, sh: Tensor) -> Tensor:
        given = replace(some, means=means, scales=scales, rotations=rotations, opacities=opacities, sh=sh)
        drawn = draw_disks(given, camera, BLACK)
        assert drawn.rendering.normal is not None
        images = [drawn.rendering.rgb, drawn.rendering.normal]
        images += [each[..., None] for each in (drawn.rendering.alpha, drawn.rendering.depth, 100 * drawn.distortion)]
        return (torch.cat(images, dim=2) * to).sum()

    inputs = [some.means, some.scales, some.rotations, some.opacities, some.sh]
    assert gradcheck(value, [each.clone().requires_grad_() for each in inputs], atol=1e-5, rtol=1e-3)


def test_normals_of_a_plane_agree_with_its_disks_and_not_with_others():
    rows, columns = torch.meshgrid(
        torch.arange(CAMERA.height).double(), torch.arange(CAMERA.width).double(), indexing="ij"
    )
    x, y = (columns + 0.5 - CAMERA.cx) / CAMERA.fx, (rows + 0.5 - CAMERA.cy) / CAMERA.fy
    normal = torch.tensor([0.6, 0.0, -0.8], dtype=torch.float64)
    depth = 3 * normal[2] / (normal[0] * x + normal[1] * y + normal[2])
    full = torch.ones_like(depth)

    def difference(of: Tensor) -> float:
        rendering = Rendering(
            rgb=torch.zeros(*depth.shape, 3), alpha=full, depth=depth, normal=of.expand(*depth.shape, 3)
        )
        return float(normal_difference(rendering, CAMERA))

    assert difference(normal) == pytest.approx(0, abs=1e-7)
    assert difference(torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)) == pytest.approx(0.2, abs=1e-6)


@pytest.mark.slow
def test_it_learns():
    config = sculpt.methods["splatting-2d"]()
    assert isinstance(config, FreeGaussiansConfig)
    small = replace(config, steps=150, gaussians=600, mesh_cells=32, density=replace(config.density, every=10))
    session = sculpt.Session(small_scene(), replace(small, holdout_every=4))
    first = beginning_of(session)
    session.run()
    assert session.curve[-1]["psnr"] > first["psnr"] + 4
    assert session.mesh().to_trimesh().is_watertight


def test_slopes_of_the_normal_term():
    """In both normals, the drawn one and that of the depths, and in the opacity."""
    at = Camera(world_to_camera=torch.eye(4, dtype=torch.float64), fx=60.0, fy=60.0, cx=3.0, cy=3.0, width=6, height=6)
    random = torch.Generator().manual_seed(0)
    normal, depth, alpha = (
        torch.rand(*shape, dtype=torch.float64, generator=random) for shape in ((6, 6, 3), (6, 6), (6, 6))
    )
    inputs = normal, 2 + 0.1 * depth, 0.6 + 0.3 * alpha

    def term(normals: torch.Tensor, depths: torch.Tensor, alphas: torch.Tensor) -> torch.Tensor:
        rendering = Rendering(rgb=torch.zeros(6, 6, 3), alpha=alphas, depth=depths, normal=normals)
        return normal_difference(rendering, at)

    assert gradcheck(term, tuple(each.requires_grad_() for each in inputs))
