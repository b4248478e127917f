"""What docs/make_captures.py does without Blender: cameras, what is written of them, lenses, and the files it reads."""

import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from blender_captures import developing, rigs
from blender_captures.exr import read_passes
from blender_captures.parts import Piece, standing
from blender_captures.printed_board import BOARD, METRES, THICK, board_below, true_frame
from make_captures import KINDS, write_cameras
from trimesh import Trimesh
from trimesh.creation import icosphere
from trimesh.util import concatenate
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

from sculpt_framework.markers.boards import board_of
from sculpt_framework.markers.detection import find_board
from sculpt_framework.posed_images.distortion import distorted_pixels
from sculpt_framework.posed_images.lens import Pinhole
from sculpt_plugins.datasets.idr.cameras import ball_box, placed_camera, read_matrices
from sculpt_plugins.datasets.nerfstudio.config import NerfstudioConfig

BALL = np.asarray(icosphere(subdivisions=3).vertices)


def _inside(pixels: np.ndarray) -> np.ndarray:
    return ((pixels >= 0) & (pixels <= (rigs.WIDTH, rigs.HEIGHT))).all(axis=1)


@pytest.mark.parametrize(
    ("kind", "count"), [("lab", 49), ("phone", 42), ("turntable", 60), ("museum", 46), ("flipped", 84)]
)
def test_every_view_shows_the_object_and_only_the_lab_cuts_it(kind: str, count: int):
    rig = KINDS[kind].rig()
    assert len(rig.shots) == count
    seen = [_inside(rigs.projected(0.8 * BALL, shot.pose, rig.focal)).mean() for shot in rig.shots]
    if kind == "lab":
        assert max(seen) < 1
        assert min(seen) > 0.3
    else:
        assert min(seen) == 1


@pytest.mark.parametrize(("kind", "count", "least"), [("forest", 23, 0.3), ("shelf", 40, 0.8)])
def test_views_by_hand_from_one_side_lose_some_of_what_is_around(kind: str, count: int, least: float):
    rig = KINDS[kind].rig()
    assert len(rig.shots) == count
    places = np.stack([shot.pose[:3, 3] for shot in rig.shots])
    assert places[:, 1].max() < 0
    seen = [_inside(rigs.projected(0.8 * BALL, shot.pose, rig.focal)).mean() for shot in rig.shots]
    assert least < min(seen) < 1


def test_truth_is_one_surface_in_the_unit_ball_without_crumbs():
    solid, crumb, hollow = icosphere(3, 2.0), icosphere(2, 0.03), icosphere(2, 0.05)
    crumb.apply_translation([2.2, 0, 0])
    hollow.invert()
    mesh = concatenate([solid, crumb, hollow])
    assert isinstance(mesh, Trimesh)
    pieces, truth = standing([Piece(mesh=mesh, paint="plaster")])
    assert truth.is_watertight
    assert len(truth.faces) == len(solid.faces)
    np.testing.assert_allclose(np.linalg.norm(truth.vertices, axis=1), 1, atol=1e-9)
    largest = np.linalg.norm(pieces[0].mesh.vertices, axis=1).max()
    assert largest == pytest.approx(2.23 / 2)


def test_a_turntable_stands_still_in_its_room():
    rig = rigs.turntable()
    in_room = np.stack([rigs.turned(shot.turn) @ shot.pose for shot in rig.shots])
    assert np.abs(in_room[:30] - in_room[0]).max() < 1e-12
    assert np.abs(in_room[30:] - in_room[30]).max() < 1e-12
    poses = np.stack([shot.pose[:3, 3] for shot in rig.shots[:30]])
    gaps = np.linalg.norm(poses - np.roll(poses, 1, axis=0), axis=1)
    assert np.ptp(gaps) < 1e-12
    assert gaps[0] > 0.5


