"""Corners of markers whose black has shrunk in the photograph."""

import cv2
import numpy as np
import pytest

from sculpt_framework.markers.boards import board_of
from sculpt_framework.markers.detection import Sighting
from sculpt_framework.markers.shrinking import grown, shrinkage, without_shrinking

BOARD = board_of("ring-7x6-28")
PLACES = BOARD.points()[:, :2].reshape(-1, 4, 2)
LENS = np.array([[760.0, 0, 320], [0, 760, 240], [0, 0, 1]])


def _seen(lens_bend: float = 0.0) -> np.ndarray:
    """The true corners in a photograph from 40 degrees above the board."""
    flat = np.concatenate([PLACES.reshape(-1, 2), np.zeros((4 * len(PLACES), 1))], axis=1)
    turn, away = np.array([np.pi - 0.87, 0.1, 0.2]), np.array([0.0, 0.0, 0.38])
    pixels, _ = cv2.projectPoints(flat, turn, away, LENS, np.array([lens_bend, 0, 0, 0, 0]))
    return pixels.reshape(-1, 4, 2)


def _shrunk(corners: np.ndarray, by: float) -> np.ndarray:
    """Each edge moved inward, and the corners where they cross then."""
    moved = np.empty_like(corners)
    middle = corners.mean(axis=1)
    for marker, center, out in zip(corners, middle, moved, strict=True):
        lines = []
        for start, end in zip(marker, np.roll(marker, -1, axis=0), strict=True):
            normal = np.array([end[1] - start[1], start[0] - end[0]])
            normal *= np.sign(normal @ (center - start)) / np.linalg.norm(normal)
            lines.append((normal, normal @ start + by))
        for k in range(4):
            (a, at_a), (b, at_b) = lines[k - 1], lines[k]
            out[k] = np.linalg.solve(np.stack([a, b]), [at_a, at_b])
    return moved


@pytest.mark.parametrize("by", [0.4, 0.0, -0.3])
@pytest.mark.parametrize("lens_bend", [0.0, -0.07])
def test_sizes_that_do_not_fit_distances_tell_by_how_much_black_has_shrunk(by: float, lens_bend: float):
    true = _seen(lens_bend)
    found = shrinkage(PLACES, _shrunk(true, by))
    assert found == pytest.approx(by, abs=0.002 if lens_bend == 0 else 0.02)
    np.testing.assert_allclose(grown(_shrunk(true, by), by), true, atol=1e-9)


def test_markers_in_one_row_are_enough():
    assert shrinkage(PLACES[:5], _shrunk(_seen()[:5], 0.4)) == pytest.approx(0.4, abs=0.03)


def test_noise_and_a_stray_marker_change_it_little():
    noisy = _shrunk(_seen(), 0.3) + np.random.default_rng(0).normal(0, 0.1, (22, 4, 2))
    noisy[3] += 40.0
    assert shrinkage(PLACES, noisy) == pytest.approx(0.3, abs=0.06)


def test_corners_on_one_line_or_in_one_point_stay_finite():
    line = np.stack([np.linspace(0, 3, 4), np.zeros(4)], axis=1)
    for corners in (line, np.zeros((4, 2))):
        assert np.isfinite(grown(np.stack([corners] * 5), 0.3)).all()


def test_fewer_than_four_markers_tell_nothing():
    assert shrinkage(PLACES[:3], _shrunk(_seen(), 0.4)[:3]) is None


def _sightings(by: float, count: int) -> list[Sighting]:
    pixels = _shrunk(_seen(), by).reshape(-1, 2)
    return [Sighting(points=np.arange(len(pixels)), pixels=pixels, markers=22) for _ in range(count)]


def test_photographs_together_are_mended():
    for one in without_shrinking(BOARD, _sightings(0.4, 3)):
        np.testing.assert_allclose(one.pixels, _seen().reshape(-1, 2), atol=0.003)


@pytest.mark.parametrize(("by", "count"), [(0.4, 2), (2.5, 5)])
def test_two_photographs_and_shifts_beyond_a_pixel_are_left_as_they_are(by: float, count: int):
    for one, before in zip(without_shrinking(BOARD, _sightings(by, count)), _sightings(by, count), strict=True):
        np.testing.assert_array_equal(one.pixels, before.pixels)
