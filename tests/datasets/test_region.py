"""The region where the images' borders cut the masks: what bounds it then, and that it is said."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from layouts import make_shots, write_idr
from silhouettes import ball_views

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.box import fit_box
from sculpt_framework.posed_images.carving import admits, outline_of
from sculpt_framework.posed_images.clues import Clues
from sculpt_framework.posed_images.contact_sheet import thumbnail
from sculpt_framework.posed_images.findings import findings
from sculpt_framework.posed_images.projected_box import box_edges, box_outline
from sculpt_framework.posed_images.training_images import prepare_image
from sculpt_framework.types import Box, Camera, View
from sculpt_plugins.datasets.idr.config import IdrConfig

SIDE = 96
RADIUS = 0.9


def _box(low: float, high: float) -> Box:
    return Box.between([low] * 3, [high] * 3)


def _given(low: float, high: float) -> Clues:
    return Clues(points=np.zeros((0, 3)), box=_box(low, high), box_name="the ball")


@pytest.fixture(scope="module")
def cut_off() -> list[View]:
    """Close, from one side, the ball's left part beyond the border of every image: what lies at low y."""
    cameras = [
        replace(camera, fx=1.5 * camera.fx, fy=1.5 * camera.fy, cx=camera.cx - 30)
        for camera in demo_cameras(40, SIDE, placement="front")
    ]
    views = ball_views([(0, 0, 0)], [RADIUS], cameras)
    assert all(outline_of(view).touched[0] for view in views)
    return views


def test_a_box_given_bounds_what_masks_leave_open(cut_off: list[View]) -> None:
    free = fit_box(cut_off)
    found = fit_box(cut_off, _given(-1.0, 1.0))
    assert free.box.minimum[1] > -RADIUS
    assert (found.box.minimum <= -RADIUS).all()
    assert (found.box.maximum >= RADIUS).all()
    assert found.cuts
    assert "by the ball" in found.said


def test_masks_bound_the_sides_they_close(cut_off: list[View]) -> None:
    """Within a box that is much too tall: above and below the ball no view shows anything."""
    tall = Clues(
        points=np.zeros((0, 3)),
        box=Box(
            minimum=torch.tensor([-1.0, -1.0, -3.0], dtype=torch.float64),
            maximum=torch.tensor([1.0, 1.0, 3.0], dtype=torch.float64),
        ),
        box_name="the ball",
    )
    found = fit_box(cut_off, tall)
    assert -1.8 < found.box.minimum[2] < -RADIUS
    assert RADIUS < found.box.maximum[2] < 1.6
    by_masks = found.said.split(" by the ball, ")[1]
    assert "-z" in by_masks
    assert "+z" in by_masks
    assert by_masks.endswith("by masks.")


def test_masks_of_the_whole_object_win_where_they_close_it() -> None:
    views = ball_views([(0, 0, 0)], [0.5], demo_cameras(20, SIDE))
    free = fit_box(views)
    found = fit_box(views, _given(-1.0, 1.0))
    assert torch.equal(found.box.minimum, free.box.minimum)
    assert torch.equal(found.box.maximum, free.box.maximum)
    assert found.said == free.said
    assert not found.cuts


def test_a_box_given_bounds_a_hull_that_few_whole_views_leave_deep() -> None:
    """Three views from one side show the ball whole and leave its depth open; no mask reaches out of the box."""
    cameras = demo_cameras(60, SIDE, placement="front")[:3]
    views = ball_views([(0, 0, 0)], [0.5], cameras)
    free, found = fit_box(views), fit_box(views, _given(-0.6, 0.6))
    assert found.box.scale < 0.63 < free.box.scale
    assert "by the ball" in found.said


def test_a_box_given_that_whole_masks_contradict_is_not_used() -> None:
    views = ball_views([(0, 0, 0)], [RADIUS], demo_cameras(20, SIDE))
    found = fit_box(views, _given(-0.3, 0.3))
    assert torch.equal(found.box.minimum, fit_box(views).box.minimum)
    assert "the ball is not used: 20 of 20 masks of the whole object reach out of it" in found.said
    assert not found.cuts