def test_a_flipped_object_stands_on_its_head_before_cameras_that_stand_still():
    rig = rigs.twice()
    in_room = np.stack([shot.stand @ shot.pose for shot in rig.shots])
    for first, last in ((0, 24), (24, 42), (42, 66), (66, 84)):
        assert np.abs(in_room[first:last] - in_room[first]).max() < 1e-12
    top = np.array([0, 0, 1, 1.0])
    heights = [(shot.stand @ top)[2] for shot in rig.shots]
    np.testing.assert_allclose(heights, [1.0] * 42 + [-1.0] * 42, atol=1e-12)
    # The second time it is seen from below.
    assert all((shot.pose[2, 3] < 0) == shot.flipped for shot in rig.shots)


def test_the_board_below_an_object_is_the_one_that_is_searched_for():
    piece, board = board_below(-0.8), board_of(BOARD)
    visual = piece.mesh.visual
    assert isinstance(visual, TextureVisuals)
    assert isinstance(visual.material, SimpleMaterial)
    image = np.asarray(visual.material.image)
    seen = find_board(image, board)
    assert len(seen.points) == len(board.points())
    # From pixels to the sheet's corners, by which its texture is laid on.
    shares = seen.pixels / (image.shape[1], image.shape[0]) * (1, -1) + (0, 1)
    corners = np.asarray(piece.mesh.vertices)
    placed = corners[0] + shares[:, :1] * (corners[1] - corners[0]) + shares[:, 1:] * (corners[3] - corners[0])
    cos, sin = np.cos(0.3), np.sin(0.3)
    true = board.points()[seen.points] / METRES @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    np.testing.assert_allclose(placed, true + np.array([0, 0, -0.8 + THICK]), atol=2e-3)
    assert true_frame().metres_per_unit == METRES


def test_idr_matrices_are_read_as_the_cameras_they_were_written_from(tmp_path: Path):
    rig = rigs.lab()
    write_cameras("lab", rig, tmp_path)
    matrices = read_matrices(tmp_path / "cameras_sphere.npz")
    for index, shot in enumerate(rig.shots):
        camera = placed_camera(matrices[f"world_mat_{index}"], "here")
        lens = (camera.pinhole.fx, camera.pinhole.fy, camera.pinhole.cx, camera.pinhole.cy)
        assert lens == pytest.approx((rig.focal, rig.focal, rigs.WIDTH / 2, rigs.HEIGHT / 2), abs=1e-6)
        local = BALL @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        pixels = rig.focal * local[:, :2] / local[:, 2:] + (rigs.WIDTH / 2, rigs.HEIGHT / 2)
        np.testing.assert_allclose(pixels, rigs.projected(BALL, shot.pose, rig.focal), atol=1e-6)
    region, box = rig.region, ball_box(matrices, tmp_path)
    assert region is not None
    assert box is not None
    np.testing.assert_allclose(box.minimum.numpy(), region[0] - region[1], atol=1e-12)
    np.testing.assert_allclose(box.maximum.numpy(), region[0] + region[1], atol=1e-12)


def test_poses_as_if_found_are_off_by_the_error_that_is_asked_for():
    rig = rigs.phone()
    found = rigs.as_if_found(rig, 0.4, seed=61)
    squares = [
        np.square(rigs.projected(0.8 * BALL, wrong.pose, rig.focal) - rigs.projected(0.8 * BALL, shot.pose, rig.focal))
        for shot, wrong in zip(rig.shots, found.shots, strict=True)
    ]
    assert 0.3 < np.sqrt(np.mean([square.sum(axis=1).mean() for square in squares])) < 0.5


