"""The box holds the object, closely, wherever the cameras stand."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from silhouettes import ball_views

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.box import fit_box
from sculpt_framework.types import Camera

SIDE = 96


def _moved(camera: Camera, by: Sequence[float]) -> Camera:
    pose = camera.world_to_camera.clone()
    pose[:3, 3] -= pose[:3, :3] @ torch.tensor(by, dtype=torch.float64)
    return replace(camera, world_to_camera=pose)


@pytest.mark.parametrize("views", [8, 40])
def test_box_is_tight(views: int) -> None:
    centers, radii = [(0.3, 0.0, -0.1), (-0.4, 0.2, 0.3)], [0.4, 0.2]
    found = fit_box(ball_views(centers, radii, demo_cameras(views, SIDE)))
    box, note = found.box, found.said
    low = torch.tensor([-0.6, -0.4, -0.5], dtype=torch.float64)
    high = torch.tensor([0.7, 0.4, 0.5], dtype=torch.float64)
    assert (box.minimum <= low).all()
    assert (box.maximum >= high).all()
    # Eight silhouettes leave more of the hull standing than forty.
    slack = 0.35 if views == 8 else 0.12
    assert (box.minimum >= low - slack).all()
    assert (box.maximum <= high + slack).all()
    assert f"{views} masks of {views} views" in note


def test_thin_parts_are_not_lost() -> None:
    """A speck of two pixels far from the body is inside the box."""
    box = fit_box(ball_views([(0, 0, 0), (0.9, 0, 0)], [0.2, 0.03], demo_cameras(20, SIDE))).box
    assert box.maximum[0] >= 0.93


def test_object_far_from_where_the_cameras_look() -> None:
    """The middle of the masks counts, not the middle of the images."""
    box = fit_box(ball_views([(0.7, 0.5, 0.4)], [0.2], demo_cameras(12, SIDE))).box
    torch.testing.assert_close(box.center, torch.tensor([0.7, 0.5, 0.4], dtype=torch.float64), rtol=0, atol=0.04)
    assert box.scale < 0.3


def test_world_units_and_origin_do_not_matter() -> None:
    away = (1e5, -3e4, 2e4)
    cameras = [_moved(camera, away) for camera in demo_cameras(12, SIDE)]
    box = fit_box(ball_views([away], [0.5], cameras)).box
    torch.testing.assert_close(box.center, torch.tensor(away, dtype=torch.float64), rtol=0, atol=0.03)
    assert 0.5 < box.scale < 0.6


def test_masks_cut_by_the_border_carve_nothing_outside() -> None:
    """Close-ups that show a part each, beside views that show all."""
    cameras = demo_cameras(24, SIDE)
    close = [
        replace(camera, fx=3 * camera.fx, fy=3 * camera.fy) if n % 2 else camera for n, camera in enumerate(cameras)
    ]
    box = fit_box(ball_views([(0, 0, 0)], [0.9], close)).box
    assert (box.minimum <= -0.9).all()
    assert (box.maximum >= 0.9).all()
    assert box.scale < 1.1


def test_only_close_ups() -> None:
    cameras = [replace(camera, fx=3 * camera.fx, fy=3 * camera.fy) for camera in demo_cameras(24, SIDE)]
    box = fit_box(ball_views([(0, 0, 0)], [0.9], cameras)).box
    assert 0.3 < box.scale < 4


def test_few_wrong_masks_are_outvoted() -> None:
    views = ball_views([(0, 0, 0)], [0.5], demo_cameras(20, SIDE))
    wrong = torch.zeros(SIDE, SIDE)
    wrong[2:6, 2:6] = 1
    views[3] = replace(views[3], alpha=wrong)
    found = fit_box(views)
    box, note = found.box, found.said
    assert "may contradict the others" in note
    assert (box.maximum >= 0.5).all()
    assert box.scale < 0.7


def test_contradicting_masks_are_refused() -> None:
    left = ball_views([(0.8, 0, 0)], [0.1], demo_cameras(10, SIDE))
    right = ball_views([(-0.8, 0, 0)], [0.1], demo_cameras(10, SIDE))
    with pytest.raises(DataError, match=r"masks of all views: poses and images do not fit together"):
        fit_box([*left[:5], *right[5:]])


def test_views_without_alpha_give_the_intersection_of_frusta() -> None:
    views = [replace(view, alpha=None) for view in ball_views([(0, 0, 0)], [0.5], demo_cameras(30, SIDE))]
    found = fit_box(views)
    box, note = found.box, found.said
    assert "frusta of 30 views" in note
    assert (box.minimum <= -1.0).all()
    assert (box.maximum >= 1.0).all()
    assert box.scale < 2.2


def test_two_opposite_views() -> None:
    """Their axes are parallel: no point is nearest, the distance is a guess, and the note says so."""
    camera = demo_cameras(1, SIDE)[0]
    turned = camera.world_to_camera.clone()
    turned[:3, :3] = torch.diag(torch.tensor([-1.0, 1, -1], dtype=torch.float64)) @ turned[:3, :3]
    found = fit_box(ball_views([(0, 0, 0)], [0.5], [camera, replace(camera, world_to_camera=turned)]))
    box, note = found.box, found.said
    assert "around the distance" in note
    assert (box.maximum >= 0.45).all()
    assert box.scale < 1
