"""Features of a background that stands still behind a turntable, among those of the object, with known answers."""

from collections.abc import Callable

import numpy as np
import pytest

from sculpt_framework.posing.features import Features
from sculpt_framework.posing.standing import standing

WIDTH, VIEWS, OBJECT, BACKGROUND = 1000, 24, 300, 100
FOCAL = 1200.0
SHIFT = 0.04
"""Of the width, by which a hand moves the camera between photographs."""


def at_places(places: np.ndarray, numbers: np.ndarray, angles: np.ndarray, rng: np.random.Generator) -> Features:
    """Each number has a descriptor of its own, and a size; both are noisy."""
    table = np.random.default_rng(0)
    descriptors = table.normal(size=(OBJECT + BACKGROUND, 128)).clip(0)[numbers]
    descriptors += 0.05 * rng.normal(size=descriptors.shape)
    sizes = table.uniform(2, 8, OBJECT + BACKGROUND)[numbers] * rng.uniform(0.95, 1.05, len(numbers))
    return Features(
        places=(places + rng.normal(0, 0.4, places.shape)).astype(np.float32),
        sizes=sizes.astype(np.float32),
        angles=(angles + rng.normal(0, 0.05, len(angles))).astype(np.float32),
        descriptors=(60 * descriptors).clip(0, 255).astype(np.uint8),
    )


def turned(view: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, numbers and directions of what shows of points on a ball, seen from 30 degrees above."""
    points = np.random.default_rng(1).normal(size=(OBJECT, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    turn, tilt = 2 * np.pi * view / VIEWS, np.deg2rad(30)
    cos, sin = np.cos(turn), np.sin(turn)
    points = points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    toward = points @ np.array([0, -np.cos(tilt), np.sin(tilt)])
    up = points @ np.array([0, np.sin(tilt), np.cos(tilt)])
    places = WIDTH / 2 + FOCAL * np.stack([points[:, 0], -up], axis=1) / (5 - toward[:, None])
    shown = np.flatnonzero(toward > 0.2)
    # About the axis, which is the image's vertical: what is on top turns as the ball does.
    directions = np.random.default_rng(2).uniform(0, 2 * np.pi, OBJECT) + np.sin(tilt) * turn * points[:, 2]
    return places[shown], shown, directions[shown]


def behind(view: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    places = np.random.default_rng(3).uniform(0, WIDTH, (BACKGROUND, 2))
    directions = np.random.default_rng(4).uniform(0, 2 * np.pi, BACKGROUND)
    # Now and then one is not found.
    shown = np.flatnonzero(rng.uniform(size=BACKGROUND) < 0.8)
    return places[shown], OBJECT + shown, directions[shown]


def behind_from_above(view: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    places, numbers, directions = behind(view, rng)
    return places[:, ::-1], numbers, directions


def passing(view: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a walk round the object: the surroundings pass by behind it."""
    round_it = WIDTH * VIEWS / 4
    places = np.random.default_rng(3).uniform(0, (round_it, WIDTH), (BACKGROUND, 2))
    directions = np.random.default_rng(4).uniform(0, 2 * np.pi, BACKGROUND)
    places[:, 0] = (places[:, 0] + view * round_it / VIEWS) % round_it
    shown = np.flatnonzero(places[:, 0] < WIDTH)
    return places[shown], OBJECT + shown, directions[shown]


Part = Callable[[int, np.random.Generator], tuple[np.ndarray, np.ndarray, np.ndarray]]


def capture(*parts: Part, shift: float = SHIFT) -> tuple[list[Features], list[np.ndarray]]:
    """Of each view the features, and which are on the background."""
    rng = np.random.default_rng(7)
    features, background = [], []
    for view in range(VIEWS):
        places, numbers, angles = (
            np.concatenate(each) for each in zip(*(part(view, rng) for part in parts), strict=True)
        )
        features.append(at_places(places + shift * WIDTH * rng.uniform(-1, 1, 2), numbers, angles, rng))
        background.append(numbers >= OBJECT)
    return features, background


def test_a_camera_at_two_heights_is_before_two_backgrounds():
    """What is behind the object is seen from elsewhere: no shift leads from one to the other."""
    low, mine = capture(turned, behind)
    high, _ = capture(turned, behind_from_above)
    found = standing([*low, *high], WIDTH)
    assert found is not None
    for each, true in zip(found[:VIEWS], mine, strict=True):
        assert each[true].mean() > 0.95
        assert each[~true].mean() < 0.02


@pytest.mark.parametrize("shift", [0.0, SHIFT], ids=["on a tripod", "by hand"])
def test_what_moves_with_the_camera_alone_is_found_and_nothing_of_the_object(shift: float):
    features, background = capture(turned, behind, shift=shift)
    found = standing(features, WIDTH)
    assert found is not None
    for mine, true in zip(found, background, strict=True):
        assert mine[true].mean() > 0.95
        assert mine[~true].mean() < 0.02


@pytest.mark.parametrize("parts", [(turned,), (turned, passing)], ids=["a plain background", "a walk round it"])
def test_without_such_a_background_there_is_none(parts: tuple[Part, ...]):
    assert standing(capture(*parts)[0], WIDTH) is None


def test_images_without_features_have_none_of_it():
    features, _ = capture(turned, behind)
    nothing = features[0].at(np.zeros(0, np.int64))
    found = standing([nothing, *features, features[3].at(np.zeros(1, np.int64))], WIDTH)
    assert found is not None
    assert len(found[0]) == 0
    assert found[-1].tolist() == [False]
    assert standing([nothing] * VIEWS, WIDTH) is None


def test_a_camera_that_hardly_moves_is_before_no_background():
    assert standing(capture(behind)[0], WIDTH) is None


def test_a_few_views_do_not_tell():
    assert standing(capture(turned, behind)[0][:8], WIDTH) is None
