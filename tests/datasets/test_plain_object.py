"""An object of one colour on a floor that is not: what hardly any view sees through."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sculpt_framework.posed_images import find_object as find_object_module
from sculpt_framework.posed_images.find_object import FoundObject, find_object
from sculpt_framework.types import View
from tests.datasets.test_find_object import SEED, BallAlone, OnTable, overlaps, ring

WHITE = 0.9


@dataclass(frozen=True, kw_only=True)
class OnFloor(OnTable):
    """All that images show beside the ball has depths."""

    def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        way = (-self.radius - origin[1]) / np.where(rays[:, 1] == 0, 1e-12, rays[:, 1])
        return np.minimum(np.where(way > 0, way, np.inf), self.ball(origin, rays))


def white(views: list[View], truth: list[View]) -> list[View]:
    """What the masks of the truth show, in one colour."""
    painted = []
    for view, exact in zip(views, truth, strict=True):
        assert exact.alpha is not None
        painted.append(replace(view, rgb=view.rgb.masked_fill((exact.alpha > 0.5)[..., None], WHITE)))
    return painted


@pytest.fixture
def _half_the_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """These images show no more: a quarter of the time."""
    monkeypatch.setattr(find_object_module, "_CELLS", 80)


@pytest.mark.usefixtures("_half_the_cells")
def test_a_white_ball_is_found_by_the_floor_around_it():
    truth = ring(BallAlone(), masked=True)
    found = find_object(white(ring(OnFloor()), truth), [], SEED)
    assert isinstance(found, FoundObject), found
    assert "too plain for depths" in found.said
    scores = overlaps(found.train, truth)
    assert min(scores) > 0.9
    assert np.mean(scores) > 0.95
