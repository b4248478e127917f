"""Depths across gaps of maps that are exact elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from exact_views import DentedBall, Plane, Step, Surface, exact_maps, fan, photograph, truth_of

from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps
from sculpt_framework.multi_view_stereo.gaps import bridged
from sculpt_framework.multi_view_stereo.stereo_views import stereo_views

NEAR = 0.06


def maps_of(surface: Surface) -> DepthMaps:
    views = [photograph(surface, camera, masked=True) for camera in fan()[:2]]
    return exact_maps(surface, stereo_views(views, 32.0))


def without(maps: DepthMaps, gap: np.ndarray) -> DepthMaps:
    return replace(
        maps, depths=np.where(gap, np.float32(0), maps.depths), confidence=np.where(gap, np.float32(0), maps.confidence)
    )


def scattered(maps: DepthMaps, share: float) -> np.ndarray:
    return np.random.default_rng(3).random(maps.depths.shape) < share


def around(maps: DepthMaps, radius: float) -> np.ndarray:
    """The pixels so near to the middle of the images."""
    rows, columns = np.indices(maps.depths.shape[1:])
    middle = 0.5 * np.array(maps.depths.shape[1:])
    return np.broadcast_to(np.hypot(rows - middle[0], columns - middle[1]) < radius, maps.depths.shape)


def test_a_slanted_plane_goes_on_across_small_gaps() -> None:
    whole = maps_of(Plane(facing=(0.48, 0.0, 0.8773)))
    gap = scattered(whole, 0.5) | around(whole, 4)
    found = bridged(without(whole, gap), NEAR)
    assert (found.depths > 0).mean() > 0.99
    known = found.depths > 0
    np.testing.assert_allclose(found.depths[known], whole.depths[known], rtol=1e-5)
    np.testing.assert_allclose(found.normals[known], whole.normals[known], atol=1e-5)
    np.testing.assert_array_equal(found.depths[~gap], whole.depths[~gap])
    assert found.confidence[known].max() <= 1
    assert found.confidence[known].min() > 0.5


def test_a_ball_is_bridged_along_its_curvature() -> None:
    ball = DentedBall(dent=0.0)
    whole = maps_of(ball)
    gap = around(whole, 4)
    found = bridged(without(whole, gap), NEAR)
    assert (found.depths[gap] > 0).all()
    # Planes touch the ball from outside: at most what a tangent is off six pixels farther on.
    off = np.abs(found.depths - whole.depths)[gap]
    assert off.max() < 0.03
    assert off.mean() < 0.015


def test_the_middle_of_a_wide_gap_stays_open() -> None:
    whole = maps_of(Plane())
    found = bridged(without(whole, around(whole, 25)), NEAR)
    assert (found.depths[around(whole, 15)] == 0).all()
    assert (found.depths[around(whole, 25) & ~around(whole, 24)] > 0).all()


def test_nothing_lies_between_two_surfaces() -> None:
    step = Step(high=0.3)
    whole = maps_of(step)
    found = bridged(without(whole, scattered(whole, 0.5)), NEAR)
    truth = truth_of(step, whole.views)
    flat = np.abs(np.abs(truth.points[..., 2]) - 0.3) < 1e-6
    assert (found.depths > 0).sum() > (1.6 * 0.5 * flat.sum())
    # In the camera's frame: the points of what was found are on one of the two planes, or on the riser.
    poses, lenses = whole.views.poses.astype(float), whole.views.lenses.astype(float)
    for i in range(len(whole.views)):
        rows, columns = np.nonzero((found.depths[i] > 0) & flat[i])
        depth = found.depths[i][rows, columns]
        x = (columns + 0.5 - lenses[i, 2]) / lenses[i, 0] * depth
        y = (rows + 0.5 - lenses[i, 3]) / lenses[i, 1] * depth
        points = (np.stack([x, y, depth], axis=1) - poses[i, :, 3]) @ poses[i, :, :3]
        assert (np.abs(np.abs(points[:, 2]) - 0.3) < 0.02).mean() > 0.99


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_all_or_nothing_known_stays_as_it_is(share: float) -> None:
    whole = maps_of(DentedBall())
    maps = without(whole, scattered(whole, share))
    found = bridged(maps, NEAR)
    beside = ~maps.views.inside
    assert not found.depths[beside].any()
    if share == 1.0:
        assert not found.depths.any()
        assert not found.confidence.any()
    else:
        np.testing.assert_array_equal(found.depths[maps.depths > 0], maps.depths[maps.depths > 0])