def test_a_box_given_where_no_mask_is_is_not_used(cut_off: list[View]) -> None:
    found = fit_box(cut_off, _given(7.0, 8.0))
    assert "the ball is not used: it holds no place inside the masks" in found.said
    assert torch.equal(found.box.minimum, fit_box(cut_off).box.minimum)


def test_sparse_points_inside_the_masks_bound_what_they_leave_open(cut_off: list[View]) -> None:
    random = np.random.default_rng(0)
    ways = random.normal(size=(400, 3))
    on_ball = RADIUS * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    around = random.uniform(-6, 6, size=(4000, 3))
    around = around[np.linalg.norm(around, axis=1) > 2].astype(np.float32)
    # Of what is around the ball, a program finds what three views show beside it.
    beside = [~admits(outline_of(view), np.zeros(3), around, 0.0)[0] for view in cut_off]
    away = around[np.sum(beside, axis=0) >= 3]
    assert len(away) > 200
    found = fit_box(cut_off, Clues(points=np.concatenate([on_ball, away])))
    assert "sparse points" in found.said
    assert found.cuts
    assert (found.box.maximum >= RADIUS).all()
    assert (found.box.maximum <= 1.4 * RADIUS).all()
    assert (found.box.minimum <= -0.5 * RADIUS).all()
    assert (found.box.minimum >= -1.4 * RADIUS).all()
    # The hull of views that show the object whole needs none.
    whole = ball_views([(0, 0, 0)], [RADIUS], demo_cameras(20, SIDE))
    assert fit_box(whole, Clues(points=on_ball / 3)).said == fit_box(whole).said


def test_too_few_sparse_points_are_not_used(cut_off: list[View]) -> None:
    found = fit_box(cut_off, Clues(points=np.zeros((5, 3))))
    assert "only 5 of 5 sparse points lie inside the masks and are not used" in found.said


def test_else_the_majority_of_the_views_bounds_it(cut_off: list[View]) -> None:
    found = fit_box(cut_off)
    assert "by what half of the views show" in found.said
    assert found.cuts
    low, high = found.box.minimum.numpy(), found.box.maximum.numpy()
    assert (low <= 0).all()
    assert (high >= 0).all()
    # Well beyond its walls there is no place that half of the views show, less those that speak against it.
    random = np.random.default_rng(1)
    places = random.uniform(-4, 4, size=(4000, 3))
    outside = places[((places < low - 0.1) | (places > high + 0.1)).any(axis=1)].astype(np.float32)
    said = [admits(outline_of(view), np.zeros(3), outside, 0.0) for view in cut_off]
    kept = np.all([admitted for admitted, _ in said], axis=0)
    votes = np.sum([vote for _, vote in said], axis=0, dtype=int)
    assert kept.any()
    assert votes[kept].max() < 0.5 * len(cut_off)


def test_a_mask_speaks_against_what_is_beyond_borders_it_does_not_touch() -> None:
    pose = torch.eye(4, dtype=torch.float64)
    camera = Camera(world_to_camera=pose, fx=100.0, fy=100.0, cx=50.0, cy=50.0, width=100, height=100)
    alpha = torch.zeros(100, 100)
    alpha[40:60, :60] = 1
    outline = outline_of(View(name="v", camera=camera, rgb=torch.zeros(100, 100, 3), alpha=alpha))
    assert outline.touched.tolist() == [True, False, False, False]
    # In the mask; beside it; beyond the left, right and lower borders, beyond two at once, behind the camera.
    places = np.array([(0, 0, 1), (0.3, 0, 1), (-1, 0, 1), (1, 0, 1), (0, 1, 1), (-1, 1, 1), (0, 0, -1)], np.float32)
    admitted, vote = admits(outline, np.zeros(3), places, 0.0)
    assert admitted.tolist() == [True, False, True, True, True, True, True]
    assert vote.tolist() == [1, 0, 0, -1, -1, 0, 0]


