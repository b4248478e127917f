"""A mesh against photographs, where what is wrong with it is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from photographed_ball import RADIUS, ball, moved, photograph, ring, view_of_ball

from sculpt_framework.evaluation.consistency import Consistency, PosedImages
from sculpt_framework.evaluation.image_pairs import choose_pairs, normalise
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.roughness import unevenness
from sculpt_framework.types import View

ORIGIN = np.zeros(3)


@pytest.fixture(scope="module")
def views() -> list[View]:
    return [view_of_ball(camera) for camera in ring(4, 12, 320)]


@pytest.fixture(scope="module")
def images(views: list[View]) -> PosedImages:
    return PosedImages(views, ORIGIN)


@pytest.fixture(scope="module")
def true(images: PosedImages) -> Consistency:
    return images.measure(ball())


def known(value: float | None) -> float:
    assert value is not None
    return value


def test_the_true_mesh_leaves_next_to_nothing(true: Consistency):
    assert known(true.residual_px) < 0.1
    assert known(true.residual_p90_px) < 0.25
    assert known(true.residual_depth) < 0.003 * RADIUS
    assert known(true.depth_error) < 0.003 * RADIUS
    assert true.judged > 0.7
    assert true.pairs == 4


@pytest.mark.parametrize("percent", [1, 2, 5, -1, -3])
def test_a_mesh_of_another_size_is_off_by_so_much(images: PosedImages, true: Consistency, percent: float):
    found = images.measure(ball(radius=RADIUS * (1 + percent / 100)))
    assert known(found.residual_depth) == pytest.approx(abs(percent) / 100 * RADIUS, rel=0.2)
    assert known(found.residual_depth_p90) == pytest.approx(abs(percent) / 100 * RADIUS, rel=0.35)
    assert known(found.depth_error) == pytest.approx(abs(percent) / 100 * RADIUS, rel=0.25)
    assert known(found.residual_px) > 2 * known(true.residual_px)


def test_an_error_in_a_part_is_in_the_mean_and_less_in_the_median(images: PosedImages):
    mesh = ball()
    above = np.clip((mesh.vertices[:, 2:] / RADIUS - 0.3) / 0.1, 0, 1)
    found = images.measure(moved(mesh, mesh.vertices * (1 + 0.03 * above)))
    assert known(found.residual_depth) < 0.1 * 0.03 * RADIUS
    assert known(found.residual_depth_p90) > 0.8 * 0.03 * RADIUS


def test_a_mesh_that_is_moved_away_is_off_by_its_share_across_the_surface(views: list[View]):
    """Moved along the mean way of view: of that, what is across the surface counts, half of it at 60 degrees."""
    mesh = ball()
    way = sum(view.camera.position.numpy() for view in views)
    way = 0.02 * RADIUS * way / np.linalg.norm(way)
    found = PosedImages(views, ORIGIN).measure(moved(mesh, mesh.vertices + way))
    assert 0.6 * 0.02 * RADIUS < known(found.residual_depth) < 0.02 * RADIUS


def test_wrong_cameras_are_not_taken_for_a_wrong_mesh(views: list[View], true: Consistency):
    """Principal points are off by about a pixel: images move every way, and no depth explains half of that."""
    generator = np.random.default_rng(3)

    def off(view: View) -> View:
        camera, pixels = view.camera, generator.normal(size=2)
        return replace(view, camera=replace(camera, cx=camera.cx + pixels[0], cy=camera.cy + pixels[1]))

    found = PosedImages([off(view) for view in views], ORIGIN).measure(ball())
    assert known(found.residual_px) > 5 * known(true.residual_px)
    assert known(found.depth_error) < 0.3 * known(found.residual_depth)


def test_gain_and_offset_of_an_image_change_nothing(views: list[View], true: Consistency):
    first, *rest = views
    found = PosedImages([replace(first, rgb=0.7 * first.rgb + 0.15), *rest], ORIGIN).measure(ball())
    assert known(found.residual_px) == pytest.approx(known(true.residual_px), abs=1e-3)
    assert known(found.residual_depth) == pytest.approx(known(true.residual_depth), abs=1e-3 * RADIUS)
    assert found.judged == pytest.approx(true.judged, abs=1e-3)


def test_half_the_resolution_says_the_same_in_pixels_of_the_views(views: list[View]):
    mesh = ball(radius=1.03 * RADIUS)
    whole, half = (PosedImages(views, ORIGIN, pixels_at_most=most).measure(mesh) for most in (None, 240**2))
    assert known(half.residual_px) == pytest.approx(known(whole.residual_px), rel=0.1)
    assert known(half.residual_depth) == pytest.approx(known(whole.residual_depth), rel=0.1)


def test_what_hides_the_ball_from_one_camera_only_is_not_judged(images: PosedImages, views: list[View]):
    """A plate before the first camera: its two pairs show nothing both see, the others are as they were."""
    mesh = ball()
    camera = views[0].camera
    before = camera.position.numpy() * 0.9
    across, down = camera.world_to_camera[0, :3].numpy(), camera.world_to_camera[1, :3].numpy()
    plate = before + 0.12 * np.array([-across - down, across - down, across + down, -across + down])
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + len(mesh.vertices)
    both = Mesh(vertices=np.concatenate([mesh.vertices, plate]), faces=np.concatenate([mesh.faces, faces]))
    found, alone = images.measure(both), images.measure(mesh)
    assert found.judged == pytest.approx(0.5 * alone.judged, rel=0.05)
    assert known(found.residual_px) == pytest.approx(known(alone.residual_px), abs=0.02)


def test_a_part_that_is_missing_is_not_judged(images: PosedImages, true: Consistency):
    mesh = ball()
    upper = mesh.faces[(mesh.corners[:, :, 2] > 0).all(axis=1)]
    found = images.measure(Mesh(vertices=mesh.vertices, faces=upper))
    assert 0.3 * true.judged < found.judged < 0.75 * true.judged
    assert known(found.residual_px) < 0.1


def test_no_texture_tells_nothing():
    found = PosedImages([view_of_ball(camera, plain=True) for camera in ring(3, 12, 120)], ORIGIN).measure(ball())
    assert found.judged == 0
    assert found.residual_px is found.residual_p90_px is found.residual_depth is None
    assert found.pairs == 3
    assert found.plain == 1
    assert found.plain_roughness == found.roughness


def test_one_view_tells_nothing_but_roughness(views: list[View]):
    for few in ([], views[:1], [views[0], views[0]]):
        found = PosedImages(few, ORIGIN).measure(ball())
        assert found.pairs == 0
        assert found.judged == 0
        assert found.residual_px is found.residual_p90_px is found.residual_depth is found.depth_error is None
        assert (found.roughness is None) == (not few)


@pytest.mark.parametrize("side", [1, 5, 12, 17, 33])
def test_tiny_images_are_no_trouble(side: int):
    found = PosedImages([view_of_ball(camera) for camera in ring(2, 10, side)], ORIGIN).measure(ball(2))
    assert found.pairs == 2
    assert found.residual_px is None or np.isfinite(found.residual_px)


def test_a_mesh_that_no_camera_sees_or_without_faces_tells_nothing(images: PosedImages):
    mesh = ball(3)
    away = images.measure(moved(mesh, mesh.vertices + 100))
    empty = images.measure(Mesh(vertices=mesh.vertices, faces=mesh.faces[:0]))
    for found in (away, empty):
        assert found.judged == 0
        assert found.residual_px is found.roughness is found.plain is None


def test_pairs_are_at_the_best_angle_and_spread():
    cameras = ring(36, 5, 40)
    pairs = choose_pairs(cameras, ORIGIN, None)
    assert len(pairs) == 36
    assert all(abs(i - j) == 2 for i, j in pairs)
    some = choose_pairs(cameras, ORIGIN, 6)
    assert [i for i, _ in some] == [0, 6, 12, 18, 24, 30]
    assert choose_pairs(ring(4, 60, 40), ORIGIN, None) == []


def test_normalising_takes_out_slopes():
    columns = np.arange(80, dtype=np.float32) / 80
    ramp, mask = np.repeat(columns[None], 60, axis=0), np.ones((60, 80), bool)
    normalised, textured = normalise(ramp, mask)
    middle = np.s_[20:40, 20:60]
    assert np.abs(normalised[middle]).max() < 0.02
    assert not textured[middle].any()


# -- roughness -------------------------------------------------------------------------------------------------------


def bumpy(mesh: Mesh, height: float) -> Mesh:
    """Bumps and pits some three edges of the mesh across, over its upper half."""
    edge = np.linalg.norm(mesh.corners[:, 0] - mesh.corners[:, 1], axis=1).mean()
    generator = np.random.default_rng(5)
    ways = generator.normal(size=(3, 60))
    ways *= 2 * np.pi / (3 * edge) / np.linalg.norm(ways, axis=0)
    waves = np.sin(mesh.vertices @ ways + generator.uniform(0, 6, 60)).mean(axis=1) * np.sqrt(60)
    out = height * edge * waves * (mesh.vertices[:, 2] > 0)
    return moved(mesh, mesh.vertices * (1 + out / RADIUS)[:, None])


def test_a_ball_is_smooth_and_bumps_are_not():
    smooth = unevenness(ball(6)).degrees.mean()
    assert smooth < 1
    assert unevenness(bumpy(ball(6), 0.1)).degrees.mean() > 4 * smooth


def test_roughness_is_of_what_cameras_see():
    mesh = bumpy(ball(6), 0.1)
    below = ring(2, 12, 200)
    turn = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    under = [replace(camera, world_to_camera=camera.world_to_camera @ turn) for camera in below]
    seen = [PosedImages([view_of_ball(camera) for camera in each], ORIGIN).measure(mesh) for each in (under, below)]
    assert known(seen[0].roughness) < known(seen[1].roughness)


def test_pits_in_plain_places_are_told_from_relief_of_the_same_shape():
    """The same bumpy mesh: photographs of a smooth ball make pits of it, its own photographs show relief."""
    smooth, rough = ball(6), bumpy(ball(6), 0.1)
    cameras = ring(5, 12, 320)
    pits, relief = (
        PosedImages([photograph(mesh, camera) for camera in cameras], ORIGIN).measure(rough) for mesh in (smooth, rough)
    )
    assert known(pits.roughness) == pytest.approx(known(relief.roughness), rel=0.1)
    assert known(pits.plain_roughness) > 2 * known(relief.plain_roughness)
