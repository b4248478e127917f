"""What colours of places tell, where few views see them."""

import pytest
import torch

from sculpt_framework.plan.directions import Gloss, brightening

PLACES = 60


def told(views: int, gains: list[float]) -> Gloss | None:
    """Of grey places, each view's image brighter or darker by its gain."""
    brightness = torch.linspace(0.3, 0.7, PLACES)
    colors = brightness[:, None, None] * torch.tensor(gains[:views])[None, :, None].expand(PLACES, views, 3)
    return brightening(torch.ones(PLACES, views, dtype=torch.bool), colors)


GAINS = [1.0, 1.1, 0.9, 1.1, 0.9, 1.1, 0.9, 1.1]


@pytest.mark.parametrize("views", [4, 5, 7])
def test_four_views_tell_how_uneven_light_is_but_not_what_shines(views: int) -> None:
    found = told(views, GAINS)
    assert found is not None
    assert found.strength is None
    assert found.points == PLACES
    # A tenth of brightness at the least; places at the dark end differ by less than the usual brightness would.
    assert 0.04 < found.unevenness < 0.12


def test_eight_views_tell_both() -> None:
    found = told(8, GAINS)
    assert found is not None
    assert found.strength is not None
    assert 0.04 < found.unevenness < 0.12
    even = told(8, [1.0] * 8)
    assert even is not None
    assert even.unevenness == 0.0
    assert even.strength == 0.0


def test_three_views_tell_nothing() -> None:
    assert told(3, GAINS) is None


def test_places_that_eight_views_see_count_alone_where_there_are_enough() -> None:
    colors = torch.full((2 * PLACES, 8, 3), 0.5)
    # Those that four views see differ.
    colors[PLACES:, ::2] *= 1.2
    seen = torch.ones(2 * PLACES, 8, dtype=torch.bool)
    seen[PLACES:, 4:] = False
    found = brightening(seen, colors)
    assert found is not None
    assert found.points == PLACES
    assert found.unevenness == 0.0


def test_what_is_over_exposed_does_not_tell_that_light_is_even() -> None:
    """Of a white object, half of the places are clipped in all views, and the others differ."""
    colors = torch.ones(2 * PLACES, 8, 3)
    colors[PLACES:] = 0.5 * torch.tensor(GAINS)[None, :, None]
    seen = torch.ones(2 * PLACES, 8, dtype=torch.bool)
    found = brightening(seen, colors)
    assert found is not None
    assert found.unevenness == pytest.approx(0.1, abs=0.02)
    assert brightening(seen, torch.ones_like(colors)) is None
