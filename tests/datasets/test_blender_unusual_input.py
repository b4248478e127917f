"""Unusual input is accepted, and a note says what is done about it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from plain_scenes import RADIUS, SIDE, ball, edit_transforms, load, make_scene, write_image

from sculpt_framework.types import Scene


def _noted(scene: Scene, text: str) -> bool:
    return any(text in note for note in scene.notes)


def _over(color: tuple[int, int, int]) -> np.ndarray:
    """The ball over a colour (blue, green, red), without alpha."""
    image = ball()
    return np.where(image[..., 3:] > 0, image[..., :3], np.array(color, np.uint8))


def _iou(scene: Scene) -> float:
    alpha = scene.train[0].alpha
    assert alpha is not None
    truth, mask = ball()[..., 3] > 0, alpha.numpy() > 0.5
    return (truth & mask).sum() / (truth | mask).sum()


def test_plain_scene(scene: Path) -> None:
    loaded = load(scene)
    assert loaded.name == "scene"
    assert [view.name for view in loaded.train] == [f"train/r_{index}" for index in range(6)]
    view = loaded.train[0]
    assert view.rgb.dtype == torch.float32
    assert view.camera.world_to_camera.dtype == torch.float64
    assert view.camera.fx == pytest.approx(0.5 * SIDE / np.tan(0.5 * 0.6911))
    # RGB, where the file is BGR.
    middle = view.rgb[SIDE // 2 - 3, SIDE // 2 - 3] * 255
    torch.testing.assert_close(middle, torch.tensor([180.0, 120.0, 60.0]))
    assert loaded.reference_mesh is None
    assert loaded.test == ()
    assert _noted(loaded, "no test split")
    assert _noted(loaded, "fitted from 6 masks of 6 views")


def test_reference_mesh_is_found(scene: Path) -> None:
    (scene / "gt_mesh.ply").write_bytes(b"ply")
    assert load(scene).reference_mesh == scene / "gt_mesh.ply"


def test_validation_views_stand_in_for_test_views(scene: Path) -> None:
    shutil.copy(scene / "transforms_train.json", scene / "transforms_val.json")
    loaded = load(scene)
    assert len(loaded.test) == 6
    assert _noted(loaded, "validation views")


@pytest.mark.parametrize("color", [(255, 255, 255), (0, 0, 0), (30, 200, 40)])
def test_constant_background_is_keyed(tmp_path: Path, color: tuple[int, int, int]) -> None:
    loaded = load(make_scene(tmp_path / "s", image=_over(color)))
    assert _noted(loaded, "6 of 6 images have no alpha: constant background found")
    assert _iou(loaded) > 0.97


def test_jpeg_background_is_keyed(tmp_path: Path) -> None:
    loaded = load(make_scene(tmp_path / "s", image=_over((255, 255, 255)), extension=".jpg"))
    assert _noted(loaded, "constant background found")
    assert _iou(loaded) > 0.9


def test_background_can_be_given(tmp_path: Path) -> None:
    loaded = load(make_scene(tmp_path / "s", image=_over((255, 255, 255))), background="white")
    assert _noted(loaded, "background as given")
    assert _iou(loaded) > 0.97


def test_background_none_keeps_images_without_masks(tmp_path: Path) -> None:
    loaded = load(make_scene(tmp_path / "s", image=_over((255, 255, 255))), background="none")
    assert all(view.alpha is None for view in loaded.train)
    assert _noted(loaded, "nothing is keyed out")
    assert _noted(loaded, "fitted from frusta")


def test_busy_background_gives_no_masks(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (SIDE, SIDE, 3), dtype=np.uint8)
    loaded = load(make_scene(tmp_path / "s", image=noise))
    assert all(view.alpha is None for view in loaded.train)
    assert _noted(loaded, "no constant background")
    half = 4 * np.tan(0.5 * 0.6911)
    assert 0.8 * half < loaded.box.scale < 1.6 * half


def test_alpha_that_says_nothing_is_ignored(tmp_path: Path) -> None:
    opaque = np.dstack([_over((255, 255, 255)), np.full((SIDE, SIDE), 255, np.uint8)])
    loaded = load(make_scene(tmp_path / "s", image=opaque))
    assert _noted(loaded, "opaque everywhere")
    assert _noted(loaded, "keyed out")
    assert _iou(loaded) > 0.97


def test_grey_images(tmp_path: Path) -> None:
    grey = np.where(ball()[..., 3] > 0, ball()[..., 1], np.uint8(255))
    loaded = load(make_scene(tmp_path / "s", image=grey))
    assert _noted(loaded, "6 of 6 images are grey")
    assert loaded.train[0].rgb.shape == (SIDE, SIDE, 3)
    assert _iou(loaded) > 0.97


def test_sixteen_bit_images(tmp_path: Path) -> None:
    loaded = load(make_scene(tmp_path / "s", image=ball().astype(np.uint16) * 257))
    assert _noted(loaded, "6 of 6 images have 16 bits")
    torch.testing.assert_close(loaded.train[0].rgb, load(make_scene(tmp_path / "t")).train[0].rgb)


def test_images_of_different_sizes(scene: Path) -> None:
    write_image(scene / "train" / "r_2.png", ball(2 * SIDE))
    loaded = load(scene)
    assert _noted(loaded, "2 sizes, 40x40 to 80x80")
    cameras = [view.camera for view in loaded.train]
    assert cameras[2].fx == pytest.approx(2 * cameras[0].fx)
    assert cameras[2].cx == SIDE


@pytest.mark.parametrize("views", [1, 2])
def test_few_views(tmp_path: Path, views: int) -> None:
    loaded = load(make_scene(tmp_path / "s", views=views))
    assert _noted(loaded, "only one view" if views == 1 else "only two views")
    assert _noted(loaded, "leave the depth open")
    assert (loaded.box.minimum <= -0.9 * RADIUS).all()
    assert (loaded.box.maximum >= 0.9 * RADIUS).all()
    assert loaded.box.scale < 1.6 * RADIUS


def test_transparent_views_are_left_out(scene: Path) -> None:
    write_image(scene / "train" / "r_2.png", np.zeros((SIDE, SIDE, 4), np.uint8))
    loaded = load(scene)
    assert len(loaded.train) == 5
    assert _noted(loaded, "1 of 6 train images are transparent")


def test_scaled_rotations_are_normalised(scene: Path) -> None:
    before = load(scene).train[1].camera.world_to_camera

    def scale(document: dict) -> None:
        matrix = np.array(document["frames"][1]["transform_matrix"])
        matrix[:3, :3] *= 2.5
        document["frames"][1]["transform_matrix"] = matrix.tolist()

    edit_transforms(scene, scale)
    loaded = load(scene)
    torch.testing.assert_close(loaded.train[1].camera.world_to_camera, before, rtol=0, atol=1e-12)
    assert _noted(loaded, "1 of 6 train cameras have a rotation scaled by 2.5")


def test_three_rows_and_rounded_matrices(scene: Path) -> None:
    before = [view.camera.world_to_camera for view in load(scene).train]

    def simplify(document: dict) -> None:
        for frame in document["frames"]:
            frame["transform_matrix"] = np.round(frame["transform_matrix"], 4)[:3].tolist()

    edit_transforms(scene, simplify)
    for old, view in zip(before, load(scene).train, strict=True):
        new = view.camera.world_to_camera
        torch.testing.assert_close(new, old, rtol=0, atol=1e-3)
        torch.testing.assert_close(new[:3, :3] @ new[:3, :3].T, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-12)


def test_lens_per_file_and_per_frame(scene: Path) -> None:
    """Focal lengths in pixels of an image of w x h; a frame's own angle overrules them."""

    def change(document: dict) -> None:
        document.update(fl_x=100.0, fl_y=110.0, cx=39.0, cy=42.0, w=80, h=80)
        del document["camera_angle_x"]
        document["frames"][1]["camera_angle_x"] = 0.9

    edit_transforms(scene, change)
    first, second = (view.camera for view in load(scene).train[:2])
    assert (first.fx, first.fy, first.cx, first.cy) == pytest.approx((50.0, 55.0, 19.5, 21.0))
    assert second.fx == pytest.approx(0.5 * SIDE / np.tan(0.45))
    assert second.fy == second.fx


