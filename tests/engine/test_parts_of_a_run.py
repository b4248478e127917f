"""Images, initial fit, reconstruction: the steps before and after training."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_runs import FIELDS, small_config
from torch import Tensor

from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.geometry.principal_axes import principal_axes
from sculpt_framework.posed_images.training_images import pixel_footprint, prepare_image
from sculpt_framework.sculpting.gaussian_scene import GaussianScene
from sculpt_framework.sculpting.reconstruction import object_gaussians, reconstruct
from sculpt_framework.shape_from_images.field_fit import fit_field
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.testing import sphere_sdf, union_sdf
from sculpt_framework.types import Box, Camera, Scene, Surface, View

CPU = torch.device("cpu")


def project(camera: Camera, points: Tensor) -> Tensor:
    pose = camera.world_to_camera.to(points)
    local = points @ pose[:3, :3].T + pose[:3, 3]
    pixels = local[:, :2] / local[:, 2:] * torch.tensor([camera.fx, camera.fy], dtype=points.dtype)
    return pixels + torch.tensor([camera.cx, camera.cy], dtype=points.dtype)


# -- images -----------------------------------------------------------------------------------------------------------


def test_a_crop_keeps_its_pixels_and_its_rays(scene: Scene):
    view = scene.train[3]
    whole = prepare_image(view, scene.box, 1.0, CPU, crop=False)
    cropped = prepare_image(view, scene.box, 1.0, CPU)
    assert view.alpha is not None
    assert cropped.alpha is not None
    height, width = cropped.alpha.shape
    assert (cropped.camera.width, cropped.camera.height) == (width, height)
    x0, y0 = round(whole.camera.cx - cropped.camera.cx), round(whole.camera.cy - cropped.camera.cy)
    torch.testing.assert_close(cropped.alpha, view.alpha[y0 : y0 + height, x0 : x0 + width].float())
    torch.testing.assert_close(cropped.premultiplied, whole.premultiplied[y0 : y0 + height, x0 : x0 + width])
    assert float(cropped.alpha.sum()) == pytest.approx(float(view.alpha.sum()), rel=1e-6)
    points = torch.rand(20, 3, dtype=torch.float64) - 0.5
    shift = torch.tensor([x0, y0], dtype=torch.float64)
    torch.testing.assert_close(project(cropped.camera, points) + shift, project(whole.camera, points))


@pytest.mark.parametrize("scale", [0.5, 0.3])
def test_a_smaller_image_sees_the_same(scene: Scene, scale: float):
    full = prepare_image(scene.train[0], scene.box, 1.0, CPU)
    small = prepare_image(scene.train[0], scene.box, scale, CPU)
    points = torch.rand(20, 3, dtype=torch.float64) - 0.5
    ratio = torch.tensor([small.camera.width / full.camera.width, small.camera.height / full.camera.height])
    torch.testing.assert_close(project(small.camera, points), project(full.camera, points) * ratio.double())
    torch.testing.assert_close(
        small.premultiplied.mean(dim=(0, 1)), full.premultiplied.mean(dim=(0, 1)), rtol=0.02, atol=2e-3
    )


def test_object_frame_and_world_project_to_the_same_pixels(scene: Scene):
    view = scene.train[1]
    image = prepare_image(view, scene.box, 1.0, CPU, crop=False)
    points = torch.rand(20, 3, dtype=torch.float64) - 0.5
    there = project(
        replace(view.camera, world_to_camera=view.camera.world_to_camera.double()), scene.box.to_world(points)
    )
    torch.testing.assert_close(project(image.camera, points), there, rtol=1e-4, atol=1e-3)


def test_backgrounds_and_empty_masks(scene: Scene):
    image = prepare_image(scene.train[0], scene.box, 1.0, CPU, crop=False)
    assert image.alpha is not None
    red = torch.tensor([1.0, 0.0, 0.0])
    outside = image.alpha == 0
    assert bool((image.over(red).rgb[outside] == red).all())
    view = scene.train[0]
    empty = View(name="empty", camera=view.camera, rgb=view.rgb, alpha=torch.zeros_like(view.rgb[..., 0]))
    assert prepare_image(empty, scene.box, 1.0, CPU).premultiplied.shape == view.rgb.shape
    bare = prepare_image(replace(view, alpha=None), scene.box, 1.0, CPU)
    assert bare.alpha is None
    assert bare.over(red).rgb is bare.premultiplied


def test_pixel_footprint_is_a_length_at_the_object(scene: Scene):
    images = [prepare_image(scene.train[0], scene.box, 1.0, CPU)]
    camera = images[0].camera
    side = pixel_footprint(images)
    center = torch.zeros(1, 3, dtype=torch.float64)
    right = camera.world_to_camera[0, :3].double()[None] * side
    moved = project(camera, center + right) - project(camera, center)
    # The centre of the box is not on the optical axis: distance and depth differ a little.
    assert float(moved.norm()) == pytest.approx(1.0, rel=0.1)


# -- the initial fit --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FIELDS)
def test_every_field_learns_another_start(name: str):
    torch.manual_seed(0)
    volume = sample(sphere_sdf(0.4, (0.15, -0.1, 0.1)), (1.0, 1.0, 1.0), 24, CPU)
    field = FIELDS[name].build(24, CPU)
    field.set_detail(volume.cell)
    generator = torch.Generator().manual_seed(0)
    error = fit_field(field, volume, steps=120, generator=generator, device=CPU)
    assert error < 0.015
    surface = torch.nn.functional.normalize(torch.randn(2000, 3), dim=1) * 0.4 + torch.tensor([0.15, -0.1, 0.1])
    assert float(field(surface).detach().abs().mean()) < 0.02


# -- the result -------------------------------------------------------------------------------------------------------


@pytest.fixture
def ball() -> tuple[GaussianScene, Surface]:
    """A ball with a speck beside it, in one colour, with the Gaussians of the small method on both."""
    config = small_config()
    grid = grid_over_box(torch.ones(3), cells=20)
    sdf = union_sdf(sphere_sdf(0.5, (-0.2, 0.0, 0.0)), sphere_sdf(0.08, (0.8, 0.8, 0.8)))
    surface = config.extractor.build(grid, CPU).extract(sdf, discover(sdf, grid, 0)).surface.detach()
    scene = GaussianScene(config.binder.build(), config.appearance.build(CPU))
    scene.follow(surface)
    with torch.no_grad():
        scene.appearance_rows.leaves["residual_dc"][:] = (torch.tensor([0.8, 0.4, 0.2]) - 0.5) / 0.28209479177387814
    return scene, surface


def test_a_result_is_in_world_frame_without_specks(ball: tuple[GaussianScene, Surface]):
    scene, surface = ball
    box = Box(minimum=torch.tensor([1.0, 2.0, 3.0]), maximum=torch.tensor([5.0, 6.0, 7.0]))
    result = reconstruct(scene, surface, box)
    assert 0 < len(result.faces) < len(surface.faces)
    center = torch.tensor([3.0 - 0.2 * 2, 4.0, 5.0]).numpy()
    radius = np.linalg.norm(result.vertices - center, axis=1)
    np.testing.assert_allclose(radius, 1.0, atol=0.02)
    np.testing.assert_allclose(result.colors, np.tile([0.8, 0.4, 0.2], (len(result.vertices), 1)), atol=1e-5)
    corners = result.vertices[result.faces[result.gaussians.face.numpy()]]
    distance = np.linalg.norm(result.gaussians.means.numpy() - corners.mean(axis=1), axis=1)
    radius = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    # Set in below its face by less than a quarter of a cell.
    assert (distance < radius + 0.05).all()


def test_more_gaussians_begin_in_the_colour_of_their_face(ball: tuple[GaussianScene, Surface]):
    scene, surface = ball
    with torch.no_grad():
        scene.appearance_rows.leaves["residual_dc"].normal_(generator=torch.Generator().manual_seed(0))
    before = object_gaussians(scene, surface)
    scene.rebind(scene.binder.with_gaussians(3))
    after = object_gaussians(scene, surface)
    assert len(after) == 3 * len(before)
    torch.testing.assert_close(after.sh, before.sh.repeat_interleave(3, dim=0), atol=0.02, rtol=0)
    assert float((after.means.reshape(-1, 3, 3).mean(dim=1) - before.means).norm(dim=1).max()) < 0.03
    scene.follow(surface)
    torch.testing.assert_close(object_gaussians(scene, surface).sh, after.sh)


def test_principal_axes_keep_covariance_and_normal(ball: tuple[GaussianScene, Surface]):
    scene, surface = ball
    gaussians = object_gaussians(scene, surface)
    turned = principal_axes(gaussians)

    def covariance(which) -> Tensor:
        factor = which.rotations.double() * which.scales.double()[:, None]
        return factor @ factor.transpose(1, 2)

    # A face of no area has no normal: its Gaussian gets one, and with it the extent along it.
    whole = gaussians.rotations[:, :, 0].norm(dim=1) > 0.5
    assert float(whole.float().mean()) > 0.99
    torch.testing.assert_close(covariance(turned)[whole], covariance(gaussians)[whole], rtol=1e-4, atol=1e-9)
    normals = torch.nn.functional.normalize(gaussians.rotations[:, :, 0][whole], dim=1)
    # The normal of a sliver is askew in single precision; what lay along its long axis is taken out.
    torch.testing.assert_close(turned.rotations[:, :, 0][whole], normals, rtol=0, atol=1e-2)
    assert bool((turned.scales[:, 1] >= turned.scales[:, 2]).all())
    determinant = torch.linalg.det(turned.rotations.double())
    torch.testing.assert_close(determinant, torch.ones_like(determinant), rtol=1e-4, atol=1e-4)


def test_rows_follow_their_faces(ball: tuple[GaussianScene, Surface]):
    scene, surface = ball
    before = {name: leaf.detach().clone() for name, leaf in scene.appearance_rows.leaves.items()}
    scene.follow(surface)
    assert all(torch.equal(leaf, before[name]) for name, leaf in scene.appearance_rows.leaves.items())
    order = torch.randperm(len(surface.faces), generator=torch.Generator().manual_seed(0))
    scene.appearance_rows.leaves["residual_dc"].data[0] = 5.0
    scene.follow(Surface(vertices=surface.vertices, faces=surface.faces[order], face_keys=surface.face_keys[order]))
    assert bool((scene.appearance_rows.leaves["residual_dc"][int((order == 0).nonzero())] == 5.0).all())
    scene.forget()
    scene.follow(surface)
    assert not scene.appearance_rows.leaves["residual_dc"].any()
    assert math.isclose(float(scene.geometry_rows.state()["steps"].sum()), 0.0)
