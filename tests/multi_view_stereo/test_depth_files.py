"""``sculpt-data depths``: what is written."""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from exact_views import DentedBall, camera_at, fan, photograph

from sculpt_framework.cli.data import data
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.errors import ConfigError, DataError, OutputError
from sculpt_framework.multi_view_stereo.depth_maps import StereoOptions
from sculpt_framework.multi_view_stereo.files import ViewDepths, depth_sheet, scene_depths, write_depths
from sculpt_framework.types import Box, Camera, Scene

OPTIONS = StereoOptions(pixels=48, neighbours=6, agreeing=2)
BALL = DentedBall(dent=0.0)
SCALE, SHIFT = 3.0, torch.tensor([5.0, -2.0, 1.0], dtype=torch.float64)


def moved(camera: Camera) -> Camera:
    """The camera in a world that is three times as large and elsewhere."""
    pose = camera.world_to_camera.clone()
    pose[:3, 3] = SCALE * pose[:3, 3] - pose[:3, :3] @ SHIFT
    return replace(camera, world_to_camera=pose)


def scene_of(cameras: list[Camera], masked: bool) -> Scene:
    views = [photograph(BALL, camera, masked=masked) for camera in cameras]
    named = [replace(v, name=f"images/{i}", camera=moved(v.camera)) for i, v in enumerate(views)]
    box = Box(minimum=SHIFT - SCALE, maximum=SHIFT + SCALE)
    return Scene(name="ball", train=tuple(named), test=(), box=box)


@pytest.fixture(scope="module")
def found() -> list[ViewDepths]:
    scene = scene_of(fan(48), masked=True)
    assert scene.train[2].alpha is not None
    # Left out, so that names must not be those of the places in the stack.
    empty = replace(scene.train[2], alpha=torch.zeros_like(scene.train[2].alpha))
    return scene_depths(replace(scene, train=(*scene.train[:2], empty, *scene.train[3:])), OPTIONS, 32)


def test_files_hold_points_and_normals_of_the_world(found: list[ViewDepths], tmp_path: Path) -> None:
    assert [each.view.name for each in found] == [f"images/{i}" for i in range(9) if i != 2]
    away, cosines = [], []
    for each in found:
        path = write_depths(each, tmp_path)
        assert path == tmp_path / f"{each.view.name}.npz"
        with np.load(path) as held:
            depth, normal, confidence = held["depth"], held["normal"], held["confidence"]
            intrinsics, pose = held["intrinsics"], held["world_to_camera"]
        assert np.array_equal(depth > 0, confidence > 0)
        rows, columns = np.nonzero(depth)
        local = np.linalg.inv(intrinsics) @ np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
        points = ((depth[rows, columns] * local).T - pose[:3, 3]) @ pose[:3, :3] - SHIFT.numpy()
        away.append(np.abs(np.linalg.norm(points, axis=1) / SCALE - BALL.radius))
        cosines.append((normal[rows, columns] * points).sum(axis=1) / np.linalg.norm(points, axis=1))
        assert (normal[depth == 0] == 0).all()
    assert sum(len(part) for part in away) > 1000
    assert np.median(np.concatenate(away)) < 0.03
    assert np.median(np.concatenate(cosines)) > 0.95


def test_without_masks_all_of_the_box_is_looked_at() -> None:
    heard: list[float] = []
    found = scene_depths(scene_of(fan(32), masked=False), replace(OPTIONS, pixels=32), 32, heard.append)
    assert len(found) == 9
    assert max(each.known.mean() for each in found) > 0.1
    assert heard[-1] == pytest.approx(1)


def test_the_sheet_shows_depths_only_where_they_are_known(found: list[ViewDepths]) -> None:
    sheet = depth_sheet(found)
    assert sheet.shape == (3 * 150, 9 * 150, 3)
    blank = replace(found[0], depth=np.zeros_like(found[0].depth), confidence=np.zeros_like(found[0].confidence))
    told, silent = depth_sheet([found[0]]).astype(int), depth_sheet([blank]).astype(int)
    colored = np.ptp(told[:130, 150:300], axis=2) > 50
    assert colored.any()
    assert not (np.ptp(silent[:130, 150:300], axis=2) > 50).any()


def test_views_too_far_apart_are_refused() -> None:
    apart = [camera_at((x, 0.0, 1.0), 24) for x in (-1.0, 0.2, 2.0)]
    with pytest.raises(DataError, match="no depth was found in 3 views"):
        scene_depths(scene_of(apart, masked=True), replace(OPTIONS, pixels=16), 16)


def _run(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", ["sculpt-data", *(str(word) for word in words)])
    data()


def test_the_command_writes_all_views_and_a_sheet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(
        demo_object("pebble"),
        DemoSettings(train_views=24, test_views=1, resolution=48, reference_cells=16),
        tmp_path / "scene",
    )
    out = tmp_path / "depths"
    with pytest.raises(ConfigError, match="--pixels 0"):
        _run(monkeypatch, "depths", tmp_path / "scene", "--out", out, "--pixels", 0)
    assert not out.exists()
    _run(monkeypatch, "depths", tmp_path / "scene", "--out", out, "--pixels", 32)
    assert len(list(out.rglob("*.npz"))) == 24
    assert np.asarray(cv2.imread(str(tmp_path / "depths-sheet.png"))).shape == (8 * 150, 9 * 150, 3)
    assert "depths of 24 views" in capsys.readouterr().out
    with pytest.raises(OutputError, match="not empty"):
        _run(monkeypatch, "depths", tmp_path / "scene", "--out", out)
