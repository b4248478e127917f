"""The demo objects are what they claim to be, and their pictures show them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from sculpt_framework.demo_scenes import tracing
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.distance import sphere
from sculpt_framework.demo_scenes.objects import OBJECTS, DemoObject, demo_object
from sculpt_framework.demo_scenes.reference import reference_mesh
from sculpt_framework.demo_scenes.tracing import render
from sculpt_framework.errors import DataError
from sculpt_framework.types import Camera

EVERY = pytest.mark.parametrize("item", OBJECTS.values(), ids=OBJECTS.keys())
PLAIN = ("pebble", "two-faced")
"""Made to have none, or none on most sides."""
BALL = DemoObject(
    name="ball",
    summary="",
    distance=lambda p: sphere(p, (0.1, 0.0, 0.0), 0.7),
    texture=OBJECTS["blob"].texture,
    genus=0,
)


def _mesh(item: DemoObject, cells: int) -> trimesh.Trimesh:
    return trimesh.Trimesh(*reference_mesh(item.distance, cells), process=False)


@EVERY
def test_distance_never_grows_faster_than_space(item: DemoObject) -> None:
    """Lipschitz constant 1, over short and long ways: what sphere tracing and the mesher rely on."""
    random = np.random.default_rng(0)
    start = random.uniform(-1.1, 1.1, (3, 20_000))
    way = random.normal(size=start.shape) * 10.0 ** random.uniform(-5, 0, 20_000)
    change = np.abs(item.distance(start + way) - item.distance(start))
    assert (change <= np.linalg.norm(way, axis=0) * (1 + 1e-9) + 1e-12).all()


@EVERY
def test_object_lies_in_the_unit_ball(item: DemoObject) -> None:
    directions = np.random.default_rng(0).normal(size=(3, 5000))
    assert (item.distance(directions / np.linalg.norm(directions, axis=0)) > 0).all()


@EVERY
def test_reference_mesh_is_exact_closed_and_outward(item: DemoObject) -> None:
    # Its rods are thinner than the cells that do for the others.
    mesh = _mesh(item, 160 if item.name == "needle" else 56)
    assert np.abs(item.distance(mesh.vertices.T.copy())).max() < 1e-6
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert mesh.euler_number == 2 - 2 * item.genus


def test_reference_mesh_of_a_ball() -> None:
    mesh = _mesh(BALL, 64)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=2e-3)
    assert mesh.area == pytest.approx(4 * np.pi * 0.7**2, rel=2e-3)


def test_coverage_of_a_ball_is_exact() -> None:
    """A ball's outline is an ellipse whose area is known."""
    for camera in demo_cameras(3, 300):
        _, alpha = render(BALL, camera)
        center = camera.world_to_camera[:3, :3].numpy() @ [0.1, 0, 0] + camera.world_to_camera[:3, 3].numpy()
        z = float(center[2])
        r2, d2 = 0.7**2, float(center @ center)
        area = np.pi * camera.fx**2 * r2 * np.sqrt(d2 - r2) / (z * z - r2) ** 1.5
        assert alpha.sum() == pytest.approx(area, rel=1e-3)


@EVERY
def test_pictures_agree_with_the_reference_mesh(item: DemoObject) -> None:
    mesh = _mesh(item, 72)
    camera = demo_cameras(4, 240)[3]
    rgb, alpha = render(item, camera)
    truth = _silhouette(mesh, camera)
    assert np.abs(alpha - truth).sum() / truth.sum() < 0.025
    assert ((alpha > 0) <= (rgb.max(axis=2) > 0)).all()
    assert rgb.min() >= 0
    assert rgb.max() <= 1


def _silhouette(mesh: trimesh.Trimesh, camera: Camera, fine: int = 8) -> np.ndarray:
    """Coverage of the mesh's projection, drawn triangle by triangle on a finer raster."""
    pose = camera.world_to_camera.numpy()
    local = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
    pixels = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    # cv2 puts pixel centres at whole numbers and takes eight fractional bits.
    corners = np.round((pixels * fine - 0.5) * 256).astype(np.int32)[mesh.faces]
    canvas = np.zeros((camera.height * fine, camera.width * fine), np.uint8)
    for triangle in corners:
        cv2.fillConvexPoly(canvas, triangle, 1, shift=8)
    return canvas.reshape(camera.height, fine, camera.width, fine).mean(axis=(1, 3))


