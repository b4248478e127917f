"""A first shape from silhouettes and colours, on a ball with a deep dent."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.distance import capsule, smooth_difference, sphere
from sculpt_framework.demo_scenes.objects import DemoObject
from sculpt_framework.demo_scenes.texture import SolidTexture
from sculpt_framework.demo_scenes.tracing import render
from sculpt_framework.errors import DataError
from sculpt_framework.shape_from_images.depth_maps import DepthMaps, SweepOptions, find_depths
from sculpt_framework.shape_from_images.fusion import carve, one_piece, truncation_of
from sculpt_framework.shape_from_images.hull import signed_mask_distance, visual_hull
from sculpt_framework.shape_from_images.packing import PackedViews, pack_views
from sculpt_framework.shape_from_images.volume import Volume, sample, signed_distance
from sculpt_framework.types import View
from sculpt_plugins.initializers.photo_hull.config import PhotoHullConfig

CPU = torch.device("cpu")
HALF_SIDES = torch.tensor([1.0, 1.0, 1.0])
SIDE = 96
OPTIONS = SweepOptions(views=40, depths=48, neighbours=6, agreeing=2)


def dented_ball(p):
    return smooth_difference(sphere(p, (0.0, 0.0, 0.0), 0.8), capsule(p, (0.0, 0.0, 0.9), (0.0, 0.0, 0.5), 0.3), 0.06)


TEXTURE = SolidTexture(ground=(0.75, 0.3, 0.3), patches=(0.85, 0.75, 0.45), spots=(0.2, 0.25, 0.45), seed=3)
BALL = DemoObject(name="ball", summary="", distance=dented_ball, texture=TEXTURE, genus=0)


@pytest.fixture(scope="module")
def views() -> list[View]:
    made = []
    for i, camera in enumerate(demo_cameras(40, SIDE)):
        rgb, alpha = render(BALL, camera)
        made.append(View(name=str(i), camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(alpha)))
    return made


def truth(points: np.ndarray) -> np.ndarray:
    return dented_ball(points.T.astype(np.float64))


def error_in_dent(values: np.ndarray, points: np.ndarray) -> float:
    """Mean distance, from the true surface of the dent, of the surface that values (a signed distance) describe."""
    deep = (np.abs(truth(points)) < 0.02) & (np.hypot(points[:, 0], points[:, 1]) < 0.25) & (points[:, 2] > 0)
    assert deep.sum() > 50
    return float(np.abs(values[deep] - truth(points)[deep]).mean())


def test_photo_hull_digs_what_no_silhouette_shows(views):
    hull, target = PhotoHullConfig(cells=64, pixels=48, depths=48).build().targets(views, HALF_SIDES, CPU)
    dense = sample(hull, (1.0, 1.0, 1.0), 64, CPU)
    points = torch.from_numpy(dense.points)
    before = error_in_dent(dense.values.reshape(-1), dense.points)
    after = error_in_dent(target(points).numpy(), dense.points)
    assert before > 0.15
    assert after < 0.25 * before
    # It never grows beyond the hull, and where the ball is convex it stays there.
    assert bool((target(points) >= hull(points)).all())
    side = (np.abs(truth(dense.points)) < 0.015) & (np.abs(dense.points[:, 2]) < 0.3)
    assert np.abs(target(points).numpy() - truth(dense.points))[side].mean() < 0.02


def aside(view: View) -> View:
    """The same, turned aside by 25 degrees in a wider image."""
    angle = np.radians(25.0)
    turn = torch.eye(4, dtype=torch.float64)
    turn[[0, 2], [0, 2]], turn[0, 2], turn[2, 0] = np.cos(angle), np.sin(angle), -np.sin(angle)
    pose = (turn @ view.camera.world_to_camera.double()).float()
    camera = replace(view.camera, world_to_camera=pose, width=2 * SIDE)
    rgb, alpha = render(BALL, camera)
    return replace(view, camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(alpha))


@pytest.mark.parametrize("seen", [lambda view: view, aside])
def test_depths_are_right(views: list[View], seen: Callable[[View], View]):
    """Also where the object is not in the middle of the images: depths are along the axis."""
    views = [seen(view) for view in views[::2]]
    packed = pack_views(views, 32.0)
    maps = find_depths(packed, sample(visual_hull(views, 100), (1.0, 1.0, 1.0), 64, CPU), OPTIONS)
    assert maps.known > 0.7
    view, row, column = np.nonzero(np.isfinite(maps.depths))
    lens, pose = packed.lenses[view].astype(float), packed.poses[view].astype(float)
    local = np.stack(
        [(column + 0.5 - lens[:, 2]) / lens[:, 0], (row + 0.5 - lens[:, 3]) / lens[:, 1], 0 * lens[:, 0] + 1]
    )
    place = (local * maps.depths[view, row, column]).T - pose[:, :, 3]
    world = np.einsum("nij,ni->nj", pose[:, :, :3], place)
    off = np.abs(truth(world))
    assert np.median(off) < 0.5 * maps.step
    assert np.mean(off < 2 * maps.step) > 0.95


def test_without_texture_the_hull_stays(views):
    grey = [View(name=v.name, camera=v.camera, rgb=torch.full_like(v.rgb, 0.5), alpha=v.alpha) for v in views]
    *_, target = PhotoHullConfig(cells=48, pixels=48, depths=32).build().targets(grey, HALF_SIDES, CPU)
    dense = sample(visual_hull(views, 100), (1.0, 1.0, 1.0), 48, CPU)
    carved = (target(torch.from_numpy(dense.points)).numpy() > 0.02) & (dense.values.reshape(-1) < -0.02)
    assert carved.mean() < 0.01


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_views_give_the_hull(views, count, caplog):
    """So few have no neighbours to be compared with, and leave too much unseen to guess at it."""
    caplog.set_level("INFO", "sculpt")
    (target,) = PhotoHullConfig(cells=32, pixels=32, depths=16).build().targets(views[:count], HALF_SIDES, CPU)
    hull = visual_hull(views[:count], 100)
    points = torch.from_numpy(sample(hull, (1.0, 1.0, 1.0), 32, CPU).points)
    assert target(points).numpy() == pytest.approx(hull(points).numpy(), abs=1e-6)
    assert "start from the visual hull" in caplog.text


def test_no_masks_are_refused(views):
    bare = [View(name=v.name, camera=v.camera, rgb=v.rgb, alpha=None) for v in views[:3]]
    with pytest.raises(DataError, match="--initializer sphere"):
        next(PhotoHullConfig().build().targets(bare, HALF_SIDES, CPU))


def test_images_of_different_sizes_are_packed(views):
    small = View(
        name="small",
        camera=views[0].camera.resized(SIDE // 2, SIDE // 2),
        rgb=views[0].rgb[::2, ::2].contiguous(),
        alpha=views[0].alpha[::2, ::2].contiguous(),
    )
    empty = View(name="e", camera=views[1].camera, rgb=views[1].rgb, alpha=torch.zeros_like(views[1].alpha))
    packed = pack_views([views[0], small, empty], 1000.0)
    assert len(packed) == 2
    assert packed.inside[1].sum() == pytest.approx(packed.inside[0].sum() / 4, rel=0.05)
    assert packed.relative(0, np.array([1])) == pytest.approx(np.eye(4)[None, :3], abs=1e-6)


def test_neighbours_prefer_the_wanted_angle(views):
    packed = pack_views(views, 32.0)
    directions = packed.positions / np.linalg.norm(packed.positions, axis=1, keepdims=True)
    for i, others in enumerate(packed.neighbours(5, 30.0, (10.0, 60.0))):
        angles = np.degrees(np.arccos(np.clip(directions @ directions[i], -1, 1)))
        chosen = np.abs(angles[others] - 30)
        left_out = np.setdiff1d(np.flatnonzero((angles >= 10) & (angles <= 60)), others)
        assert i not in others
        assert (np.diff(angles[others]) >= 0).all()
        assert len(left_out) == 0 or chosen.max() <= np.abs(angles[left_out] - 30).min() + 1e-4


def exact_depths(packed: PackedViews, distance: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Depth maps computed from the truth, NaN beside the object."""
    depths = np.full(packed.inside.shape, np.nan, np.float32)
    for i in range(len(packed)):
        rows, columns = np.nonzero(packed.inside[i])
        lens, pose = packed.lenses[i].astype(float), packed.poses[i].astype(float)
        ray = np.stack([(columns + 0.5 - lens[2]) / lens[0], (rows + 0.5 - lens[3]) / lens[1], np.ones(len(rows))])
        ray = pose[:, :3].T @ ray
        depth = np.full(len(rows), np.linalg.norm(packed.positions[i]) - 1)
        on_the_way = np.arange(len(rows))
        for _ in range(200):
            gap = distance(packed.positions[i][:, None].astype(float) + depth[on_the_way] * ray[:, on_the_way])
            depth[on_the_way] += 0.9 * np.minimum(gap, 0.5) / np.linalg.norm(ray[:, on_the_way], axis=0)
            on_the_way = on_the_way[np.abs(gap) > 1e-6]
            if len(on_the_way) == 0:
                break
        gap = np.abs(distance(packed.positions[i][:, None].astype(float) + depth * ray))
        depths[i, rows, columns] = np.where(gap < 1e-3, depth, np.nan)
    return depths


