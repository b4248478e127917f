"""Snapshots as files, the run directory they lie in, and what a mesh is coloured by."""

from pathlib import Path

import numpy as np
import pytest

from sculpt_framework.errors import CheckpointError
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.gaussian_files import write_gaussians_ply
from sculpt_framework.export.mesh_files import write_mesh_ply
from sculpt_framework.types import Camera
from sculpt_framework.viewing.colors import MODES, key_colors, paint, ramp
from sculpt_framework.viewing.frames import FOLDER, LIVE, Frame, frame_of, read_frame, write_frame
from sculpt_framework.viewing.run_folder import RunFolder

from .runs import line, make_run, octahedron


def test_a_whole_frame_comes_back_as_it_was(tmp_path: Path):
    straight = frame_of(octahedron(), outer=3, t_train=1.5)
    write_frame(tmp_path / "f.npz", octahedron(), outer=3, t_train=1.5, whole=True)
    read = read_frame(tmp_path / "f.npz")
    assert (read.outer, read.t_train) == (3, 1.5)
    np.testing.assert_array_equal(read.vertices, straight.vertices)
    np.testing.assert_array_equal(read.faces, straight.faces)
    np.testing.assert_allclose(read.colors, straight.colors, atol=1e-3)
    np.testing.assert_array_equal(read.face_keys, np.arange(8))
    assert read.gaussians is not None
    assert straight.gaussians is not None
    np.testing.assert_allclose(read.gaussians.means, straight.gaussians.means, atol=1e-6)
    # The box is 4 wide round (1, 1, 3): one unit of the object frame is 2 of the world's.
    assert read.vertices.min(axis=0).tolist() == [-1, -1, 1]
    assert read.cells is not None
    assert read.cells.level.tolist() == [1, 1]
    assert read.cells.side.tolist() == [0.5, 0.5]
    np.testing.assert_allclose(read.cells.minimum[0], [-0.5, -0.5, 1.5])


def test_a_recorded_step_has_the_colours_without_the_gaussians(tmp_path: Path):
    whole = frame_of(octahedron(), outer=3, t_train=1.5)
    write_frame(tmp_path / "f.npz", octahedron(), outer=3, t_train=1.5, whole=False)
    read = read_frame(tmp_path / "f.npz")
    assert read.gaussians is None
    np.testing.assert_allclose(read.colors, whole.colors, atol=1 / 250)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 half a file", b"nonsense"])
def test_a_damaged_frame_is_one_line(tmp_path: Path, damage: bytes):
    (tmp_path / "f.npz").write_bytes(damage)
    with pytest.raises(CheckpointError, match="is damaged and cannot be read"):
        read_frame(tmp_path / "f.npz")


def test_events_are_read_as_they_are_written(tmp_path: Path):
    run = RunFolder(make_run(tmp_path))
    assert len(run.read_news()) == 25
    assert run.started["scene"] == "shape"
    text = line("outer_step", 21, 2.1, loss=0.0)
    with open(tmp_path / "events.jsonl", "a", encoding="utf-8") as file:
        file.write(text[:20])
        file.flush()
        assert run.read_news() == []
        file.write(text[20:] + "{broken\n")
    assert [event["outer"] for event in run.read_news()] == [21]


def test_the_newest_state_is_the_result_if_there_is_one(tmp_path: Path):
    run = RunFolder(make_run(tmp_path))
    frame = run.newest()
    assert frame is not None
    assert frame.outer == 20
    stamp = run.live_stamp
    write_mesh_ply(tmp_path / "mesh.ply", frame.vertices, frame.faces, frame.colors)
    assert frame.gaussians is not None
    write_gaussians_ply(tmp_path / "gaussians.ply", frame.gaussians)
    assert run.live_stamp != stamp
    result = run.newest()
    assert result is not None
    assert result.outer == -1
    assert result.gaussians is not None
    np.testing.assert_allclose(result.vertices, frame.vertices)


def test_a_run_is_running_silent_or_ended(tmp_path: Path):
    import os

    run = RunFolder(make_run(tmp_path))
    assert run.status == "running"
    os.utime(tmp_path / "events.jsonl", (1e9, 1e9))
    assert run.status == "silent"
    (tmp_path / "metrics.json").write_text('{"status": "stopped"}', encoding="utf-8")
    assert run.status == "stopped"