@pytest.mark.parametrize(
    "item", [each for each in OBJECTS.values() if each.name not in PLAIN], ids=lambda item: item.name
)
def test_texture_has_detail_everywhere(item: DemoObject) -> None:
    """Photometric reconstruction needs contrast within a few pixels, almost everywhere on the surface."""
    rgb, alpha = render(item, demo_cameras(1, 400)[0])
    grey = rgb.mean(axis=2)
    window = (9, 9)
    inside = cv2.erode((alpha == 1).astype(np.uint8), np.ones(window, np.uint8)) == 1
    contrast = np.sqrt(np.maximum(cv2.blur(grey**2, window) - cv2.blur(grey, window) ** 2, 0))[inside]
    assert np.quantile(contrast, 0.05) > 4 / 255
    assert np.median(contrast) > 10 / 255


def test_dents_are_deeper_than_any_silhouette_shows() -> None:
    """Points on the bottoms see the outside only within a narrow cone: no line through them misses the object."""
    bottoms = np.array([[0, 0, 0.43], [0.375, 0.137, 0.11]])
    item = OBJECTS["dents"]
    outward = bottoms / np.linalg.norm(bottoms, axis=1, keepdims=True)
    free = (bottoms + 0.03 * outward).T
    assert (item.distance(free) > 0).all()
    directions = np.random.default_rng(0).normal(size=(3, 400))
    directions /= np.linalg.norm(directions, axis=0)
    for point in free.T:
        line = point[:, None, None] + directions[:, :, None] * np.linspace(-2, 2, 400)
        blocked = item.distance(line.reshape(3, -1)).reshape(400, -1).min(axis=1) < 0
        assert blocked.all()


def test_small_pictures_are_reduced_from_larger_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "FINEST", 240)
    camera = demo_cameras(1, 60)[0]
    rgb, alpha = render(OBJECTS["blob"], camera)
    large, cover = render(OBJECTS["blob"], camera.resized(240, 240))
    mean = (large * cover[..., None]).reshape(60, 4, 60, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(rgb * alpha[..., None], mean, atol=1e-5)


def test_cameras_see_the_object_from_all_sides() -> None:
    cameras = demo_cameras(100, 64)
    positions = np.stack([camera.position.numpy() for camera in cameras])
    distance = np.linalg.norm(positions, axis=1)
    assert distance.min() >= 3.8
    assert distance.max() <= 4.2
    assert (positions[:, 2] > 0).mean() == pytest.approx(0.7, abs=0.03)
    # No direction of the upper half is farther than 25 degrees from a camera.
    views = positions / distance[:, None]
    up = np.random.default_rng(0).normal(size=(500, 3))
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    up[:, 2] = np.abs(up[:, 2])
    assert np.rad2deg(np.arccos((up @ views.T).max(axis=1))).max() < 25
    for camera in cameras[:5]:
        rotation = camera.world_to_camera[:3, :3].numpy()
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) > 0


def test_cameras_above_and_in_front() -> None:
    above = np.stack([camera.position.numpy() for camera in demo_cameras(100, 64, placement="above")])
    assert above[:, 2].min() > 0
    front = np.stack([camera.position.numpy() for camera in demo_cameras(100, 64, placement="front")])
    assert np.rad2deg(np.abs(np.arctan2(front[:, 1], front[:, 0]))).max() <= 75
    assert (front[:, 2] < 0).any()


def test_highlights_move_with_the_camera() -> None:
    """The same surface point differs between views where there is gloss, by nothing where there is none."""
    item = OBJECTS["flask"]
    first, second = demo_cameras(2, 300)
    for gloss, bound in ((0.0, 1e-3), (item.gloss, 0.2)):
        pictures = [render(replace(item, gloss=gloss), camera)[0] for camera in (first, second)]
        matt = [render(replace(item, gloss=0.0), camera)[0] for camera in (first, second)]
        brightest = [float((a - b).max()) for a, b in zip(pictures, matt, strict=True)]
        assert min(brightest) >= 0
        assert (max(brightest) > bound) == (gloss > 0)


def test_unknown_object() -> None:
    with pytest.raises(DataError, match=r"no demo scene is called 'dent'; there are blob, .*; did you mean dents\?"):
        demo_object("dent")
    assert demo_object("Double_Torus") is OBJECTS["double-torus"]
