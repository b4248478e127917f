"""Cameras of photographs from the board that they show."""

import json
import math
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_views import AWAY, FOCAL, HEIGHT, WIDTH, around, degrees_between, photographs, write_images
from PIL import Image

from sculpt_framework.cli.data import data
from sculpt_framework.errors import ConfigError, DataError, OutputError
from sculpt_framework.frame import frame_of
from sculpt_framework.markers.boards import board_of
from sculpt_framework.markers.photographs import list_photographs
from sculpt_framework.markers.turntable import PosedByBoard, pose_by_board
from sculpt_plugins.datasets.nerfstudio.config import NerfstudioConfig

RING = board_of("ring-5x6-30")


@pytest.fixture(scope="module")
def ring_images() -> list[np.ndarray]:
    return photographs(RING, around(8))


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", ["sculpt-data", "pose-board", *(str(word) for word in words)])
    data()


def posed(folder: Path, name: str = "ring-5x6-30", focal: float | None = None) -> PosedByBoard:
    return pose_by_board(list_photographs(str(folder)), board_of(name), focal, lambda share: None)


def worst(found: PosedByBoard, poses: list[np.ndarray]) -> tuple[float, float]:
    """The largest errors of orientation, in degrees, and of position, relative to the distance."""
    turns, shifts = [], []
    for item in found.posed:
        true, pose = poses[int(item.photograph.path.stem[1:])], item.pose.world_to_camera
        turns.append(math.degrees(np.linalg.norm(cv2.Rodrigues(pose[:3, :3].T @ true[:3, :3])[0])))
        shifts.append(np.linalg.norm(item.pose.position + true[:3, :3].T @ true[:3, 3]) / AWAY)
    return max(turns), max(shifts)


