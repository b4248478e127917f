"""Masks from a surface."""

import numpy as np
import torch
import trimesh

from sculpt_framework.export.outlines import covered_by
from sculpt_framework.types import View
from tests.multi_view_stereo.exact_views import camera_at


def _ball() -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    return np.array(ball.vertices), np.array(ball.faces, np.int64)


def test_a_pixel_has_the_share_that_is_covered():
    camera = camera_at((0.3, 0.2, 1.0), 64)
    view = View(name="a", camera=camera, rgb=torch.zeros(64, 64, 3), alpha=None)
    alpha = covered_by(*_ball(), [view])[0].alpha
    assert alpha is not None
    # The outline of a ball is seen at the sine of its angle: an area of a circle in pixels.
    distance = float(camera.position.norm())
    radius = camera.fx * 0.5 / np.sqrt(distance**2 - 0.25)
    assert abs(float(alpha.sum()) / (np.pi * radius**2) - 1) < 0.01
    assert ((alpha > 0) & (alpha < 1)).any()


def test_masks_there_are_replaced():
    camera = camera_at((0.0, 0.0, 1.0), 32)
    view = View(name="a", camera=camera, rgb=torch.zeros(32, 32, 3), alpha=torch.ones(32, 32))
    alpha = covered_by(*_ball(), [view])[0].alpha
    assert alpha is not None
    assert float(alpha[0, 0]) == 0
    assert float(alpha[16, 16]) == 1
