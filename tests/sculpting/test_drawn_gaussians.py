"""Gaussians of a finished run on the device they are drawn on."""

from dataclasses import fields

import torch

from sculpt_framework.types import Gaussians


def test_all_of_them_goes_to_the_device():
    """Where nothing can be drawn, but what is left behind would be seen."""
    gaussians = Gaussians(
        means=torch.zeros(2, 3), scales=torch.ones(2, 3), rotations=torch.eye(3).repeat(2, 1, 1),
        opacities=torch.ones(2), sh=torch.zeros(2, 1, 3), face=torch.zeros(2, dtype=torch.int64),
    )  # fmt: skip
    moved = gaussians.to(torch.device("meta"))
    assert {getattr(moved, field.name).device.type for field in fields(moved)} == {"meta"}
    assert len(moved) == 2