def test_exact_depths_carve_the_exact_shape(views):
    """What is left is the error of fusing."""
    packed = pack_views(views, 48.0)
    solid = sample(visual_hull(views, 100), (1.0, 1.0, 1.0), 96, CPU)
    carved = carve(solid, packed, DepthMaps(depths=exact_depths(packed, dented_ball), step=0.0, known=1.0), 0.0)
    assert error_in_dent(carved.values.reshape(-1), carved.points) < 0.5 * carved.cell


@pytest.mark.parametrize(
    ("bottom", "radius", "count", "plain", "carves"),
    [
        (0.72, 0.2, 3, False, False),
        (0.72, 0.2, 16, False, True),
        (0.72, 0.2, 16, True, False),
        (0.4, 0.2, 3, False, True),
        (0.4, 0.2, 16, True, True),
        (0.66, 9.0, 16, True, True),
    ],
    ids=["pit", "sure", "plain", "deep", "deep and plain", "wide and plain"],
)
def test_shallow_hollows_need_many_views_of_something(views, bottom, radius, count, plain, carves):
    """In the side of a ball, of which only so many views know anything there."""
    packed = pack_views(views, 48.0)
    if plain:
        packed = replace(packed, colors=np.full_like(packed.colors, 0.5) * packed.inside[..., None])
    straight = np.argsort(-packed.positions[:, 0] / np.linalg.norm(packed.positions, axis=1))

    def hollow(p: np.ndarray) -> np.ndarray:
        dug = capsule(p, (bottom + radius, 0.0, 0.0), (bottom + radius + 1.0, 0.0, 0.0), radius)
        return np.maximum(sphere(p, (0.0, 0.0, 0.0), 0.8), -dug)

    told = exact_depths(packed, hollow)
    told[straight[count:]] = np.nan
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, 65)] * 3, indexing="ij")
    values = np.sqrt(x**2 + y**2 + z**2) - 0.8
    solid = Volume(values=values.astype(np.float32), origin=(-1 - 1 / 64,) * 3, cell=1 / 32)
    carved = carve(solid, packed, DepthMaps(depths=told, step=0.0, known=1.0), 0.03)
    along = carved.values[32:, 32, 32]
    surface = np.interp(0.0, along, np.linspace(0, 1, 33))
    assert surface == pytest.approx(bottom if carves else 0.8, abs=0.02)


