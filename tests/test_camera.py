"""Where a camera sees points."""

import numpy as np
import torch

from sculpt_framework.types import Camera

POSE = torch.tensor([[0.0, -1, 0, 0.5], [1, 0, 0, -0.25], [0, 0, 1, 3], [0, 0, 0, 1]])
CAMERA = Camera(world_to_camera=POSE, fx=50.0, fy=40.0, cx=16.0, cy=12.0, width=32, height=24)


def test_points_are_where_the_pinhole_puts_them():
    points = np.array([[0.25, 0.5, -3.0 + 2.0], [0.35, 0.3, -1.0]])
    # In the camera frame (x, y, z) = (0.5 - y, x - 0.25, z + 3).
    np.testing.assert_allclose(CAMERA.local(points), [[0, 0, 2], [0.2, 0.1, 2]], atol=1e-7)
    np.testing.assert_allclose(CAMERA.project(points), [[16, 12], [16 + 50 * 0.1, 12 + 40 * 0.05]], atol=1e-5)


def test_what_is_not_in_front_has_no_place():
    points = np.array([[0.25, 0.5, -3.0], [0.25, 0.5, -4.0], [0.25, 0.5, -2.0]])
    places = CAMERA.project(points)
    assert np.isnan(places).all(axis=1).tolist() == [True, True, False]
    assert CAMERA.shows(places).tolist() == [False, False, True]


def test_the_border_belongs_to_the_image():
    pixels = np.array([[0.0, 0.0], [32.0, 24.0], [32.01, 5.0], [5.0, -0.01]])
    assert CAMERA.shows(pixels).tolist() == [True, True, False, False]


def test_a_crop_and_a_smaller_image_see_the_same_points():
    points = np.random.default_rng(0).normal(size=(20, 3)) * 0.3
    whole = CAMERA.project(points)
    np.testing.assert_allclose(CAMERA.crop(3, 5, 10, 9).project(points), whole - (3, 5), atol=1e-9)
    np.testing.assert_allclose(CAMERA.resized(64, 12).project(points), whole * (2, 0.5), atol=1e-9)