def test_what_lies_beyond_the_region_is_background(tmp_path: Path) -> None:
    """A box given cuts the ball: no mask asks for surface where there can be none, and findings blame no mask."""
    folder = write_idr(tmp_path / "s", make_shots(12))
    whole = IdrConfig().build(str(folder)).load()
    box = (-0.9, -0.9, -0.9, 0.9, 0.9, 0.1)
    scene = IdrConfig(box=box).build(str(folder)).load()
    assert scene.notes[-1] == "box as given."
    left = []
    for before, after in zip(whole.train, scene.train, strict=True):
        assert before.alpha is not None
        assert after.alpha is not None
        outline = torch.from_numpy(box_outline(after.camera, scene.box))
        assert torch.equal(after.alpha, before.alpha * outline)
        left += [float(after.alpha.sum() / before.alpha.sum())]
    assert min(left) < 0.7
    assert not any("reach out of the box" in line for line in findings(scene))


def test_a_box_that_no_image_shows_is_refused(tmp_path: Path) -> None:
    folder = write_idr(tmp_path / "s", make_shots(6))
    with pytest.raises(DataError, match=r"no train image shows any of the object inside the box"):
        IdrConfig(box=(0.0, 0.0, 20.0, 1.0, 1.0, 21.0)).build(str(folder)).load()


def test_training_images_end_where_the_photograph_does(cut_off: list[View]) -> None:
    """A mask that the border cuts has no margin there, so that surface beyond the image meets no pixel."""
    cut = 0
    for view in cut_off:
        assert view.alpha is not None
        image = prepare_image(view, _box(-1.0, 1.0), 1.0, torch.device("cpu"))
        assert image.alpha is not None
        assert image.alpha.sum() == view.alpha.sum()
        for side in (0, -1):
            if view.alpha[:, side].any():
                cut += 1
                assert image.alpha[:, side].any()
    assert cut > len(cut_off) / 2


def test_the_boxs_edges_are_drawn_into_the_photographs() -> None:
    camera = demo_cameras(8, 144)[0]
    view = View(name="v", camera=camera, rgb=torch.full((144, 144, 3), 0.5), alpha=None)
    box = _box(-0.6, 0.6)
    drawn = thumbnail(view, box)[3:147, 3:147].astype(int)
    pose = camera.world_to_camera.numpy()
    # The middle of an edge, by hand.
    x, y, z = pose[:3, :3] @ np.array([0.6, 0.6, 0.0]) + pose[:3, 3]
    column, row = int(camera.fx * x / z + camera.cx), int(camera.fy * y / z + camera.cy)
    around = drawn[row - 1 : row + 2, column - 1 : column + 2]
    assert (np.abs(around - (0, 190, 60)).max(axis=2) == 0).any()
    assert (drawn[:4, :4] == 128).all()


def test_edges_that_reach_behind_the_camera_end_before_it() -> None:
    pose = torch.eye(4, dtype=torch.float64)
    camera = Camera(world_to_camera=pose, fx=50.0, fy=50.0, cx=50.0, cy=50.0, width=100, height=100)
    ahead = Box(
        minimum=torch.tensor([-1.0, -1.0, 2.0], dtype=torch.float64),
        maximum=torch.tensor([1.0, 1.0, 4.0], dtype=torch.float64),
    )
    assert len(box_edges(camera, ahead)) == 12
    assert box_edges(camera, ahead).min() == 25
    # Four edges lie behind, four are cut, four are ahead.
    around = box_edges(camera, _box(-1.0, 1.0))
    assert len(around) == 8
    assert np.isfinite(around).all()
    behind = replace(ahead, minimum=ahead.minimum - 8, maximum=ahead.maximum - 8)
    assert len(box_edges(camera, behind)) == 0
    assert cv2.clipLine((0, 0, 100, 100), (25, 25), (75, 25))[0]