def test_bubbles_are_filled_and_crumbs_removed(views):
    """With no depth known at all the shape comes back without either."""
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, 41)] * 3, indexing="ij")
    far = np.sqrt(x**2 + y**2 + z**2)
    ball = np.maximum(far - 0.6, 0.2 - far)
    crumb = np.sqrt((x - 0.8) ** 2 + (y - 0.8) ** 2 + (z - 0.8) ** 2) - 0.06
    solid = Volume(values=np.minimum(ball, crumb).astype(np.float32), origin=(-1.025,) * 3, cell=0.05)
    packed = pack_views(views[:2], 16.0)
    nothing = DepthMaps(depths=np.full(packed.inside.shape, np.nan, np.float32), step=0.0, known=0.0)
    values = carve(solid, packed, nothing, 0.0).values
    assert (values[far < 0.5] < 0).all()
    assert (values[far > 0.7] > 0).all()


@pytest.mark.parametrize(("narrow", "width", "opens"), [(1, 2, False), (1, 3, True), (2, 4, False), (2, 5, True)])
def test_a_bubble_opens_only_by_what_is_wide(narrow: int, width: int, opens: bool):
    """A block with a cavity at the end of a canal."""
    hull = np.zeros((33, 33, 33), bool)
    hull[3:30, 3:30, 3:30] = True
    hollow = np.zeros_like(hull)
    hollow[12:20, 12:20, 12:20] = True
    hollow[20:30, 13 : 13 + width, 13 : 13 + width] = True
    solid = one_piece(hull & ~hollow, hull, narrow)
    assert solid[16, 16, 16] != opens
    assert (solid == (hull & ~hollow if opens else hull)).mean() > 0.99


def test_lengths_do_not_shrink_with_the_cells():
    volumes = [
        Volume(values=np.ones((cells + 2, 8, 8), np.float32), origin=(-1.0,) * 3, cell=2 / cells)
        for cells in (64, 128, 192, 256)
    ]
    assert [truncation_of(volume) for volume in volumes] == pytest.approx([6 / 64, 6 / 128, 6 / 128, 6 / 128])


def test_signed_distance_of_a_sphere():
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, 65)] * 3, indexing="ij")
    true = np.sqrt(x**2 + y**2 + z**2) - 0.6
    cell = 2 / 64
    scaled = (0.3 * np.clip(true, -0.1, 0.1)).astype(np.float32)
    found = signed_distance(true < 0, scaled, cell)
    close = np.abs(true) < cell
    assert np.abs(found - true)[close].max() < 0.15 * cell
    assert np.abs(found - true).max() < 1.0 * cell
    empty = np.zeros((3, 3, 3), bool)
    assert (signed_distance(empty, np.ones((3, 3, 3), np.float32), 1.0) > 0).all()


def test_mask_distance_is_exact_to_a_fraction_of_a_pixel():
    rows, columns = np.indices((48, 48)) + 0.5
    true = np.hypot(rows - 24, columns - 24) - 15.3
    coverage = torch.from_numpy(np.clip(0.5 - true, 0, 1).astype(np.float32))
    assert np.abs(signed_mask_distance(coverage).numpy() - true).max() < 0.6
    assert np.abs(signed_mask_distance(coverage).numpy() - true)[np.abs(true) < 0.4].max() < 0.05
