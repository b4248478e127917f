"""Depth maps of surfaces that are known exactly."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from exact_views import (
    DentedBall,
    Plane,
    Step,
    ball,
    box,
    camera_at,
    exact_maps,
    fan,
    off_by,
    photograph,
    truth_of,
    waves,
)

from sculpt_framework.cpu_kernels import share_threads
from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps, StereoOptions, depth_bounds, find_depths
from sculpt_framework.multi_view_stereo.fusion import fuse
from sculpt_framework.multi_view_stereo.stereo_views import away_from_outline, stereo_views
from sculpt_framework.types import View

OPTIONS = StereoOptions(pixels=64, neighbours=6, agreeing=2)
SLANTED = Plane(facing=(0.36, -0.24, (1 - 0.36**2 - 0.24**2) ** 0.5))


@pytest.fixture(scope="module")
def slanted() -> list[View]:
    return [photograph(SLANTED, camera) for camera in fan()]


@pytest.fixture(scope="module")
def of_slanted(slanted: list[View]) -> DepthMaps:
    return find_depths(slanted, box(), OPTIONS)


def in_middle(maps: DepthMaps) -> np.ndarray:
    """Pixels that all views show, whatever the slant."""
    points = truth_of(SLANTED, maps.views).points
    return (np.abs(points).max(axis=-1) < 0.7) & maps.views.inside


def test_a_slanted_plane_is_found_to_a_fraction_of_a_pixel(of_slanted: DepthMaps) -> None:
    middle = in_middle(of_slanted)
    known = of_slanted.depths > 0
    assert (known & middle).sum() > 0.8 * middle.sum()
    truth = truth_of(SLANTED, of_slanted.views)
    off = off_by(of_slanted, truth)
    assert np.median(off) < 0.1
    assert np.mean(off < 0.5) > 0.97
    cosine = (of_slanted.normals * truth.normals).sum(axis=-1)[known]
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 8
    assert np.linalg.norm(of_slanted.normals[known], axis=1) == pytest.approx(np.ones(known.sum()), abs=1e-4)
    assert np.median(of_slanted.confidence[known & middle]) > 0.8


def test_what_stands_behind_the_solid_part_has_depths_on_demand() -> None:
    """A wall as far behind as the cameras are in front, of waves three times as long."""

    @dataclass(frozen=True, kw_only=True)
    class Wall(Plane):
        def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
            return (-4 - origin[2]) / rays[:, 2]

    cameras = [camera.resized(128, 128) for camera in fan()]
    views = [photograph(Wall(), camera, lambda points: waves(points / 3)) for camera in cameras]
    before = find_depths(views, ball(0.6), OPTIONS)
    maps = find_depths(views, ball(0.6), replace(OPTIONS, beyond=True))
    assert before.known < 0.05 * maps.known
    known = maps.depths > 0
    assert known.sum() > 0.5 * (depth_bounds(maps.views, ball(0.6).values < 0, ball(0.6))[0] > 0).sum()
    true = truth_of(Wall(), maps.views).depths[known]
    assert np.median(np.abs(maps.depths[known] / true - 1)) < 0.03


def test_what_is_unknown_has_no_confidence(of_slanted: DepthMaps) -> None:
    assert np.array_equal(of_slanted.confidence > 0, of_slanted.depths > 0)
    assert of_slanted.confidence.max() <= 1
    assert of_slanted.known == (of_slanted.depths > 0).sum() / of_slanted.views.inside.sum()


def test_progress_ends_at_one(slanted: list[View]) -> None:
    heard: list[float] = []
    find_depths(slanted[:3], box(), replace(OPTIONS, pixels=16), heard.append)
    assert heard[-1] == pytest.approx(1)
    assert max(heard) <= 1


def test_no_ramp_across_a_step() -> None:
    """A window over the edge is of one of the planes or of the other."""
    step = Step(high=0.25)
    maps = find_depths([photograph(step, camera) for camera in fan()], box(), OPTIONS)
    known = maps.depths > 0
    height = points_of(maps)[..., 2][known]
    away = np.minimum(np.abs(height - 0.25), np.abs(height + 0.25))
    assert known.sum() > 0.6 * maps.views.inside.sum()
    assert np.mean(away < 0.08) > 0.93
    near = truth_of(step, maps.views).points[known]
    beside = (np.abs(near[:, 0]) < 0.2) & (np.abs(near[:, 2]) > 0.24)
    assert beside.sum() > 500
    assert np.mean(away[beside] < 0.12) > 0.85


def points_of(maps: DepthMaps) -> np.ndarray:
    """Where the depths lie in the world."""
    views = maps.views
    rows, columns = np.indices(views.luminance.shape[1:]) + 0.5
    points = np.zeros((*maps.depths.shape, 3))
    for i in range(len(views)):
        lens = views.lenses[i].astype(float)
        local = np.stack([(columns - lens[2]) / lens[0], (rows - lens[3]) / lens[1], np.ones(rows.shape)], axis=-1)
        points[i] = maps.depths[i][..., None] * local @ views.poses[i, :, :3] + views.positions[i]
    return points


def test_of_a_repeated_pattern_only_what_is_right_is_kept() -> None:
    """Stripes five pixels apart, which look alike at several depths in each pair of views."""

    def stripes(points: np.ndarray) -> np.ndarray:
        return 0.5 + 0.4 * np.sin(2 * np.pi * points[:, 0] / (5 / 32))

    maps = find_depths([photograph(Plane(), camera, stripes) for camera in fan()], box(), OPTIONS)
    off = off_by(maps, truth_of(Plane(), maps.views))
    wrong = (off > 1).sum()
    assert wrong < 0.05 * maps.views.inside.sum()


@pytest.mark.parametrize("value", [0.5, 1.0], ids=["plain", "saturated"])
def test_nothing_is_known_where_images_say_nothing(value: float) -> None:
    def patched(points: np.ndarray) -> np.ndarray:
        return np.where(np.abs(points[:, :2]).max(axis=1) < 0.4, value, waves(points))

    maps = find_depths([photograph(Plane(), camera, patched) for camera in fan()], box(), OPTIONS)
    across = np.abs(truth_of(Plane(), maps.views).points[..., :2]).max(axis=-1)
    # Half a window, and the pixel that the border crosses.
    inner, outer = across < 0.4 - 3.5 / 32, (across > 0.55) & (across < 0.7)
    assert inner.sum() > 2000
    assert (maps.depths[inner] == 0).all()
    assert (maps.depths[outer] > 0).mean() > 0.7


def test_one_clipped_channel_does_not_hide_what_the_others_show(slanted: list[View]) -> None:
    """As red does of sand in the sun."""
    clipped = []
    for view in slanted:
        rgb = view.rgb.clone()
        rgb[..., 0] = 1.0
        clipped.append(replace(view, rgb=rgb))
    maps = find_depths(clipped, box(), OPTIONS)
    middle = in_middle(maps)
    assert ((maps.depths > 0) & middle).sum() > 0.8 * middle.sum()
    assert np.median(off_by(maps, truth_of(SLANTED, maps.views))) < 0.1


def test_two_views_say_something_only_if_one_other_is_enough(slanted: list[View]) -> None:
    pair = slanted[4:6]
    assert find_depths(pair, box(), OPTIONS).known == 0
    maps = find_depths(pair, box(), replace(OPTIONS, agreeing=1))
    assert maps.known > 0.4
    assert np.median(off_by(maps, truth_of(SLANTED, maps.views))) < 0.3


def test_views_too_far_apart_say_nothing(slanted: list[View]) -> None:
    apart = [photograph(SLANTED, camera_at((x, 0.0, 1.0), 64)) for x in (-1.0, 0.2, 2.0)]
    assert find_depths(apart, box(), replace(OPTIONS, agreeing=1)).known == 0


def test_a_view_with_a_wrong_pose_is_not_believed(slanted: list[View]) -> None:
    pose = slanted[4].camera.world_to_camera.clone()
    pose[:3, 3] += torch.tensor([0.3, 0.2, 0.0], dtype=pose.dtype)
    wrong = replace(slanted[4], camera=replace(slanted[4].camera, world_to_camera=pose))
    maps = find_depths([*slanted[:4], wrong, *slanted[5:]], box(), OPTIONS)
    truth = truth_of(SLANTED, maps.views)
    share = (maps.depths > 0).mean(axis=(1, 2))
    assert share[4] < 0.1
    assert np.delete(share, 4).mean() > 0.4
    kept = np.delete(np.arange(len(maps.views)), 4)
    off = np.abs(maps.depths - truth.depths)[kept][maps.depths[kept] > 0]
    assert np.mean(off < 0.05) > 0.95


def test_gain_and_offset_of_an_image_change_next_to_nothing(slanted: list[View], of_slanted: DepthMaps) -> None:
    darker = replace(slanted[4], rgb=0.75 * slanted[4].rgb + 0.1)
    maps = find_depths([*slanted[:4], darker, *slanted[5:]], box(), OPTIONS)
    assert maps.known == pytest.approx(of_slanted.known, abs=0.03)
    both = (maps.depths > 0) & (of_slanted.depths > 0)
    assert np.mean(np.abs(maps.depths - of_slanted.depths)[both] < 0.03) > 0.95


def test_the_same_bits_with_any_number_of_threads(slanted: list[View]) -> None:
    before = torch.get_num_threads()
    found, shapes = [], []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            share_threads()
            found.append(find_depths(slanted, box(), replace(OPTIONS, pixels=32)))
            shapes.append(fuse(box(cells=24), found[-1]))
    finally:
        torch.set_num_threads(before)
        share_threads()
    assert found[0].known > 0.3
    for one, two in zip(*([m.depths, m.normals, m.confidence] for m in found), strict=True):
        assert np.array_equal(one, two)
    assert np.array_equal(shapes[0].values, shapes[1].values)


def test_images_of_different_sizes_are_stacked_and_empty_masks_left_out() -> None:
    cameras = fan()
    dented = DentedBall()
    large = photograph(dented, cameras[0], masked=True)
    small = photograph(dented, cameras[1].resized(32, 32), masked=True)
    bare = photograph(Plane(), cameras[2].resized(48, 48))
    empty = replace(large, alpha=torch.zeros(64, 64))
    stack = stereo_views([large, empty, small, bare], 1000.0)
    assert len(stack) == 3
    assert stack.inside[1].sum() == pytest.approx(stack.inside[0].sum() / 4, rel=0.05)
    # Without a mask all of the image shows the object.
    assert stack.inside[2].sum() == 48 * 48
    assert stack.relative(0, np.array([0])) == pytest.approx(np.eye(4)[None, :3], abs=1e-6)
    # Cut and stacked pixels still lie where the cameras say.
    truth = truth_of(dented, stack)
    hits = truth.depths > 0
    off = np.abs(stack.luminance[hits] - waves(truth.points[hits]))
    assert np.median(off[: hits[0].sum()]) < 0.02


def test_images_are_reduced_but_never_enlarged(slanted: list[View]) -> None:
    assert stereo_views(slanted[:1], 16.0).luminance.shape == (1, 32, 32)
    assert stereo_views(slanted[:1], 160.0).luminance.shape == (1, 64, 64)


def test_without_any_view_nothing_is_known() -> None:
    assert find_depths([], box(), OPTIONS).known == 0


def test_neighbours_stand_at_a_useful_angle() -> None:
    def fan_of(degrees: Sequence[float]) -> list[View]:
        turns = np.radians(degrees)
        return [photograph(Plane(), camera_at((np.sin(t), 0.0, np.cos(t)), 8)) for t in turns]

    (first, *_) = stereo_views(fan_of([0, 1, 5, 13, 30, 60]), 4.0).neighbours(5)
    assert first[0] == 3
    # Nearer than two degrees nothing moves; beyond 45 nothing looks the same.
    assert sorted(first) == [2, 3, 4]
    assert len(stereo_views(fan_of([0, 8, 12, 16]), 4.0).neighbours(2)[0]) == 2


def test_bounds_enclose_what_is_solid() -> None:
    solid = ball(0.8, cells=32)
    surface = DentedBall(dent=0.0)
    stack = stereo_views([photograph(surface, camera, masked=True) for camera in fan()[:2]], 32.0)
    nearest, farthest = depth_bounds(stack, solid.values < solid.cell, solid)
    exact = exact_maps(surface, stack).depths
    hits = exact > 0
    assert (nearest[hits] <= exact[hits]).all()
    assert (farthest[hits] > exact[hits]).all()
    # Not by more than the cells' corners and the cell that is added, where the ray does not graze.
    middle = np.abs(exact_maps(surface, stack).normals[..., 2]) > 0.5
    assert (exact - nearest)[hits & middle].max() < 4.5 * solid.cell
    assert (farthest[~stack.inside] == 0).all()


def test_what_mixes_in_along_the_outline_of_a_plain_object_gives_no_depth() -> None:
    """A ball of one colour, blurred with a dark room by the lens, as far as its mask reaches and beyond."""
    plain = DentedBall(dent=0.0)
    views = []
    for camera in fan(128):
        cut = photograph(plain, camera, lambda points: np.full(len(points), 0.7), masked=True)
        assert cut.alpha is not None
        mixed = cut.rgb * cut.alpha[..., None] + 0.2 * (1 - cut.alpha[..., None])
        views.append(replace(cut, rgb=mixed, alpha=(cut.alpha >= 0.5).float()))
    maps = find_depths(views, ball(0.85), replace(OPTIONS, pixels=128))
    assert maps.known == 0.0


def test_the_outline_is_left_out_except_of_thin_parts() -> None:
    mask = np.zeros((20, 40), bool)
    mask[3:12, 4:15] = True
    mask[5:11, 15:40] = True  # A bar of six pixels, as far as the image goes.
    kept = away_from_outline(mask)
    core = np.zeros_like(mask)
    core[4:11, 5:14] = True
    body, bar = np.s_[:, :14], np.s_[:, 18:]
    assert (kept[body] == core[body]).all()
    assert (kept[bar] == mask[bar]).all()
    mask[4, 15:] = True  # Of seven it is thin no longer.
    core[5:10, 14:] = True
    assert (away_from_outline(mask) == core).all()
    assert away_from_outline(np.ones((4, 5), bool)).all()
    assert not away_from_outline(np.zeros((4, 5), bool)).any()
