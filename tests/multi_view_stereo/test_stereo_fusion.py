"""From depth maps to a shape, and the initializer that does all of it."""

from dataclasses import replace
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from exact_views import DentedBall, ball, exact_maps, fan, photograph, truth_of

from sculpt_framework.config import InitializerConfig
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.errors import DataError
from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps, StereoOptions, find_depths
from sculpt_framework.multi_view_stereo.fusion import dense_cells, fuse, fuse_without_outlines, without_bubbles
from sculpt_framework.multi_view_stereo.stereo_views import stereo_views
from sculpt_framework.shape_from_images import missing, within_hull
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.shape_from_images.volume import Volume, sample, whole_box
from sculpt_framework.types import View
from sculpt_plugins.initializers.photo_hull import initializer as photo_hull
from sculpt_plugins.initializers.photo_hull.config import PhotoHullConfig
from sculpt_plugins.initializers.stereo import initializer as stereo
from sculpt_plugins.initializers.stereo.config import StereoConfig

CPU = torch.device("cpu")
BALL = DentedBall()
CELLS = 48


@pytest.fixture(scope="module")
def views() -> list[View]:
    return [photograph(BALL, camera, masked=True) for camera in demo_cameras(30, 96, placement="above")]


@pytest.fixture(scope="module")
def solid(views: list[View]) -> Volume:
    return sample(visual_hull(views, 100), (1.0, 1.0, 1.0), CELLS, CPU)


@pytest.fixture(scope="module")
def maps(views: list[View], solid: Volume) -> DepthMaps:
    return find_depths(views, solid, StereoOptions(pixels=66, neighbours=8, agreeing=2))


def in_dent(volume: Volume) -> np.ndarray:
    """Errors, in cells, of a signed distance at the bottom of the dent."""
    points = volume.points
    deep = (np.abs(BALL.distance(points)) < volume.cell) & (np.hypot(points[:, 0], points[:, 1]) < 0.25)
    deep &= (points[:, 2] > 0.3) & (points[:, 2] < 0.6)
    assert deep.sum() > 30
    return np.abs(volume.values.reshape(-1) - BALL.distance(points))[deep] / volume.cell


def test_depths_of_a_ball_with_a_dent(maps: DepthMaps) -> None:
    known, truth = maps.depths > 0, truth_of(BALL, maps.views)
    off = np.abs(maps.depths - truth.depths)[known]
    assert maps.known > 0.6
    assert np.median(off) < 0.02
    assert np.mean(off < 0.08) > 0.93


def test_the_dent_is_dug_and_nothing_grows_out_of_the_hull(solid: Volume, maps: DepthMaps) -> None:
    shape = fuse(solid, maps)
    assert in_dent(solid).mean() > 2.5
    assert in_dent(shape).mean() < 0.6
    assert not ((shape.values < 0) & (solid.values > 0)).any()
    side = (np.abs(BALL.distance(solid.points)) < solid.cell) & (np.abs(solid.points[:, 2]) < 0.3)
    assert np.abs(shape.values.reshape(-1) - BALL.distance(solid.points))[side].mean() < 0.7 * solid.cell


def test_exact_depths_give_the_exact_shape(solid: Volume, maps: DepthMaps) -> None:
    """What is left is the error of fusing."""
    assert in_dent(fuse(solid, exact_maps(BALL, maps.views))).mean() < 0.25


def test_a_small_part_that_only_masks_tell_of_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball of five cells' radius without any depth: rays of its masks ask for it. It would vanish else."""
    small = DentedBall(radius=0.2, dent=0.0)
    views = [photograph(small, camera, masked=True) for camera in demo_cameras(12, 160)]
    solid = sample(visual_hull(views, 100), (1.0, 1.0, 1.0), CELLS, CPU)
    maps = exact_maps(small, stereo_views(views, 80.0))
    maps = replace(maps, depths=np.zeros_like(maps.depths), confidence=np.zeros_like(maps.confidence))
    assert (fuse(solid, maps).values < 0).sum() > 0.5 * (solid.values < 0).sum()
    monkeypatch.setattr(missing, "ASKING", len(views) + 1)
    assert (fuse(solid, maps).values < 0).sum() < 0.5 * (solid.values < 0).sum()


