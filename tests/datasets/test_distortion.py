"""Distorted lenses: the same rays as OpenCV's and COLMAP's own formulas, and images straight after resampling."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from layouts import Shot, make_shots, picture, pixel_centers, ray_directions, write_colmap, write_nerfstudio

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.distortion import Distortion, distorted_pixels, rectify, straightened
from sculpt_framework.posed_images.lens import Pinhole
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.colmap.lenses import MODELS, lens_of, model_of

SIDE = 64
LENS = Pinhole(fx=70.0, fy=72.0, cx=30.5, cy=33.0)
EXAMPLES = {
    "SIMPLE_PINHOLE": (70.0, 30.5, 33.0),
    "PINHOLE": (70.0, 72.0, 30.5, 33.0),
    "SIMPLE_RADIAL": (70.0, 30.5, 33.0, -0.15),
    "RADIAL": (70.0, 30.5, 33.0, -0.15, 0.03),
    "OPENCV": (70.0, 72.0, 30.5, 33.0, -0.15, 0.03, 0.002, -0.003),
    "OPENCV_FISHEYE": (70.0, 72.0, 30.5, 33.0, 0.05, -0.01, 0.003, -0.001),
    "FULL_OPENCV": (70.0, 72.0, 30.5, 33.0, 0.1, 0.02, 0.002, -0.003, 0.01, 0.2, 0.05, 0.01),
    "SIMPLE_RADIAL_FISHEYE": (70.0, 30.5, 33.0, 0.05),
    "RADIAL_FISHEYE": (70.0, 30.5, 33.0, 0.05, -0.01),
}
BARREL = Distortion(coefficients=(-0.2, 0.05, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0))
PINCUSHION = Distortion(coefficients=(0.25, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
FISHEYE = Distortion(coefficients=(0.05, -0.01, 0.003, 0.0), fisheye=True)


def test_every_model_that_is_read_has_an_example():
    assert set(EXAMPLES) == {model.name for model in MODELS if model.distortion is not None}


@pytest.mark.parametrize("name", EXAMPLES)
def test_colmap_models_against_colmap(name: str):
    pycolmap = pytest.importorskip("pycolmap")
    theirs = pycolmap.Camera(model=name, width=SIDE, height=SIDE, params=EXAMPLES[name])
    model = model_of(name, "here")
    assert model == model_of(int(theirs.model), "here")
    pinhole, distortion = lens_of(model, EXAMPLES[name], "here")
    ways = np.random.default_rng(0).uniform(-0.4, 0.4, (200, 2))
    rays = np.concatenate([ways, np.ones((200, 1))], axis=1)
    expected = np.asarray(theirs.img_from_cam(rays))
    ours = distorted_pixels(rays, pinhole, distortion or Distortion(coefficients=(0.0,) * 8))
    np.testing.assert_allclose(ours, expected, atol=1e-6)


@pytest.mark.parametrize("distortion", [BARREL, PINCUSHION, FISHEYE])
def test_straightened_is_the_inverse(distortion: Distortion):
    pixels = pixel_centers(SIDE, SIDE).reshape(-1, 2)
    ways = straightened(pixels, LENS, distortion)
    rays = np.concatenate([ways, np.ones((len(ways), 1))], axis=1)
    np.testing.assert_allclose(distorted_pixels(rays, LENS, distortion), pixels, atol=1e-6)


@pytest.mark.parametrize("distortion", [BARREL, PINCUSHION, FISHEYE])
def test_rays_of_the_new_image_against_opencv(distortion: Distortion):
    """A pixel of the pinhole image is fetched from where OpenCV projects its ray, to 0.01 pixel, inside the image."""
    made = rectify(LENS, distortion, SIDE, SIDE, "here")
    lens = made.pinhole
    assert (lens.fx, lens.fy) == (LENS.fx, LENS.fy)
    ways = (pixel_centers(made.width, made.height) - (lens.cx, lens.cy)) / (lens.fx, lens.fy)
    rays = np.concatenate([ways, np.ones((*ways.shape[:2], 1))], axis=2).reshape(-1, 1, 3)
    matrix = np.array([[LENS.fx, 0, LENS.cx - 0.5], [0, LENS.fy, LENS.cy - 0.5], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if distortion.fisheye else cv2.projectPoints
    expected, _ = project(rays, np.zeros(3), np.zeros(3), matrix, np.array(distortion.coefficients))
    expected = expected.reshape(made.height, made.width, 2)
    np.testing.assert_allclose(np.stack([made.columns, made.rows], axis=2), expected, atol=0.01)
    # No pixel is made up: each comes from inside the image, whose outermost pixels reach half a pixel out.
    assert expected.min() > -0.51
    assert expected.max() < SIDE - 0.49
    # And what is covered is not much less than could be.
    assert made.width * made.height > 0.8 * SIDE * SIDE


@pytest.mark.parametrize("name", EXAMPLES)
def test_rays_of_every_camera_model_against_opencv(name: str):
    """COLMAP's parameters given to OpenCV by hand; 0.01 pixel. Which of them is which, its documentation says."""
    values = EXAMPLES[name]
    one_focal = name.startswith(("SIMPLE", "RADIAL"))
    focal = (values[0],) * 2 if one_focal else values[:2]
    center, bends = (values[1:3], values[3:]) if one_focal else (values[2:4], values[4:])
    matrix = np.array([[focal[0], 0, center[0] - 0.5], [0, focal[1], center[1] - 0.5], [0, 0, 1]])
    coefficients = np.zeros(4 if "FISHEYE" in name else 8)
    coefficients[: len(bends)] = bends
    project = cv2.fisheye.projectPoints if "FISHEYE" in name else cv2.projectPoints
    pinhole, distortion = lens_of(model_of(name, "here"), values, "here")
    # A pinhole's image is not resampled: no map at all is the map of no distortion.
    made = rectify(pinhole, distortion or Distortion(coefficients=(0.0,) * 8), SIDE, SIDE, "here")
    lens = made.pinhole
    rays = ray_directions(lens.camera(torch.eye(4), made.width, made.height), pixel_centers(made.width, made.height))
    expected, _ = project(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), matrix, coefficients)
    found = np.stack([made.columns, made.rows], axis=2)
    np.testing.assert_allclose(found, expected.reshape(made.height, made.width, 2), atol=0.01)


