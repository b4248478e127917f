"""A start from few views, far apart: what no two neighbours would agree on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.demo_scenes.tracing import render
from sculpt_framework.errors import DataError
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.types import View
from sculpt_plugins.initializers.volume_rendering.config import VolumeRenderingConfig

CPU = torch.device("cpu")
HALF_SIDES = torch.ones(3)
SMALL = VolumeRenderingConfig(cells=48, steps=150, rays=512)


BLOB = demo_object("blob")


@pytest.fixture(scope="module")
def views() -> list[View]:
    made = []
    for i, camera in enumerate(demo_cameras(10, 64)):
        rgb, alpha = render(BLOB, camera)
        made.append(View(name=str(i), camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(alpha)))
    return made


def starts(views: list[View], config: VolumeRenderingConfig = SMALL) -> list[SdfFunction]:
    return list(config.build().targets(views, HALF_SIDES, CPU))


def apart(start: SdfFunction) -> float:
    """Mean size of the start's distances where the true surface is."""
    points = 2 * torch.rand(200_000, 3, generator=torch.Generator().manual_seed(0)) - 1
    on = np.abs(BLOB.distance(points.numpy().T.astype(np.float64))) < 4e-3
    assert on.sum() > 500
    return float(start(points[torch.from_numpy(on)]).abs().mean())


@pytest.mark.slow
def test_ten_views_show_hollows_that_no_outline_does(views: list[View]):
    hull, *_, learned = starts(views, replace(SMALL, steps=400, rays=256))
    assert apart(learned) < 0.5 * apart(hull)


def test_nothing_of_it_leaves_the_hull_and_it_is_always_the_same(views: list[View]):
    short = replace(SMALL, steps=12)
    hull, *_, learned = starts(views, short)
    points = 2 * torch.rand(5000, 3, generator=torch.Generator().manual_seed(1)) - 1
    assert bool((learned(points) >= hull(points)).all())
    assert torch.equal(learned(points), starts(views, short)[-1](points))


def test_what_it_found_is_told(views: list[View]):
    initializer = replace(SMALL, steps=4).build()
    assert not initializer.findings
    list(initializer.targets(views, HALF_SIDES, CPU))
    assert 0 < initializer.findings["color_difference"] < 1


def test_views_without_masks_are_refused(views: list[View]):
    with pytest.raises(DataError, match="mask"):
        starts([replace(view, alpha=None) for view in views])
