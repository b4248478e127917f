"""Cameras that contradict the matches are found out, and better ones take their place."""

from pathlib import Path

import numpy as np
import pytest
from mapped_box import OPTIONS, MappedBox, ignore, mapped_box

from sculpt_framework.posing import colmap
from sculpt_framework.posing.explained import Explained, epipolar_errors, explained
from sculpt_framework.posing.second_opinion import best_explained

pycolmap = pytest.importorskip("pycolmap")


def _pose(degrees: float, shift: tuple[float, float, float]) -> np.ndarray:
    """World to camera: turned about y, then shifted."""
    turn = np.deg2rad(degrees)
    rotation = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    return np.hstack([np.array(rotation), np.array(shift)[:, None]])


def _seen(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    local = points @ pose[:, :3].T + pose[:, 3]
    return local[:, :2] / local[:, 2:]


def test_points_off_the_epipolar_line_are_as_far_off_as_they_were_moved():
    points = np.random.default_rng(3).uniform(-1, 1, (50, 3)) + np.array([0, 0, 6])
    first, second = _pose(0, (0, 0, 0)), _pose(0, (-1, 0, 0))
    here, there = _seen(points, first), _seen(points, second)
    assert epipolar_errors(here, there, first, second) == pytest.approx(np.zeros(50), abs=1e-12)
    # The cameras stand side by side: epipolar lines are rows, and both ends share what one was moved by.
    moved = there + np.array([0.02, 0.01])
    assert epipolar_errors(here, moved, first, second) == pytest.approx(np.full(50, 0.01 / np.sqrt(2)), rel=1e-9)
    turned = _pose(12, (-1, 0.2, 0.1))
    assert epipolar_errors(here, _seen(points, turned), first, turned) == pytest.approx(np.zeros(50), abs=1e-12)
    assert epipolar_errors(here, _seen(points, turned), first, _pose(15, (-1, 0.2, 0.1))).min() > 1e-4


def test_cameras_in_one_place_say_nothing_about_points():
    points = np.random.default_rng(3).uniform(-1, 1, (5, 3)) + np.array([0, 0, 6])
    pose = _pose(0, (0, 0, 0))
    assert np.isnan(epipolar_errors(_seen(points, pose), _seen(points, pose), pose, pose)).all()


def test_a_photograph_without_matches_is_not_doubtful():
    counted = Explained(matches={"a": 10, "b": 8, "c": 0}, explained={"a": 9, "b": 3, "c": 0})
    assert counted.below(0.5) == ["b"]
    assert counted.total == 6


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> MappedBox:
    return mapped_box(tmp_path_factory.mktemp("box"))


def _with_wrong(model: "pycolmap.Reconstruction", name: str) -> "pycolmap.Reconstruction":
    """One camera turned by five degrees, across the epipolar lines of a ring."""
    made = pycolmap.Reconstruction(model)
    (image,) = (image for image in made.images.values() if image.name == name)
    turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([np.deg2rad(5), 0, 0])), np.zeros(3))
    made.frame(image.frame_id).set_cam_from_world(image.camera_id, turn * image.cam_from_world())
    return made


@pytest.mark.slow
def test_a_wrong_camera_explains_few_matches(box: MappedBox):
    right = explained(box.model, box.database)
    assert right.below(0.9) == []
    assert explained(_with_wrong(box.model, box.names[3]), box.database).below(0.5) == [box.names[3]]
    assert explained(colmap.without(box.model, [box.names[5]]), box.database).below(0.5) == [box.names[5]]


@pytest.mark.slow
def test_better_cameras_take_the_place_of_wrong_ones(box: MappedBox, tmp_path: Path):
    wrong = _with_wrong(box.model, box.names[3])
    (better,) = best_explained([wrong], box.database, box.images, tmp_path / "work", OPTIONS, ignore)
    assert explained(better, box.database).below(0.9) == []
    found, known = colmap.world_to_cameras(better), colmap.world_to_cameras(box.model)
    assert found.keys() == known.keys()
    # Frames of their own: the turns from one camera to the next are compared.
    for first, second in zip(box.names, box.names[1:], strict=False):
        turns = [poses[second][:3, :3] @ poses[first][:3, :3].T for poses in (found, known)]
        assert turns[0] == pytest.approx(turns[1], abs=0.01)
    assert not list((tmp_path / "work").rglob("database.db"))


@pytest.mark.slow
def test_cameras_that_explain_their_matches_are_kept_as_they_are(box: MappedBox, tmp_path: Path):
    assert best_explained([box.model], box.database, box.images, tmp_path / "work", OPTIONS, ignore) == [box.model]
    assert not (tmp_path / "work").exists()