def _distorted_shots(pinhole: Pinhole, distortion: Distortion, side: int) -> list[Shot]:
    ways = straightened(pixel_centers(side, side).reshape(-1, 2), pinhole, distortion)
    rays = np.concatenate([ways, np.ones((len(ways), 1))], axis=1).reshape(side, side, 3)
    shots = []
    for index, camera in enumerate(demo_cameras(4, side)):
        bent = replace(camera, fx=pinhole.fx, fy=pinhole.fy, cx=pinhole.cx, cy=pinhole.cy)
        shots.append(Shot(name=f"r_{index:02d}", camera=bent, image=picture(bent, rays)))
    return shots


def _distorted_scene(kind: str, layout: str, folder: Path, side: int) -> Scene:
    pinhole = Pinhole(fx=1.375 * side, fy=1.4 * side, cx=0.47 * side, cy=0.525 * side)
    fisheye = kind == "OPENCV_FISHEYE"
    values = (0.05, -0.01, 0.003, -0.001) if fisheye else (-0.3, 0.1, 0.002, -0.003)
    distortion = Distortion(coefficients=values if fisheye else (*values, 0.0, 0.0, 0.0, 0.0), fisheye=fisheye)
    shots = _distorted_shots(pinhole, distortion, side)
    if layout == "nerfstudio":
        names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2")
        write_nerfstudio(folder, shots, camera_model=kind, **dict(zip(names, values, strict=True)))
    else:
        lens = (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, *values)
        write_colmap(folder, shots, text=layout == "text", model=(5 if fisheye else 4, kind), values=lens)
    return AutoDatasetConfig().build(str(folder)).load()


@pytest.mark.parametrize("kind", ["OPENCV", "OPENCV_FISHEYE"])
def test_layouts_agree_on_a_distorted_lens(kind: str, tmp_path: Path):
    scenes = [_distorted_scene(kind, layout, tmp_path / layout, 64) for layout in ("nerfstudio", "binary", "text")]
    for views in zip(*(scene.train for scene in scenes), strict=True):
        for view in views[1:]:
            one, other = views[0].camera, view.camera
            assert (one.width, one.height) == (other.width, other.height)
            lenses = [(camera.fx, camera.fy, camera.cx, camera.cy) for camera in (one, other)]
            assert lenses[0] == pytest.approx(lenses[1], abs=1e-9)
            torch.testing.assert_close(one.world_to_camera, other.world_to_camera, rtol=0, atol=1e-9)
            assert torch.equal(views[0].rgb, view.rgb)


@pytest.mark.parametrize("kind", ["OPENCV", "OPENCV_FISHEYE"])
@pytest.mark.parametrize("layout", ["nerfstudio", "binary"])
def test_loaded_images_are_what_a_pinhole_sees(kind: str, layout: str, tmp_path: Path):
    scene = _distorted_scene(kind, layout, tmp_path / "s", 160)
    assert any("4 of 4 images come through a distorted lens" in note for note in scene.notes)
    for view in scene.train:
        camera = view.camera
        expected = picture(camera, ray_directions(camera, pixel_centers(camera.width, camera.height)))
        truth = torch.from_numpy(expected[..., 2::-1] / 255.0).float()
        assert view.alpha is not None
        inside = (view.alpha == 1) & torch.from_numpy(expected[..., 3] == 255)
        error = (view.rgb - truth)[inside].abs()
        assert error.max() < 0.06
        assert error.mean() < 0.004
        assert (view.alpha - torch.from_numpy(expected[..., 3] / 255.0)).abs().mean() < 0.01


def test_wide_fisheye_is_cut_at_its_widest(tmp_path: Path):
    lens = Pinhole(fx=20.0, fy=20.0, cx=32.0, cy=32.0)  # 180 degrees across.
    made = rectify(lens, Distortion(coefficients=(0.0,) * 4, fisheye=True), SIDE, SIDE, "here")
    assert made.width == made.height == 52


def test_a_lens_that_folds_is_refused():
    folding = Distortion(coefficients=(-2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(DataError, match=r"here: the calibration diverged: .*folds .*\(k1 -2, focal length 70 x 72"):
        rectify(LENS, folding, SIDE, SIDE, "here")


def test_images_and_their_cameras_are_reduced_together():
    """The rectified camera of a reduced image sees the same directions as that of the whole image."""
    whole = rectify(LENS, BARREL, SIDE, SIDE, "here")
    half = rectify(Pinhole(fx=35.0, fy=36.0, cx=15.25, cy=16.5), BARREL, SIDE // 2, SIDE // 2, "here")
    for full, small in ((whole.pinhole.cx / LENS.fx, half.pinhole.cx / 35.0), (whole.width / 70.0, half.width / 35.0)):
        assert abs(full - small) < 1.5 / 35


def test_undistorted_rays_agree_with_the_shots():
    camera = make_shots(1, SIDE)[0].camera
    pinhole = Pinhole(fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)
    pixels = np.array([[0.5, 0.5], [10.25, 50.0]])
    ways = straightened(pixels, pinhole, Distortion(coefficients=(0.0,) * 8))
    np.testing.assert_allclose(ways, ray_directions(camera, pixels)[:, :2], atol=1e-12)