def test_a_run_that_goes_on_after_it_was_stopped_shows_what_is_newer(tmp_path: Path):
    import os

    run = RunFolder(make_run(tmp_path))
    frame = run.newest()
    assert frame is not None
    write_mesh_ply(tmp_path / "mesh.ply", frame.vertices, frame.faces, frame.colors)
    (tmp_path / "metrics.json").write_text('{"status": "stopped"}', encoding="utf-8")
    with open(tmp_path / "events.jsonl", "a", encoding="utf-8") as file:
        file.write(line("run_ended", 20, 2.0, status="stopped"))
    run.read_news()
    assert run.status == "stopped"
    with open(tmp_path / "events.jsonl", "a", encoding="utf-8") as file:
        file.write(line("run_started", 20, 2.0, scene="shape", method="tiny", box=None, reference=None))
    run.read_news()
    assert run.status == "running"
    stamp = run.live_stamp
    write_frame(tmp_path / FOLDER / LIVE, octahedron(1.1), outer=30, t_train=3.0, whole=True)
    os.utime(tmp_path / "mesh.ply", (1e9, 1e9))
    assert run.live_stamp != stamp
    shown = run.newest()
    assert shown is not None
    assert shown.outer == 30
    # Of a finished run the result counts, also where copying has made its files alike in age.
    (tmp_path / "metrics.json").write_text('{"status": "finished"}', encoding="utf-8")
    result = run.newest()
    assert result is not None
    assert result.outer == -1


def test_a_killed_run_without_a_checkpoint_shows_its_last_recorded_step(tmp_path: Path):
    import os

    run = RunFolder(make_run(tmp_path))
    (tmp_path / FOLDER / LIVE).unlink()
    assert run.newest() is None  # it is running: something will come
    os.utime(tmp_path / "events.jsonl", (1e9, 1e9))
    frame = run.newest()
    assert frame is not None
    assert frame.outer == 10


def square(size: float = 1.0) -> Frame:
    """Two triangles in the plane z = 0, normals up."""
    vertices = size * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Frame(
        outer=1,
        t_train=0.0,
        vertices=vertices,
        faces=faces,
        colors=np.full((4, 3), 0.25, dtype=np.float32),
        face_keys=np.array([5, 6]),
    )


def camera(z: float) -> Camera:
    """At height ``z`` over the middle of the square, looking down its way to the plane."""
    import torch

    down = 1.0 if z < 0 else -1.0
    rotation = torch.diag(torch.tensor([1.0, down, down]))
    pose = torch.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ torch.tensor([0.5, 0.5, z])
    return Camera(world_to_camera=pose, fx=50.0, fy=50.0, cx=50.0, cy=50.0, width=100, height=100)


def test_normals_and_errors_have_the_colours_of_the_legend():
    painted = paint(square(), "normals", None, ())
    np.testing.assert_allclose(painted.colors, np.tile([0.5, 0.5, 1.0], (4, 1)))
    lifted = square().vertices.astype(np.float64) + np.array([0, 0, 1e-3])
    reference = MeasuredMesh(Mesh(vertices=lifted, faces=square().faces), 10)
    painted = paint(square(), "error", reference, ())
    np.testing.assert_allclose(painted.colors, np.tile(ramp(np.array([0.1 / np.sqrt(2)])), (4, 1)), atol=1e-5)
    assert "mean 0.001" in painted.legend
    assert "no reference" in paint(square(), "error", None, ()).legend


def test_seen_is_green_and_hidden_red():
    seen = paint(square(), "seen", None, [camera(1.0)])
    np.testing.assert_allclose(seen.colors, np.tile([0.25, 0.6, 0.35], (4, 1)), atol=1e-6)
    # A camera close over the middle has no corner in its picture.
    hidden = paint(square(), "seen", None, [camera(0.1)])
    np.testing.assert_allclose(hidden.colors, np.tile([0.8, 0.25, 0.2], (4, 1)), atol=1e-6)


def test_faces_have_one_colour_each():
    painted = paint(square(), "triangles", None, ())
    assert painted.vertices.shape == (6, 3)
    np.testing.assert_allclose(painted.colors, np.tile(ramp(np.array([0.25])), (6, 1)), atol=1e-5)
    keys = paint(square(), "face keys", None, ())
    np.testing.assert_allclose(keys.colors[::3], key_colors(np.array([5, 6])), atol=1e-6)
    assert not np.allclose(keys.colors[0], keys.colors[3])


@pytest.mark.parametrize("mode", MODES)
def test_every_colouring_takes_any_frame(mode: str):
    painted = paint(frame_of(octahedron(), outer=1, t_train=0.0), mode, None, ())
    assert np.isfinite(painted.colors).all()
    assert painted.colors.min() >= 0
    assert painted.colors.max() <= 1