def test_paths_with_extension_and_links(scene: Path) -> None:
    edit_transforms(scene, lambda document: document["frames"][0].update(file_path="train\\r_0.png"))
    edit_transforms(scene, lambda d: d["frames"][1].update(file_path=str(scene.absolute() / "train/r_1.png")))
    elsewhere = scene.parent / "elsewhere"
    (scene / "train").rename(elsewhere)
    (scene / "train").symlink_to(elsewhere)
    assert [view.name for view in load(scene).train[:2]] == ["train/r_0", "train/r_1"]


def test_byte_order_mark_and_unknown_keys(scene: Path) -> None:
    path = scene / "transforms_train.json"
    document = json.loads(path.read_text(encoding="utf-8")) | {"aabb_scale": 4, "k1": 0.0}
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(document).encode())
    assert len(load(scene).train) == 6


def test_object_outside_the_default_box(scene: Path) -> None:
    """Scaled by 30 and moved by hundreds of units: the box follows, and so does its precision."""
    near = load(scene).box
    shift = np.array([500.0, -200.0, 80.0])

    def move(document: dict) -> None:
        for frame in document["frames"]:
            matrix = np.array(frame["transform_matrix"])
            matrix[:3, 3] = 30 * matrix[:3, 3] + shift
            frame["transform_matrix"] = matrix.tolist()

    edit_transforms(scene, move)
    far = load(scene).box
    torch.testing.assert_close((far.minimum - torch.tensor(shift)) / 30, near.minimum, rtol=0, atol=0.03)
    torch.testing.assert_close((far.maximum - torch.tensor(shift)) / 30, near.maximum, rtol=0, atol=0.03)
