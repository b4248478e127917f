"""What photographs bring: EXIF turns, reduced size, mask files, busy backgrounds."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from layouts import Shot, make_shots, picture, pixel_centers, ray_directions, save_jpeg, write_colmap, write_nerfstudio
from PIL import Image
from plain_scenes import make_scene, write_image

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images import cut_out as cut_out_module
from sculpt_framework.posed_images import views as views_module
from sculpt_framework.posed_images.decoding import read_image
from sculpt_framework.posed_images.headers import read_headers
from sculpt_framework.types import Box, Scene, View
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.datasets.colmap.config import ColmapConfig
from sculpt_plugins.datasets.nerfstudio.config import NerfstudioConfig


def _noted(scene: Scene, text: str) -> bool:
    return any(text in note for note in scene.notes)


def wide_shots(width: int = 64, height: int = 40, count: int = 4) -> list[Shot]:
    shots = []
    for index, square in enumerate(demo_cameras(count, 48)):
        camera = replace(square, cx=width / 2, cy=height / 2, width=width, height=height)
        rays = ray_directions(camera, pixel_centers(width, height))
        shots.append(Shot(name=f"r_{index:02d}", camera=camera, image=picture(camera, rays)))
    return shots


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientations_are_those_of_another_reader(orientation: int, tmp_path: Path):
    """Against Pillow's own turning of the same file."""
    path = tmp_path / "a.png"
    exif = Image.Exif()
    exif[274] = orientation
    pixels = np.random.default_rng(0).integers(0, 255, (5, 7, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path, exif=exif)
    (header,) = read_headers([path])
    assert header is not None
    assert (header.width, header.height, header.orientation) == (7, 5, orientation)
    from PIL import ImageOps

    with Image.open(path) as opened:
        upright = np.asarray(ImageOps.exif_transpose(opened))
    assert header.upright_size == upright.shape[1::-1]
    image = read_image(path, orientation=header.orientation)
    np.testing.assert_allclose(image.rgb, upright / 255, atol=1e-6)
    assert image.full_size == upright.shape[1::-1]


@pytest.mark.parametrize("stored_upright", [True, False])
def test_a_turn_is_made_where_the_camera_asks_for_it(stored_upright: bool, tmp_path: Path):
    """The camera is of a wide image. A file that is wide as stored fits it whatever its EXIF data say."""
    shots = wide_shots()
    folder = write_nerfstudio(tmp_path / "s", shots)
    exif = Image.Exif()
    exif[274] = 6
    for shot in shots:
        rgb = shot.image[..., 2::-1]
        stored = rgb if stored_upright else np.rot90(rgb)
        Image.fromarray(np.ascontiguousarray(stored)).save(folder / "images" / f"{shot.name}.png", exif=exif)
    scene = AutoDatasetConfig().build(str(folder)).load()
    assert _noted(scene, "turned upright") == (not stored_upright)
    for view, shot in zip(scene.train, shots, strict=True):
        np.testing.assert_allclose(view.rgb.numpy(), shot.image[..., 2::-1] / 255, atol=1e-6)


@pytest.mark.parametrize("divide", [2, 3, 4, 6, 8])
@pytest.mark.parametrize("extension", [".png", ".jpg"])
def test_reduced_images_are_means(divide: int, extension: str, tmp_path: Path):
    side = 96
    columns, rows = np.meshgrid(np.arange(side), np.arange(side))
    smooth = np.stack([columns * 2, rows * 2, 100 + 50 * np.sin(columns / 9)], axis=2).astype(np.uint8)
    write_image(tmp_path / f"a{extension}", smooth)
    image = read_image(tmp_path / f"a{extension}", divide=divide)
    assert image.full_size == (side, side)
    size = side // divide
    expected = smooth.reshape(size, divide, size, divide, 3).mean(axis=(1, 3))[..., ::-1] / 255
    assert image.rgb.shape == expected.shape
    np.testing.assert_allclose(image.rgb, expected, atol=0.03 if extension == ".jpg" else 1e-5)


def test_reduced_colours_are_weighted_by_alpha(tmp_path: Path):
    pixels = np.zeros((4, 4, 4), np.uint8)
    pixels[..., :3] = 255  # White where nothing covers it: it must not leak in.
    pixels[:, ::2] = (40, 80, 120, 255)
    write_image(tmp_path / "a.png", pixels)
    image = read_image(tmp_path / "a.png", divide=2)
    assert image.alpha is not None
    np.testing.assert_allclose(image.alpha, 0.5, atol=1e-6)
    np.testing.assert_allclose(image.rgb, np.broadcast_to([120 / 255, 80 / 255, 40 / 255], (2, 2, 3)), atol=1e-6)


@pytest.mark.parametrize("divide", [2, 3])
def test_downscale_keeps_what_the_cameras_see(divide: int, tmp_path: Path):
    folder = write_colmap(tmp_path / "s", make_shots(4, 96))
    scene = AutoDatasetConfig(downscale=divide).build(str(folder)).load()
    assert _noted(scene, f"images are read at 1/{divide} of their width")
    whole = AutoDatasetConfig(downscale=1).build(str(folder)).load()
    for small, full in zip(scene.train, whole.train, strict=True):
        assert small.camera.width == full.camera.width // divide
        assert small.camera.fx / small.camera.width == pytest.approx(full.camera.fx / full.camera.width)
        assert small.camera.cx / small.camera.width == pytest.approx(full.camera.cx / full.camera.width)
        assert small.rgb.shape[:2] == (small.camera.height, small.camera.width)
    torch.testing.assert_close(scene.box.center, whole.box.center, rtol=0, atol=0.05)


def test_blender_scenes_can_be_reduced(tmp_path: Path):
    scene = BlenderConfig(downscale=2).build(str(make_scene(tmp_path / "s"))).load()
    assert (scene.train[0].camera.width, scene.train[0].rgb.shape[0]) == (20, 20)


def test_size_is_chosen_so_that_images_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = write_colmap(tmp_path / "s", make_shots(4, 96))
    limit = 4 * 96 * 96 * 16 // 5  # A fifth of the pixels: 1/3 along each side.
    monkeypatch.setattr(views_module, "IMAGE_BYTES", limit)
    scene = AutoDatasetConfig().build(str(folder)).load()
    assert _noted(scene, "images are read at 1/3 of their width and height, so that 4 images take at most")
    assert sum(16 * view.rgb.shape[0] * view.rgb.shape[1] for view in scene.train) <= limit


@pytest.mark.parametrize("name", ["{}.png", "{}.png.png", "{}.jpg"])
def test_masks_by_name(name: str, tmp_path: Path):
    shots = make_shots(4)
    folder = write_colmap(tmp_path / "s", shots, masks=False)
    (folder / "masks").mkdir()
    for shot in shots:
        write_image(folder / "masks" / name.format(shot.name), shot.image[..., 3])
    scene = AutoDatasetConfig().build(str(folder)).load()
    assert _noted(scene, "4 of 4 images have a mask in a file of its own")
    alpha = scene.train[0].alpha
    assert alpha is not None
    np.testing.assert_allclose(alpha.numpy(), shots[0].image[..., 3] / 255, atol=0.06)


@pytest.mark.parametrize("change", [lambda m: m // 255, lambda m: np.dstack([m * 0] * 3 + [m]), lambda m: m[::2, ::2]])
def test_masks_of_other_kinds(change: Callable[[np.ndarray], np.ndarray], tmp_path: Path):
    """Labels 0 and 1, an alpha channel, half the size."""
    shots = make_shots(4)
    folder = write_colmap(tmp_path / "s", shots)
    for shot in shots:
        write_image(folder / "masks" / f"{shot.name}.png", np.ascontiguousarray(change(shot.image[..., 3])))
    alpha = AutoDatasetConfig().build(str(folder)).load().train[0].alpha
    assert alpha is not None
    truth = shots[0].image[..., 3] > 0
    assert ((alpha.numpy() > 0.5) & truth).sum() / ((alpha.numpy() > 0.5) | truth).sum() > 0.93


def test_masks_that_fit_nothing(tmp_path: Path):
    folder = write_colmap(tmp_path / "s", make_shots(4))
    for path in (folder / "masks").iterdir():
        path.rename(path.with_name(f"x{path.name}"))
    with pytest.raises(DataError, match=r"masks: holds 4 masks \(xr_00.png, ...\), none named after an image"):
        AutoDatasetConfig().build(str(folder)).load()


def cluttered(shot: Shot, seed: int) -> np.ndarray:
    """The object before a room: patches of other colours, larger than pixels, with noise."""
    generator = np.random.default_rng(seed)
    side = shot.image.shape[0]
    patches = generator.integers(0, 90, (6, 6, 3), dtype=np.uint8)
    behind = cv2.resize(patches, (side, side), interpolation=cv2.INTER_LINEAR).astype(float)
    # A warm object before cold walls: colours overlap in brightness but not everywhere in hue.
    behind[..., 0] += 80
    inside = shot.image[..., 3:] > 0
    front = shot.image[..., :3] * 0.5 + np.array([0.0, 60.0, 120.0])
    image = np.where(inside, front, behind) + generator.normal(0, 3, (side, side, 3))
    return image.clip(0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def cluttered_scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Shot]]:
    shots = make_shots(12, 160)
    points = np.random.default_rng(0).normal(size=(200, 3))
    points *= 0.8 / np.linalg.norm(points, axis=1, keepdims=True)
    folder = write_colmap(tmp_path_factory.mktemp("clutter") / "s", shots, points=points, masks=False)
    for index, shot in enumerate(shots):
        save_jpeg(folder / "images" / f"{shot.name}.png", cluttered(shot, index))
    return folder, shots


@pytest.fixture(scope="module")
def cut_out(cluttered_scene: tuple[Path, list[Shot]]) -> Scene:
    return AutoDatasetConfig().build(str(cluttered_scene[0])).load()


def test_the_object_is_cut_out_of_a_cluttered_room(cluttered_scene: tuple[Path, list[Shot]], cut_out: Scene):
    scene, shots = cut_out, cluttered_scene[1]
    assert _noted(scene, "12 of 12 images have no mask: the object is cut out of them")
    assert _noted(scene, "looked for in the box of 200 of 200 sparse points")
    scores = []
    for view, shot in zip(scene.train, shots, strict=True):
        assert view.alpha is not None
        mask, truth = view.alpha.numpy() > 0.5, shot.image[..., 3] > 0
        scores.append((mask & truth).sum() / (mask | truth).sum())
    assert min(scores) > 0.95
    assert scene.box.scale == pytest.approx(0.8, rel=0.1)


def test_cutting_out_is_repeatable(cluttered_scene: tuple[Path, list[Shot]], cut_out: Scene):
    again = ColmapConfig().build(str(cluttered_scene[0])).load()
    first, second = (scene.train[3].alpha for scene in (cut_out, again))
    assert first is not None
    assert second is not None
    assert torch.equal(first, second)


def test_masks_by_colours_that_contradict_each_other_are_said_to(
    cluttered_scene: tuple[Path, list[Shot]], monkeypatch: pytest.MonkeyPatch
):
    """Where nothing is left of their hull, not poses are to blame."""

    def corners(views: list[View], test: list[View], seed: Box) -> tuple[list[View], list[View], str]:
        masked = []
        for index, view in enumerate(views):
            alpha = torch.zeros(view.rgb.shape[:2])
            alpha[5:15, 5:15] = 1
            masked.append(replace(view, alpha=alpha.flip(index % 2)))
        return masked, test, ""

    monkeypatch.setattr(cut_out_module, "cut_out", corners)
    with pytest.raises(DataError, match=r"no object is found by depth: .*contradicts itself from one to the next; put"):
        AutoDatasetConfig().build(str(cluttered_scene[0])).load()


def test_cutting_out_can_be_declined(cluttered_scene: tuple[Path, list[Shot]]):
    scene = ColmapConfig(masks="none").build(str(cluttered_scene[0])).load()
    assert all(view.alpha is None for view in scene.train)
    assert "there are no masks" in scene.notes[-1]


def test_plain_background_is_keyed_before_anything_is_cut_out(tmp_path: Path):
    folder = write_colmap(tmp_path / "s", make_shots(4), masks=False)
    scene = AutoDatasetConfig().build(str(folder)).load()
    assert _noted(scene, "constant background found at the borders")
    assert not _noted(scene, "cut out")


def test_each_frame_may_have_a_camera_of_its_own(tmp_path: Path):
    shots = make_shots(4)
    folder = write_nerfstudio(tmp_path / "s", shots)
    path = folder / "transforms.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    document["frames"][2] |= {"fl_x": 50.0, "fl_y": 51.0, "cx": 20.0, "cy": 30.0}
    path.write_text(json.dumps(document), encoding="utf-8")
    cameras = [view.camera for view in NerfstudioConfig().build(str(folder)).load().train]
    assert (cameras[2].fx, cameras[2].fy, cameras[2].cx, cameras[2].cy) == (50.0, 51.0, 20.0, 30.0)
    assert cameras[1].fx == shots[1].camera.fx
