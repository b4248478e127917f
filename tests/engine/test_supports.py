"""Runs on objects of which it is known what they stand on."""

from dataclasses import replace

import pytest
import torch
from small_runs import finished, small_config

from sculpt_framework.engine.session import Session
from sculpt_framework.sculpting.supports import before_supports
from sculpt_framework.types import Box, Scene, Support


def test_of_a_shape_is_left_what_lies_before_all_planes():
    """Planes are in world frame, the shape in that of a box elsewhere."""
    box = Box.between([2.0, 4.0, 6.0], [6.0, 6.0, 8.0])
    floor, wall = Support(normal=(0.0, 0.0, 1.0), offset=6.5), Support(normal=(-0.6, 0.8, 0.0), offset=1.2)
    world = box.center + 2 * torch.randn(500, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    points = box.to_object(world)
    shape = before_supports(lambda at: at.norm(dim=1) - 0.8, (floor, wall), box)
    behind = torch.maximum(6.5 - world[:, 2], 1.2 - world @ torch.tensor(wall.normal, dtype=torch.float64)) / box.scale
    expected = torch.maximum(points.norm(dim=1) - 0.8, behind)
    torch.testing.assert_close(shape(points), expected)
    torch.testing.assert_close(shape(points.float()), expected.float(), atol=1e-5, rtol=0)
    torch.autograd.gradcheck(shape, points[:50].requires_grad_())


@pytest.mark.parametrize("known", [False, True])
def test_a_run_stays_before_what_the_object_stands_on(scene: Scene, known: bool):
    low, high = (float(corner[2]) for corner in (scene.box.minimum, scene.box.maximum))
    floor = low + 0.3 * (high - low)
    supports = (Support(normal=(0.0, 0.0, 1.0), offset=floor),) if known else ()
    session = Session(replace(scene, supports=supports), small_config(steps=8, polish_steps=0))
    lowest = float(finished(session).vertices[:, 2].min())
    assert (lowest > floor - 0.01 * (high - low)) is known