@pytest.mark.parametrize(("name", "low", "high"), [("charuco-7x9-26", 30, 60), ("ring-5x6-30", 45, 45)])
def test_a_plain_ball_on_a_turntable_gets_its_cameras(
    name: str, low: float, high: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The second as a fixed camera sees a turntable: all views from one height."""
    poses = around(8, low=low, high=high)
    folder = write_images(tmp_path / "shots", photographs(board_of(name), poses))
    run(monkeypatch, folder, "--board", name, "--out", tmp_path / "scene")
    scene = NerfstudioConfig(masks="none").build(str(tmp_path / "scene")).load()
    assert len(scene.train) == 8
    for view, true in zip(scene.train, poses, strict=True):
        pose = view.camera.world_to_camera.numpy()
        assert math.degrees(np.linalg.norm(cv2.Rodrigues(pose[:3, :3].T @ true[:3, :3])[0])) < 0.1
        assert np.linalg.norm(view.camera.position.numpy() + true[:3, :3].T @ true[:3, 3]) < 3e-3 * AWAY
        assert view.camera.fx == pytest.approx(FOCAL, rel=3e-3)
    frame = frame_of(scene, str(tmp_path / "scene"))
    assert frame is not None
    assert (frame.metres_per_unit, frame.up) == (1.0, (0.0, 0.0, 1.0))
    # What is measured in the scene, from its cameras, is what was written.
    monkeypatch.setattr(sys, "argv", ["sculpt-data", "scale", str(tmp_path / "scene"), "--board", name])
    data()
    again = json.loads((tmp_path / "scene" / "frame.json").read_text(encoding="utf-8"))
    assert again["metres_per_unit"] == pytest.approx(1, rel=1e-3)
    assert degrees_between(again["up"], (0, 0, 1)) < 0.1


def test_a_distorted_lens_is_calibrated(tmp_path: Path):
    poses, k1 = around(10), -0.15
    lens = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    from_where = cv2.undistortPoints(grid, lens, np.array([k1, 0, 0, 0]), P=lens).reshape(HEIGHT, WIDTH, 2)
    maps = from_where.astype(np.float32)
    bent = [cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC) for image in photographs(RING, poses)]
    found = posed(write_images(tmp_path / "shots", bent))
    assert found.posed[0].lens.k1 == pytest.approx(k1, abs=0.02)
    turn, shift = worst(found, poses)
    assert turn < 0.1
    assert shift < 3e-3


def test_views_that_do_not_show_the_board_are_named_and_left_out(
    ring_images: list[np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    images = [image.copy() for image in ring_images]
    images[3][:] = 90
    images[5][:, :] = cv2.GaussianBlur(images[5], (0, 0), 15)
    run(
        monkeypatch,
        write_images(tmp_path / "scene" / "images", images),
        "--board",
        "ring-5x6-30",
        "--out",
        tmp_path / "scene",
    )
    told = capsys.readouterr().out
    assert "6 of 8 photographs have a camera" in told
    assert "left out: p03.png: shows 0 points" in told
    assert "left out: p05.png: shows" in told
    frames = json.loads((tmp_path / "scene" / "transforms.json").read_text(encoding="utf-8"))["frames"]
    assert [Path(frame["file_path"]).stem for frame in frames] == ["p00", "p01", "p02", "p04", "p06", "p07"]


def test_the_focal_length_is_taken_from_exif_where_the_board_does_not_tell(tmp_path: Path):
    """Two views cannot calibrate a lens; a third, from the same place, adds nothing."""
    poses = around(3, low=88, high=89)
    images = photographs(RING, poses)
    folder = tmp_path / "shots"
    folder.mkdir()
    film = round(FOCAL / math.hypot(WIDTH, HEIGHT) * math.hypot(36, 24))
    for index, image in enumerate(images):
        picture, exif = Image.fromarray(image), Image.Exif()
        exif.get_ifd(0x8769)[41989] = film
        picture.save(folder / f"p{index:02d}.jpg", quality=97, exif=exif)
    found = posed(folder)
    assert "by EXIF" in found.lines[0]
    assert found.posed[0].lens.focal == pytest.approx(FOCAL, rel=0.02)
    given = posed(folder, focal=FOCAL)
    assert worst(given, poses)[1] < 5e-3
    bare = write_images(tmp_path / "bare", images)
    with pytest.raises(DataError, match="--focal PIXELS"):
        posed(bare)


def test_another_board_than_the_one_named_is_told(ring_images: list[np.ndarray], tmp_path: Path):
    folder = write_images(tmp_path / "shots", ring_images[:4])
    with pytest.raises(DataError, match="pixels off that board: was another one printed"):
        posed(folder, "ring-6x5-30")


def test_mirrored_photographs_are_told(ring_images: list[np.ndarray], tmp_path: Path):
    images = [image[:, ::-1].copy() for image in ring_images[:4]]
    with pytest.raises(DataError, match="as in a mirror"):
        posed(write_images(tmp_path / "shots", images))


def test_photographs_of_any_kind_below_the_folder_are_taken(
    ring_images: list[np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    heif = pytest.importorskip("pillow_heif")
    shots = write_images(tmp_path / "shots", ring_images[:6])
    (shots / "second").mkdir()
    for number, image in enumerate(ring_images[6:]):
        # One name twice, in two folders.
        assert cv2.imwrite(str(shots / "second" / f"p0{number}.webp"), image, [cv2.IMWRITE_WEBP_QUALITY, 101])
    (shots / "masks").mkdir()
    cv2.imwrite(str(shots / "masks" / "p03.png"), np.full((HEIGHT, WIDTH), 255, np.uint8))
    picture = Image.open(shots / "p05.png").convert("RGB")
    (shots / "p05.png").unlink()
    heif.from_pillow(picture).save(shots / "p05.heic", quality=95)
    run(monkeypatch, shots, "--board", "ring-5x6-30", "--out", tmp_path / "scene")
    scene = NerfstudioConfig(masks="none").build(str(tmp_path / "scene")).load()
    assert len(scene.train) == len(ring_images)
    assert [path.name for path in (tmp_path / "scene" / "masks").iterdir()] == ["p03.png.png"]
    known = dict(zip((f"p{number:02d}" for number in range(6)), around(8), strict=False))
    for view in scene.train:
        if "second" not in view.name:
            true = known[Path(view.name).stem]
            assert np.linalg.norm(view.camera.position.numpy() + true[:3, :3].T @ true[:3, 3]) < 3e-3 * AWAY


def test_what_cannot_be_done_is_told_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shots = write_images(tmp_path / "shots", [np.full((48, 64), 90, np.uint8)] * 3)
    out = tmp_path / "scene"
    with pytest.raises(DataError, match="seen in 0 of 3 photographs"):
        run(monkeypatch, shots, "--board", "ring-5x6-30", "--out", out)
    with pytest.raises(ConfigError, match="single markers lie anywhere"):
        run(monkeypatch, shots, "--board", "single-4-40", "--out", out)
    (tmp_path / "empty" / "notes").mkdir(parents=True)
    with pytest.raises(DataError, match=r"no photographs; expected .*; found notes/"):
        run(monkeypatch, tmp_path / "empty", "--board", "ring-5x6-30", "--out", out)
    assert not out.exists()
    out.mkdir()
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r"holds notes\.txt"):
        run(monkeypatch, shots, "--board", "ring-5x6-30", "--out", out)
