"""Boxes that a user gives."""

import torch

from sculpt_framework.sculpting.boxes import object_box
from sculpt_framework.types import Box


def test_a_box_keeps_its_digits_far_from_the_origin():
    """UTM coordinates: a fifth of a metre is less than what 32 bits tell apart there."""
    scene_box = Box.between((499_998.0, 4_499_998.0, 98.0), (500_002.0, 4_500_002.0, 102.0))
    low, high = (500_000.0, 4_499_999.02, 100.0), (500_000.2, 4_499_999.22, 100.2)
    box = object_box("--refine-box", low, high, scene_box)
    torch.testing.assert_close(box.minimum, torch.tensor([0.0, -0.49, 0.0], dtype=torch.float64))
    torch.testing.assert_close(box.maximum, torch.tensor([0.1, -0.39, 0.1], dtype=torch.float64))
