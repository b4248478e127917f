"""One scene in every layout gives the same cameras, images and box; chosen by the folder alone."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from layouts import WRITERS, Shot, make_shots, write_blender, write_colmap, write_idr, write_nerfstudio
from plain_scenes import write_image

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.posed_images.masks import has_mask_files
from sculpt_framework.types import Scene
from sculpt_framework.validation import check_component
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.colmap.config import ColmapConfig
from sculpt_plugins.datasets.colmap.dataset import read_model
from sculpt_plugins.datasets.idr.config import IdrConfig
from sculpt_plugins.datasets.nerfstudio.config import NerfstudioConfig

Write = Callable[[Path, Sequence[Shot]], Path]


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    return make_shots()


@pytest.fixture(scope="module")
def plain(shots: list[Shot], tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return _load(write_blender(tmp_path_factory.mktemp("plain") / "scene", shots))


def _load(folder: Path) -> Scene:
    return AutoDatasetConfig().build(str(folder)).load()


@pytest.mark.parametrize("layout", WRITERS)
def test_same_cameras_images_and_box(layout: str, shots: list[Shot], plain: Scene, tmp_path: Path):
    scene = _load(WRITERS[layout](tmp_path / "scene", shots))
    assert scene.notes[0].startswith(f"layout: {layout.split()[0]} (there is ")
    assert len(scene.train) == len(shots)
    for view, shot, same in zip(scene.train, shots, plain.train, strict=True):
        camera = view.camera
        assert Path(view.name).name == shot.name
        torch.testing.assert_close(camera.world_to_camera, shot.camera.world_to_camera, rtol=0, atol=1e-9)
        lens = (camera.fx, camera.fy, camera.cx, camera.cy)
        assert lens == pytest.approx((shot.camera.fx, shot.camera.fy, shot.camera.cx, shot.camera.cy), abs=1e-6)
        assert view.alpha is not None
        assert same.alpha is not None
        torch.testing.assert_close(view.alpha, same.alpha)
        torch.testing.assert_close(view.rgb * view.alpha[..., None], same.rgb * same.alpha[..., None])
    torch.testing.assert_close(scene.box.minimum, plain.box.minimum, rtol=0, atol=1e-6)
    torch.testing.assert_close(scene.box.maximum, plain.box.maximum, rtol=0, atol=1e-6)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_colmap_models_wherever_they_lie(text: bool, place: str, shots: list[Shot], tmp_path: Path):
    folder = write_colmap(tmp_path / "scene", shots, text=text, place=place)
    assert len(_load(folder).train) == len(shots)


def test_the_largest_of_several_colmap_models(shots: list[Shot], tmp_path: Path):
    write_colmap(tmp_path / "other", shots[:2])
    folder = write_colmap(tmp_path / "scene", shots, place="sparse/1")
    (tmp_path / "other/sparse/0").rename(folder / "sparse/0")
    assert len(_load(folder).train) == len(shots)
    assert len(ColmapConfig(model="sparse/0").build(str(folder)).load().train) == 2


def test_images_of_a_model_that_are_not_there(shots: list[Shot], tmp_path: Path):
    folder = write_colmap(tmp_path / "scene", shots)
    (folder / "images/r_01.png").unlink()
    (folder / "images/other.png").write_bytes(b"x")
    scene = _load(folder)
    assert len(scene.train) == len(shots) - 1
    assert any("1 of 6 images are not there and are left out: r_01.png." in note for note in scene.notes)
    assert any(
        "1 files in images/ have no camera in the model and are not used (other.png)" in note for note in scene.notes
    )


def test_colmap_against_pycolmap(shots: list[Shot], tmp_path: Path):
    """What COLMAP itself writes, binary and text, is read as COLMAP reads it."""
    pycolmap = pytest.importorskip("pycolmap")
    points = np.random.default_rng(0).normal(size=(20, 3))
    folder = write_colmap(tmp_path / "scene", shots, points=points)
    theirs = pycolmap.Reconstruction(folder / "sparse/0")
    assert len(theirs.points3D) == 20
    for end in ("binary", "text"):
        written = tmp_path / end
        written.mkdir()
        getattr(theirs, f"write_{end}")(written)
        ours = read_model(written)
        np.testing.assert_allclose(ours.points, points, atol=1e-9)
        poses = {image.name: image.cam_from_world() for image in theirs.images.values()}
        for image in ours.images:
            np.testing.assert_allclose(image.world_to_camera[:3], poses[image.name].matrix(), atol=1e-9)


def test_test_views(shots: list[Shot], tmp_path: Path):
    folder = write_colmap(tmp_path / "scene", shots)
    scene = ColmapConfig(test_every=3).build(str(folder)).load()
    assert [view.name for view in scene.test] == ["r_00", "r_03"]
    assert len(scene.train) == 4
    lists = {"train_filenames": [f"images/{shot.name}.png" for shot in shots[:4]]}
    lists["test_filenames"] = ["images/r_05.png"]
    scene = _load(write_nerfstudio(tmp_path / "lists", shots, **lists))
    assert [len(scene.train), len(scene.test)] == [4, 1]
    assert scene.test[0].name == "images/r_05"


def test_applied_transform_is_undone_when_asked(shots: list[Shot], plain: Scene, tmp_path: Path):
    applied = np.array([[1.0, 0, 0, 0.3], [0, 0, 1, -1.0], [0, -1, 0, 2.0]])
    scale = 2.5
    folder = write_nerfstudio(tmp_path / "scene", shots)
    document = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
    for frame in document["frames"]:
        moved = np.vstack([applied, [0, 0, 0, 1]]) @ np.array(frame["transform_matrix"])
        moved[:3, 3] *= scale
        frame["transform_matrix"] = moved.tolist()
    document |= {"applied_transform": applied.tolist(), "applied_scale": scale}
    (folder / "transforms.json").write_text(json.dumps(document), encoding="utf-8")
    back = NerfstudioConfig(original_frame=True).build(str(folder)).load()
    for view, same in zip(back.train, plain.train, strict=True):
        torch.testing.assert_close(view.camera.world_to_camera, same.camera.world_to_camera, rtol=0, atol=1e-9)
    as_written = _load(folder)
    assert as_written.box.scale == pytest.approx(scale * plain.box.scale, rel=0.05)
    assert any("--dataset.original-frame undoes" in note for note in as_written.notes)


def test_box_is_taken_as_given(shots: list[Shot], tmp_path: Path):
    folder = write_idr(tmp_path / "scene", shots)
    scene = IdrConfig(box=(-1.0, -1.0, -1.0, 1.0, 2.0, 1.0)).build(str(folder)).load()
    assert scene.box.maximum.tolist() == [1.0, 2.0, 1.0]
    assert scene.notes[-1] == "box as given."


def test_the_ball_of_scale_mat_without_masks(shots: list[Shot], tmp_path: Path):
    folder = write_idr(tmp_path / "scene", shots)
    for path in (folder / "mask").iterdir():
        path.unlink()
    (folder / "mask").rmdir()
    scene = IdrConfig(masks="none", background="none").build(str(folder)).load()
    assert scene.box.maximum.tolist() == pytest.approx([1.1] * 3)
    assert all(view.alpha is None for view in scene.train)


@pytest.mark.parametrize("write", [write_colmap, write_idr, write_nerfstudio])
def test_masks_that_are_ignored(write: Write, shots: list[Shot], tmp_path: Path):
    """Black masks would leave nothing; the black background is keyed out as if they were not there."""
    folder = write(tmp_path / "scene", shots)
    for path in (*folder.glob("mask/*"), *folder.glob("masks/*")):
        write_image(path, np.zeros_like(shots[0].image[..., 3]))
    assert has_mask_files(folder)
    with pytest.raises(DataError, match="transparent"):
        _load(folder)
    scene = AutoDatasetConfig(masks="ignored").build(str(folder)).load()
    assert not any("mask in a file" in note for note in scene.notes)
    for view, shot in zip(scene.train, shots, strict=True):
        assert view.alpha is not None
        assert ((view.alpha.numpy() > 0.5) == (shot.image[..., 3] > 0)).mean() > 0.95


def test_layouts_without_masks_in_files_say_so(shots: list[Shot], tmp_path: Path):
    folder = write_blender(tmp_path / "scene", shots)
    assert not has_mask_files(folder)
    with pytest.raises(ConfigError, match="images of NeRF-Synthetic have an alpha channel instead"):
        AutoDatasetConfig(masks="ignored").build(str(folder))
    with pytest.raises(ConfigError, match="demo scenes have masks of their own"):
        AutoDatasetConfig(masks="ignored").build("demo")


def test_sparse_points_give_the_box_where_there_are_no_masks(shots: list[Shot], tmp_path: Path):
    points = np.random.default_rng(0).normal(size=(500, 3))
    points *= 0.8 / np.linalg.norm(points, axis=1, keepdims=True)
    strays = np.array([[40.0, 0, 0], [0, 0, -1.5], [1.4, 1.4, 1.4]])
    folder = write_colmap(tmp_path / "scene", shots, points=np.concatenate([points, strays]), masks=False)
    scene = ColmapConfig(masks="none", background="none").build(str(folder)).load()
    assert 0.8 < scene.box.scale < 1.2
    assert scene.box.center.abs().max() < 0.2
    assert "sparse points; there are no masks" in scene.notes[-1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"downscale": -1}, r"--dataset.downscale is -1; expected 0"),
        ({"test_every": 1}, r"--dataset.test-every is 1; expected 0, or 2 or more"),
        ({"test_every": -2}, r"--dataset.test-every is -2"),
        ({"box": (0.0, 0.0, 0.0, 0.0, 1.0, 1.0)}, r"--dataset.box is 0 0 0 0 1 1; expected X0"),
        ({"box": (0.0, 0.0, 0.0, float("nan"), 1.0, 1.0)}, r"--dataset.box.3 is nan; expected a finite number"),
    ],
)
@pytest.mark.parametrize("config", [ColmapConfig, IdrConfig, NerfstudioConfig])
def test_options_out_of_range(config: type, options: dict, message: str):
    with pytest.raises(ConfigError, match=message):
        check_component(config(**options))


def test_all_views_held_out(shots: list[Shot], tmp_path: Path):
    folder = write_colmap(tmp_path / "scene", shots[:1])
    with pytest.raises(DataError, match=r"1 views; all of them would be test views"):
        ColmapConfig(test_every=2).build(str(folder)).load()


def test_demo_takes_no_downscale():
    with pytest.raises(ConfigError, match=r"--dataset.resolution"):
        replace(AutoDatasetConfig(), downscale=2).build("demo")
