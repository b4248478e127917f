"""When the photographs of a board tell the lens, and when they do not: corners by a known camera, with noise."""

import math

import cv2
import numpy as np
import pytest

from sculpt_framework.markers.boards import board_of
from sculpt_framework.markers.calibration import BoardLens, calibrate
from sculpt_framework.markers.detection import Sighting

CHARUCO, RING = board_of("charuco-11x9-20").points(), board_of("ring-5x6-30").points()
ROW = np.arange(10)
"""Of the corners of the first."""
WIDTH, HEIGHT, FOCAL = 1600, 1200, 1200.0


def seen(
    board: np.ndarray, count: int, tilt: float, *, points: np.ndarray | None = None, noise: float = 0.1, seed: int = 0
) -> list[Sighting]:
    """By cameras above the board whose axes are so many degrees off its normal, to all sides."""
    generator, found = np.random.default_rng(seed), []
    rows = np.arange(len(board)) if points is None else points
    for turn in np.arange(count) * (2 * math.pi / count):
        leaning = cv2.Rodrigues(math.radians(tilt) * np.array([math.cos(turn), math.sin(turn), 0]))[0]
        spin = cv2.Rodrigues(np.array([0, 0, generator.uniform(-3, 3)]))[0]
        away = (*generator.uniform(-0.02, 0.02, 2), 0.5 * generator.uniform(0.9, 1.1))
        places = board[rows] @ (leaning @ np.diag([1.0, -1.0, -1.0]) @ spin).T + away
        pixels = FOCAL * places[:, :2] / places[:, 2:] + (WIDTH / 2, HEIGHT / 2)
        found.append(Sighting(points=rows, pixels=pixels + generator.normal(0, noise, pixels.shape), markers=9))
    return found


@pytest.mark.parametrize("guess", [None, FOCAL])
@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.0])
def test_from_straight_above_the_focal_length_is_not_known(tilt: float, noise: float, guess: float | None):
    """OpenCV gives it a standard error of nearly 0 there, as it drops what singular equations do not tell."""
    for seed in range(2):
        lens = calibrate(RING, seen(RING, 8, tilt, noise=noise, seed=seed), WIDTH, HEIGHT, guess)
        assert isinstance(lens, str)
        assert "the board does not tell the focal length: it is seen from straight above" in lens


@pytest.mark.parametrize("noise", [1e-3, 0.1])
@pytest.mark.parametrize("tilt", [5.0, 30.0])
def test_from_the_side_it_is(tilt: float, noise: float):
    lens = calibrate(RING, seen(RING, 8, tilt, noise=noise), WIDTH, HEIGHT, None)
    assert isinstance(lens, BoardLens)
    assert lens.focal == pytest.approx(FOCAL, rel=0.01)


def test_photographs_of_a_single_row_of_corners_are_left_out():
    """Poses come of them by noise alone: they spoil the lens, or make OpenCV give up."""
    good, row = seen(CHARUCO, 6, 30), seen(CHARUCO, 6, 30, points=ROW, noise=1.0, seed=9)
    expected = calibrate(CHARUCO, good, WIDTH, HEIGHT, None)
    lens = calibrate(CHARUCO, good + row[:3], WIDTH, HEIGHT, None)
    assert isinstance(expected, BoardLens)
    assert isinstance(lens, BoardLens)
    assert lens.focal == pytest.approx(expected.focal, rel=1e-6)
    assert calibrate(CHARUCO, good[:2] + row, WIDTH, HEIGHT, None) == (
        "2 photographs show 8 points of the board or more that are not all on one line, 3 are needed"
    )


def test_a_photograph_of_which_a_row_is_left_without_strays_is_left_out():
    """Three corners of the second row that are somewhere else."""
    good, spoiled = seen(CHARUCO, 6, 30), seen(CHARUCO, 1, 30, points=np.r_[ROW, 15:18], seed=9)[0]
    spoiled.pixels[10:] += np.outer([1, -1, 1], [-30, 60])
    expected = calibrate(CHARUCO, good, WIDTH, HEIGHT, None)
    lens = calibrate(CHARUCO, [*good, spoiled], WIDTH, HEIGHT, None)
    assert isinstance(expected, BoardLens)
    assert isinstance(lens, BoardLens)
    assert "calibrated on 6 photographs" in lens.said
    assert lens.focal == pytest.approx(expected.focal, rel=2e-3)


@pytest.mark.parametrize(("failures", "found"), [({1, 3, 4}, True), ({1, 2, 3}, False), ({4, 5, 6, 7, 8}, False)])
def test_where_opencv_gives_up_another_start_or_lens_is_taken(
    failures: set[int], found: bool, monkeypatch: pytest.MonkeyPatch
):
    """Three starts come first, then lenses with more and more parameters."""
    whole, calls = cv2.calibrateCameraExtended, []

    def failing(*arguments, **options):
        calls.append(options)
        if len(calls) in failures:
            raise cv2.error("Focal length (fx and fy) must be positive")
        return whole(*arguments, **options)

    monkeypatch.setattr(cv2, "calibrateCameraExtended", failing)
    lens = calibrate(RING, seen(RING, 6, 30), WIDTH, HEIGHT, None)
    if found:
        assert isinstance(lens, BoardLens)
        assert lens.focal == pytest.approx(FOCAL, rel=0.01)
    else:
        assert isinstance(lens, str)
        assert "the board does not tell the focal length" in lens
