"""Turntables and maps, read back by other libraries."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from small_scene import RADIUS, ball, color_at, views_of_ball

from sculpt_framework.errors import ConfigError, OutputError
from sculpt_framework.evaluation.pictures import color_picture
from sculpt_framework.export.pictures import paint, turntable_cameras, write_maps, write_turntable


def _frames(count: int = 6, size: int = 64):
    vertices, faces = ball(3)
    cameras = turntable_cameras(vertices, np.array([0.0, 0, 1]), count, size)
    return (color_picture(paint(vertices, faces, color_at(vertices), camera)) for camera in cameras)


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_cameras_go_round_and_see_all_of_it(up: str):
    vertices, _ = ball(2)
    vertices = vertices * [1.0, 0.5, 2.0] + [3.0, 1.0, 0.0]
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    cameras = list(turntable_cameras(vertices, axis, 8, 100))
    heights = [float(camera.position.numpy() @ axis) for camera in cameras]
    assert np.ptp(heights) < 1e-9
    assert heights[0] > (vertices @ axis).mean()
    for camera in cameras:
        pose = camera.world_to_camera.numpy()
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        local = vertices @ pose[:3, :3].T + pose[:3, 3]
        pixels = local[:, :2] / local[:, 2:] * camera.fx + 50
        assert (local[:, 2] > 0).all()
        assert pixels.min() > 0
        assert pixels.max() < 100
        # Up is up: rows of the image grow downwards.
        assert pose[1, :3] @ axis < 0


def test_gif(tmp_path: Path):
    path = tmp_path / "a.gif"
    write_turntable(path, _frames(), 15)
    with Image.open(path) as opened:
        assert opened.n_frames == 6
        assert opened.size == (64, 64)
        opened.seek(2)
        shown = np.asarray(opened.convert("RGB")).astype(float)
    truth = list(_frames())[2].astype(float)
    assert np.abs(shown - truth).mean() < 6
    assert [p.name for p in tmp_path.iterdir()] == ["a.gif"]


def test_mp4(tmp_path: Path):
    path = tmp_path / "a.mp4"
    write_turntable(path, _frames(), 15)
    video = cv2.VideoCapture(str(path))
    shown = []
    while True:
        there, frame = video.read()
        if not there:
            break
        shown.append(frame[:, :, ::-1].astype(float))
    video.release()
    assert len(shown) == 6
    assert np.abs(shown[2] - list(_frames())[2]).mean() < 8
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_what_cannot_be_written(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"a.avi: a turntable is a .gif or an .mp4 file"):
        write_turntable(tmp_path / "a.avi", _frames(), 15)
    for ending in ("gif", "mp4"):
        with pytest.raises(OutputError, match=r"cannot write .*nowhere"):
            write_turntable(tmp_path / "nowhere" / f"a.{ending}", _frames(), 15)
    assert not list(tmp_path.iterdir())


def test_maps_of_a_ball(tmp_path: Path):
    vertices, faces = ball(5)
    first, second = (replace(view, name=name) for view, name in zip(views_of_ball(2), ("a/b_c", "a_b/c"), strict=True))
    views = [first, second]
    assert write_maps(tmp_path, vertices, faces, views) == 2
    for view in views:
        with Image.open(tmp_path / "depth" / f"{view.name}.tiff") as opened:
            depth = np.asarray(opened)
        assert depth.dtype == np.float32
        normal = cv2.imread(str(tmp_path / "normal" / f"{view.name}.png"), cv2.IMREAD_UNCHANGED)
        assert normal is not None
        assert normal.dtype == np.uint16
        camera = view.camera
        rows, columns = np.nonzero(depth)
        z = depth[rows, columns].astype(np.float64)
        x, y = (columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z
        pose = camera.world_to_camera.numpy()
        world = (np.stack([x, y, z], axis=1) - pose[:3, 3]) @ pose[:3, :3]
        np.testing.assert_allclose(np.linalg.norm(world, axis=1), RADIUS, atol=2e-3)
        decoded = normal[rows, columns, ::-1] / 32767.5 - 1
        assert np.abs(decoded - world / RADIUS).max() < 0.02
        assert view.alpha is not None
        assert ((depth > 0) != (view.alpha.numpy() > 0)).mean() < 0.003