def test_a_rod_that_only_masks_tell_of_is_kept_and_nothing_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thinner than a cell, over a ball whose depths are exact: smoothing takes it away, whatever it weighs."""
    ends = np.array([[-0.9, 0.3, 0.8], [0.9, -0.3, 0.8]])

    def with_rod(view: View) -> View:
        assert view.alpha is not None
        local, camera = view.camera.local(ends), view.camera
        places = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx - 0.5, camera.cy - 0.5]
        (left, right), alpha = np.round(places).astype(int), view.alpha.numpy().copy()
        cv2.line(alpha, left.tolist(), right.tolist(), 1.0, 3)
        return replace(view, alpha=torch.from_numpy(alpha))

    below = DentedBall(radius=0.5, dent=0.0)
    views = [with_rod(photograph(below, camera, masked=True)) for camera in demo_cameras(24, 160)]
    solid = sample(visual_hull(views, 100), (1.0, 1.0, 1.0), CELLS, CPU)
    maps = exact_maps(below, stereo_views(views, 80.0))
    along = np.linspace(ends[0], ends[1], 40)[2:-2]
    start = np.array(solid.origin) + 0.5 * solid.cell

    def values_at(volume: Volume, points: np.ndarray) -> np.ndarray:
        return volume.values[tuple(np.floor((points - start) / solid.cell + 0.5).astype(int).T)]

    shape = fuse(solid, maps)
    assert (values_at(solid, along) < solid.cell).all()
    assert np.mean(values_at(shape, along) < 0.5 * solid.cell) > 0.9
    # Between the rod and the ball there is nothing, whatever the hull has there.
    assert (values_at(shape, np.array([[0.0, 0.0, 0.65]])) > 0).all()
    filled = (shape.values < 0).sum()
    monkeypatch.setattr(missing, "ASKING", len(views) + 1)
    bare = fuse(solid, maps)
    assert np.mean(values_at(bare, along) < 0.5 * solid.cell) < 0.2
    # No more than the rod is filled: some 1.8 long, and a cell and a half thick.
    assert 20 < filled - (bare.values < 0).sum() < 3 * 1.8 / solid.cell


def nothing_known() -> DepthMaps:
    maps = exact_maps(BALL, stereo_views([photograph(BALL, fan(16)[4], masked=True)], 8.0))
    return replace(maps, depths=np.zeros_like(maps.depths), confidence=np.zeros_like(maps.confidence))


def test_what_is_unknown_stays_near_the_hull() -> None:
    """Smoothing draws a large shape in by about a cell, and nothing grows."""
    whole = ball(0.8)
    shape = fuse(whole, nothing_known())
    far = np.linalg.norm(whole.points, axis=1).reshape(whole.shape)
    assert (shape.values[far < 0.8 - 1.7 * whole.cell] < 0).all()
    assert not ((shape.values < 0) & (whole.values > 0)).any()


PLAIN = DentedBall(radius=0.8, dent=0.0)


@pytest.fixture(scope="module")
def all_behind() -> DepthMaps:
    """No depth on a plain ball, and what is far behind it all around it."""
    views = [photograph(PLAIN, camera, masked=False) for camera in demo_cameras(24, 96)]
    maps = exact_maps(PLAIN, stereo_views(views, 48.0))
    behind = np.where(maps.views.inside & (maps.depths == 0), np.float32(20), np.float32(0))
    facing = np.broadcast_to(np.array([0, 0, -1], np.float32), maps.normals.shape).copy()
    return replace(maps, depths=behind, normals=facing, confidence=(behind > 0).astype(np.float32))


def test_without_outlines_a_plain_ball_is_where_nobody_sees_through(all_behind: DepthMaps) -> None:
    """Where few images look there is nothing."""
    box = whole_box((2.0, 2.0, 2.0), 80)
    shape, _ = fuse_without_outlines(box, all_behind, all_around=True)
    away = PLAIN.distance(box.points) / box.cell
    inside = shape.values.reshape(-1) < 0
    # Smoothing shrinks what nobody has seen.
    assert inside[away < -5].all()
    assert not inside[away > 1].any()
    nothing, _ = fuse_without_outlines(box, all_behind, all_around=False)
    assert not (nothing.values < 0).any()


@pytest.mark.parametrize(("wrong", "stays"), [(0, True), (2, True), (3, False)])
def test_two_views_may_be_wrong_about_what_they_see_through(wrong: int, stays: bool, all_behind: DepthMaps) -> None:
    depths = all_behind.depths.copy()
    depths[:wrong][all_behind.views.inside[:wrong]] = 20
    box = whole_box((2.0, 2.0, 2.0), 80)
    dense = dense_cells(box, replace(all_behind, depths=depths), np.zeros(depths.shape, bool)).reshape(-1)
    away = PLAIN.distance(box.points) / box.cell
    assert dense[away < -1].all() == stays
    assert not dense[away > 2].any()


def test_depths_a_little_behind_a_place_tell_that_it_is_empty_where_they_are_reliable(all_behind: DepthMaps) -> None:
    """Everything that is seen is four cells behind the middle."""
    box = whole_box((2.0, 2.0, 2.0), 80)
    middle = (box.points**2).sum(axis=1).argmin()
    far = np.linalg.norm(all_behind.views.positions - box.points[middle], axis=1)
    near = replace(all_behind, depths=np.tile((far + 4 * box.cell)[:, None, None], (1, *all_behind.depths.shape[1:])))
    for reliable in (False, True):
        told = dense_cells(box, near, np.full(near.depths.shape, reliable)).reshape(-1)
        assert told[middle] != reliable


def test_bubbles_are_filled_and_crumbs_removed() -> None:
    whole = ball(0.6).values < 0
    holed = whole.copy()
    holed[18:23, 18:23, 18:23] = False
    holed[2, 2, 2] = True
    assert np.array_equal(without_bubbles(holed), whole)
    # A second piece that is no crumb stays.
    apart = whole.copy()
    apart[1:5, 1:5, 1:5] = True
    assert np.array_equal(without_bubbles(apart), apart)
    assert not without_bubbles(np.zeros_like(whole)).any()


@pytest.mark.parametrize(("many", "few"), [(0.6, 0.74), (0.74, 0.6)])
def test_of_two_camps_the_larger_counts(many: float, few: float) -> None:
    """Eight views see one ball, three another: the surface is the one, not between."""
    cameras = [*fan(), *fan()[:2]]
    stack = stereo_views([photograph(DentedBall(dent=0.0), camera, masked=True) for camera in cameras], 32.0)
    right, wrong = (exact_maps(DentedBall(radius=radius, dent=0.0), stack) for radius in (many, few))
    other = np.isin(np.arange(len(stack)), (1, 5, 9))
    told = replace(
        right,
        depths=np.where(other[:, None, None], wrong.depths, right.depths),
        normals=np.where(other[:, None, None, None], wrong.normals, right.normals),
        confidence=np.where(other[:, None, None], wrong.confidence, right.confidence),
    )
    shape = fuse(ball(0.8), told)
    middle = shape.shape[0] // 2
    along = shape.values[middle, middle, middle:]
    surface = np.interp(0.0, along, np.arange(len(along)) * shape.cell)
    assert surface == pytest.approx(many, abs=0.5 * shape.cell)


def test_the_initializer_digs_within_the_hull(views: list[View]) -> None:
    initializer = StereoConfig(cells=CELLS, pixels=66).build()
    hull, target = initializer.targets(views, torch.ones(3), CPU)
    assert 0.5 < initializer.findings["depths_known"] <= 1.0
    assert 0.3 < initializer.findings["confidence"] <= 1.0
    dense = sample(hull, (1.0, 1.0, 1.0), CELLS, CPU)
    points = torch.from_numpy(dense.points)
    assert bool((target(points) >= hull(points)).all())
    assert in_dent(dense.holding(target(points).numpy().reshape(dense.shape))).mean() < 0.6


def test_two_views_give_the_hull(views: list[View], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "sculpt")
    pair = [photograph(BALL, camera, masked=True) for camera in fan()[4:6]]
    initializer = StereoConfig(cells=32, pixels=32).build()
    (target,) = initializer.targets(pair, torch.ones(3), CPU)
    assert initializer.findings == {"depths_known": 0.0, "confidence": 0.0}
    hull = visual_hull(pair, 100)
    points = torch.from_numpy(ball(0.8).points)
    assert torch.equal(target(points), hull(points))
    assert "start from the visual hull" in caplog.text


def test_no_masks_are_refused(views: list[View]) -> None:
    bare = [replace(view, alpha=None) for view in views[:3]]
    with pytest.raises(DataError, match="--initializer sphere"):
        next(StereoConfig().build().targets(bare, torch.ones(3), CPU))


INITIALIZERS = [(photo_hull, PhotoHullConfig()), (stereo, StereoConfig())]
LOW = DentedBall(radius=0.5, dent=0.0)


@pytest.fixture(scope="module")
def from_high_above() -> list[View]:
    """Views from 30 degrees upwards: below the ball there is a cone that none of them shows."""
    high = np.sin(np.radians(30))
    cameras = [each for each in demo_cameras(60, 64) if each.position[2] > high * each.position.norm()]
    return [photograph(LOW, camera, masked=True) for camera in cameras]


@pytest.fixture(scope="module")
def cone(from_high_above: list[View]) -> np.ndarray:
    """Points of it, three cells below the ball."""
    hull = sample(visual_hull(from_high_above, 100), (1.0, 1.0, 1.0), 128, CPU)
    below = (hull.values.reshape(-1) < 0) & (hull.points[:, 2] < -LOW.radius - 3 * hull.cell)
    assert below.sum() > 100
    return hull.points[below]


@pytest.mark.parametrize(("module", "config"), INITIALIZERS)
def test_no_depth_is_looked_for_below_what_no_view_shows(
    module: ModuleType,
    config: InitializerConfig,
    from_high_above: list[View],
    cone: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A mirror on the ground shows what stands on it once more, below: in the cone that the hull has there."""
    asked: list[Volume] = []

    def find_nothing(views: object, solid: Volume, options: object) -> None:
        asked.append(solid)
        raise InterruptedError

    monkeypatch.setattr(module, "find_depths", find_nothing)
    with pytest.raises(InterruptedError):
        list(config.build().targets(from_high_above, torch.ones(3), CPU))
    assert (asked[0].interpolator(CPU)(torch.from_numpy(cone)) > 0).all()


@pytest.mark.parametrize(("module", "config"), INITIALIZERS)
def test_without_any_depth_the_cone_is_closed_too(
    module: ModuleType,
    config: InitializerConfig,
    from_high_above: list[View],
    cone: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where closing it once more, after depths, changes nothing worth it."""
    monkeypatch.setattr(within_hull, "close_unseen", lambda shape, cameras: shape)
    monkeypatch.setattr(
        module, "find_depths", lambda views, solid, options: SimpleNamespace(known=0.0, mean_confidence=0.0)
    )
    first, last = config.build().targets(from_high_above, torch.ones(3), CPU)
    assert (first(torch.from_numpy(cone)) < 0).all()
    assert (last(torch.from_numpy(cone)) > 0).all()