def test_the_lens_of_a_phone_is_the_one_that_is_written(tmp_path: Path):
    rig, camera = rigs.phone(), developing.CAMERAS["phone"]
    lens = Pinhole(fx=rig.focal, fy=rig.focal, cx=rigs.WIDTH / 2, cy=rigs.HEIGHT / 2)
    straight = Pinhole(fx=rig.focal, fy=rig.focal, cx=lens.cx + camera.border, cy=lens.cy + camera.border)
    rows, columns = np.mgrid[0 : rigs.HEIGHT + 2 * camera.border, 0 : rigs.WIDTH + 2 * camera.border] + 0.5
    for direction in ([-0.5, -0.38, 1.0], [0.52, 0.36, 1.0], [0.1, 0.0, 1.0]):
        ray = np.array([direction])
        place = (straight.fx * direction[0] + straight.cx, straight.fy * direction[1] + straight.cy)
        spot = np.exp(-((columns - place[0]) ** 2 + (rows - place[1]) ** 2) / 18).astype(np.float32)
        (tmp_path / "mask.png").write_bytes(developing.mask(spot, camera, rig.focal))
        mask = cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_UNCHANGED).astype(float)
        v, u = np.mgrid[0 : rigs.HEIGHT, 0 : rigs.WIDTH] + 0.5
        middle = np.array([(u * mask).sum(), (v * mask).sum()]) / mask.sum()
        np.testing.assert_allclose(middle, distorted_pixels(ray, lens, camera.distortion)[0], atol=0.1)


def test_a_capture_is_read_with_its_masks(tmp_path: Path):
    rig, camera = rigs.museum(), developing.CAMERAS["museum"]
    rig = replace(rig, shots=rig.shots[::9])
    write_cameras("museum", rig, tmp_path)
    light = np.full((rigs.HEIGHT, rigs.WIDTH, 3), 0.2, np.float32)
    for name in ("images", "masks"):
        (tmp_path / name).mkdir()
    v, u = np.mgrid[0 : rigs.HEIGHT, 0 : rigs.WIDTH]
    covered = (np.hypot(u - 320, v - 240) < 150).astype(np.float32)
    for index in range(len(rig.shots)):
        (tmp_path / "images" / f"{index:04d}.jpg").write_bytes(developing.photograph(light, camera, rig.focal, index))
        (tmp_path / "masks" / f"{index:04d}.png").write_bytes(developing.mask(covered, camera, rig.focal))
    scene = NerfstudioConfig().build(str(tmp_path)).load()
    views = [*scene.train, *scene.test]
    assert len(views) == len(rig.shots)
    assert all(view.alpha is not None and abs(float(view.alpha.mean()) - covered.mean()) < 0.01 for view in views)


def test_a_photograph_is_the_same_bits_again_and_another_one_is_not():
    light = np.full((rigs.HEIGHT, rigs.WIDTH, 3), 0.2, np.float32)
    camera = developing.CAMERAS["museum"]
    assert developing.photograph(light, camera, 700, 3) == developing.photograph(light, camera, 700, 3)
    assert developing.photograph(light, camera, 700, 3) != developing.photograph(light, camera, 700, 4)


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def _picture(passes: dict[str, np.ndarray], compression: int = 0) -> bytes:
    height, width = next(iter(passes.values())).shape
    listed = b"".join(name.encode() + b"\0" + struct.pack("<iiii", 1, 0, 1, 1) for name in sorted(passes)) + b"\0"
    header = struct.pack("<II", 20000630, 2) + _attribute("channels", "chlist", listed)
    header += _attribute("compression", "compression", bytes([compression]))
    header += _attribute("dataWindow", "box2i", struct.pack("<4i", 0, 0, width - 1, height - 1)) + b"\0"
    lines = [b"".join(passes[name][row].astype("<f2").tobytes() for name in sorted(passes)) for row in range(height)]
    content, at = b"".join(struct.pack("<ii", row, len(line)) + line for row, line in enumerate(lines)), len(header)
    size = len(lines[0]) + 8
    return header + struct.pack(f"<{height}Q", *(at + 8 * height + size * row for row in range(height))) + content


def test_passes_are_read_as_they_are_written(tmp_path: Path):
    passes = {"ViewLayer.Combined.R": np.arange(12.0).reshape(3, 4), "ViewLayer.object.X": np.eye(3, 4)}
    (tmp_path / "a.exr").write_bytes(_picture(passes))
    read = read_passes(tmp_path / "a.exr")
    assert read.keys() == passes.keys()
    for name, values in passes.items():
        np.testing.assert_array_equal(read[name], values)
    (tmp_path / "b.exr").write_bytes(_picture(passes, compression=3))
    with pytest.raises(ValueError, match="compressed"):
        read_passes(tmp_path / "b.exr")
