"""Metres and up of a scene, against boards whose size and place are known."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from board_views import SCALE, SHIFT, TURN, around, degrees_between, photograph, photographs, printed, scene_of

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.frame import FRAME_NAME, WorldFrame, frame_of, read_frame, write_frame
from sculpt_framework.markers.boards import Board, board_of
from sculpt_framework.markers.scale import MeasuredFrame, ScaleBar, measure_frame, scale_bar, with_what_was_known
from sculpt_framework.markers.similarity import fit_similarity
from sculpt_framework.types import Scene

UP = TURN[:, 2]
POSES = around(8)


def measured(scene: Scene, *boards: Board, bars: tuple[ScaleBar, ...] = ()) -> MeasuredFrame:
    return measure_frame(scene, boards, bars, "apriltag_36h11", None, lambda share: None)


def metres(found: MeasuredFrame) -> float:
    assert found.frame.metres_per_unit is not None
    return found.frame.metres_per_unit


def up_error(found: MeasuredFrame) -> float:
    assert found.frame.up is not None
    return degrees_between(found.frame.up, UP)


@pytest.fixture(scope="module")
def ring() -> Scene:
    return scene_of(photographs(board_of("ring-5x6-30"), POSES), POSES)


@pytest.mark.parametrize("name", ["charuco-7x9-26", "ring-5x6-30"])
def test_a_board_gives_metres_and_up(name: str):
    board = board_of(name)
    found = measured(scene_of(photographs(board, POSES), POSES), board)
    assert metres(found) == pytest.approx(1 / SCALE, rel=1e-3)
    assert up_error(found) < 0.1
    assert np.linalg.norm(found.frame.evidence["origin"] - SHIFT) < 1e-3 * SCALE
    # Standard errors are of the size of the errors.
    assert abs(metres(found) * SCALE - 1) < 5 * found.frame.evidence["scale_error"] < 2e-3
    assert f"{name}: " in found.lines[0]
    assert "in 8 photographs" in found.lines[0]


def test_single_markers_give_metres_and_no_up():
    board = board_of("single-4-40")
    found = measured(scene_of(photographs(board, POSES), POSES), board)
    assert metres(found) == pytest.approx(1 / SCALE, rel=5e-3)
    assert found.frame.up is None


def test_a_print_of_another_size_is_put_right_by_its_ruler():
    board = board_of("ring-5x6-30")
    scene = scene_of(photographs(board, POSES, size=0.97), POSES)
    assert metres(measured(scene, board)) == pytest.approx(1 / (0.97 * SCALE), rel=2e-3)
    assert metres(measured(scene, board.printed_at(97.0))) == pytest.approx(1 / SCALE, rel=2e-3)


def test_scale_bars_go_before_boards(ring: Scene):
    board = board_of("ring-5x6-30")
    centers = board.marker_centers()
    length = float(np.linalg.norm(centers[0] - centers[17])) / 1000
    by_markers = measured(ring, bars=(scale_bar([0.0, 17.0, length]),))
    assert metres(by_markers) == pytest.approx(1 / SCALE, rel=2e-3)
    assert by_markers.frame.up is None
    by_points = measured(ring, board, bars=(scale_bar([1.0, 2.0, 3.0, 1.0, 2.0, 5.0, 0.6]),))
    assert metres(by_points) == pytest.approx(0.3, rel=1e-12)
    assert up_error(by_points) < 0.1
    assert any(line.startswith("note: boards say 0.27") for line in by_points.lines)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([1.0, 2.0], "two markers' numbers, or two points"),
        ([1.0, 2.0, -3.0], "more than 0"),
        ([1.0, 2.5, 3.0], "whole numbers"),
        ([1.0, 1.0, 3.0], "both ends are the same"),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "both ends are the same"),
    ],
)
def test_a_bar_that_cannot_be_is_told(values: list[float], said: str):
    with pytest.raises(ConfigError, match=said):
        scale_bar(values)


def test_a_marker_of_a_bar_that_is_not_there_is_told(ring: Scene):
    with pytest.raises(DataError, match=r"marker 40 .* seen in 0 of 8 photographs"):
        measured(ring, bars=(scale_bar([0.0, 40.0, 1.0]),))


def test_half_a_board_is_enough():
    board = board_of("charuco-7x9-26")
    images = photographs(board, POSES)
    for image in images[::2]:
        image[:, 320:] = 90
    for image in images[1::2]:
        image[:250] = 90
    found = measured(scene_of(images, POSES), board)
    assert metres(found) == pytest.approx(1 / SCALE, rel=5e-3)
    assert up_error(found) < 0.5


def test_blur_makes_it_less_sure_but_not_wrong(ring: Scene):
    views = [
        replace(view, rgb=torch.from_numpy(cv2.GaussianBlur(view.rgb.numpy(), (0, 0), 1.2))) for view in ring.train
    ]
    found = measured(replace(ring, train=tuple(views)), board_of("ring-5x6-30"))
    assert metres(found) == pytest.approx(1 / SCALE, rel=5e-3)
    assert up_error(found) < 0.5


def test_photographs_with_another_pose_than_they_say_are_outvoted(ring: Scene):
    """Two of eight cameras are turned by two degrees."""
    wrong = np.eye(4)
    wrong[:3, :3] = cv2.Rodrigues(np.radians([0, 2.0, 0]))[0]
    views = [
        view
        if index not in (2, 5)
        else replace(
            view,
            camera=replace(view.camera, world_to_camera=torch.from_numpy(wrong) @ view.camera.world_to_camera),
        )
        for index, view in enumerate(ring.train)
    ]
    found = measured(replace(ring, train=tuple(views)), board_of("ring-5x6-30"))
    assert metres(found) == pytest.approx(1 / SCALE, rel=5e-3)
    assert up_error(found) < 0.5


def test_mirrored_prints_are_told(ring: Scene):
    mirrored = [replace(view, rgb=view.rgb.flip(1)) for view in ring.train]
    with pytest.raises(DataError, match="as in a mirror, in 8 of 8 photographs"):
        measured(replace(ring, train=tuple(mirrored)), board_of("ring-5x6-30"))


def test_another_board_than_the_one_named_is_told(ring: Scene):
    with pytest.raises(DataError, match="seen in 0 of 8 photographs"):
        measured(ring, board_of("charuco-7x9-26"))
    with pytest.raises(DataError, match="do not lie as on that board"):
        measured(ring, board_of("ring-6x5-30"))


@pytest.mark.parametrize("way", [0.03, 0.01])
def test_a_board_that_was_moved_is_told(way: float):
    """Every second photograph was taken after the board slid by 3 cm, and by 1 cm."""
    board, slid = board_of("ring-5x6-30"), np.eye(4)
    slid[0, 3] = way
    sheet = printed(board)
    images = [photograph([(sheet, slid if i % 2 else np.eye(4))], pose, seed=i) for i, pose in enumerate(POSES)]
    try:
        told = " ".join(measured(scene_of(images, POSES), board).lines)
    except DataError as error:
        told = str(error)
    assert "it was moved" in told


def test_two_prints_of_one_board_are_told():
    board, aside = board_of("charuco-5x5-20"), np.eye(4)
    aside[0, 3] = 0.12
    sheet = printed(board)
    images = [
        photograph([(sheet, np.eye(4)), (sheet, aside)], pose, seed=i, ball=False) for i, pose in enumerate(POSES)
    ]
    with pytest.raises(DataError, match=r"same markers .* are seen more than once .* charuco-5x5-20@12"):
        measured(scene_of(images, POSES), board)


def test_two_boards_that_disagree_are_told():
    """One of them was printed at 97 %, and leans."""
    flat, leaning = board_of("charuco-5x5-20"), board_of("charuco-5x5-20@20")
    place = np.eye(4)
    place[:3, :3] = cv2.Rodrigues(np.array([0.15, 0, 0]))[0]
    place[:3, 3] = (0.13, 0, 0)
    sheets = [(printed(flat), np.eye(4)), (printed(leaning, 0.97), place)]
    images = [photograph(sheets, pose, seed=i, ball=False) for i, pose in enumerate(POSES)]
    found = measured(scene_of(images, POSES), flat, leaning)
    assert up_error(found) < 0.5
    assert any("measure the rulers" in line for line in found.lines)
    assert any("tilted by 8." in line for line in found.lines)


def test_the_similarity_is_found_exactly_and_strays_are_left_out():
    board = board_of("ring-5x6-30").points()
    world = SCALE * board @ TURN.T + SHIFT
    world[5] += 0.3
    world[9] = np.nan
    fit = fit_similarity(board, world)
    assert fit is not None
    assert fit.scale == pytest.approx(SCALE, rel=1e-9)
    assert np.abs(fit.rotation - TURN).max() < 1e-9
    assert np.flatnonzero(~fit.used).tolist() == [5, 9]
    line = np.stack([np.linspace(0, 1, 9), np.zeros(9), np.zeros(9)], axis=1)
    assert fit_similarity(line, line) is None


def test_the_file_is_what_exporters_read(tmp_path: Path):
    frame = WorldFrame(metres_per_unit=0.25, up=(0.0, -1.0, 0.0), evidence={"up_from": "here"})
    path = write_frame(frame, tmp_path)
    assert json.loads(path.read_text(encoding="utf-8")) == {
        "metres_per_unit": 0.25,
        "up": [0.0, -1.0, 0.0],
        "up_from": "here",
    }
    again = read_frame(path)
    assert (again.metres_per_unit, again.up, again.evidence) == (frame.metres_per_unit, frame.up, frame.evidence)


def test_a_frame_of_other_cameras_is_refused(ring: Scene, tmp_path: Path):
    found = measured(ring, board_of("ring-5x6-30"))
    write_frame(found.frame, tmp_path)
    again = frame_of(ring, str(tmp_path))
    assert again is not None
    assert again.metres_per_unit == found.frame.metres_per_unit
    views = [
        replace(view, camera=replace(view.camera, world_to_camera=view.camera.world_to_camera * 1.1))
        for view in ring.train
    ]
    with pytest.raises(DataError, match="made for other cameras"):
        frame_of(replace(ring, train=tuple(views)), str(tmp_path))


def test_what_is_not_measured_now_stays_as_it_was(ring: Scene):
    up_alone = measure_frame(ring, [], [], "apriltag_36h11", (0.0, 0.0, 2.0), lambda share: None)
    metres_alone = measured(ring, bars=(scale_bar([0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 1.0]),))
    both = with_what_was_known(up_alone, metres_alone.frame).frame
    assert (both.metres_per_unit, both.up) == (pytest.approx(0.5), (0.0, 0.0, 1.0))
    again = with_what_was_known(metres_alone, replace(both, metres_per_unit=7.0)).frame
    assert (again.metres_per_unit, again.up) == (pytest.approx(0.5), (0.0, 0.0, 1.0))


@pytest.mark.parametrize("text", ['{"metres_per_unit": -1}', '{"up": [0, 0, 0]}', '{"up": "z"}', "{"])
def test_a_frame_that_is_none_is_told(text: str, tmp_path: Path):
    (tmp_path / FRAME_NAME).write_text(text, encoding="utf-8")
    with pytest.raises(DataError):
        read_frame(tmp_path / FRAME_NAME)


def test_the_support_is_up_where_nothing_else_says(ring: Scene):
    assert frame_of(ring, "nowhere") is None
    frame = frame_of(replace(ring, up=(0.0, 0.6, 0.8)), "nowhere")
    assert frame is not None
    assert (frame.metres_per_unit, frame.up) == (None, (0.0, 0.6, 0.8))
