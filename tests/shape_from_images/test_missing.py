"""What masks show and a shape leaves open: where it is filled, and where not."""

from collections.abc import Sequence

import numpy as np
import pytest
import torch
import trimesh

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.multi_view_stereo.stereo_views import StereoViews, stereo_views
from sculpt_framework.shape_from_images.missing import missing
from sculpt_framework.shape_from_images.volume import Volume, sample
from sculpt_framework.types import Camera, View

CPU = torch.device("cpu")
CELLS = 48
OUTER, INNER, TOP = 0.7, 0.58, 0.55


def from_radius(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return points[:, :2].norm(dim=1), points[:, 2]


def hull(points: torch.Tensor) -> torch.Tensor:
    """A solid cylinder: what silhouettes say of a pot."""
    across, up = from_radius(points)
    return torch.maximum(across - OUTER, up.abs() - TOP)


def photographs(cameras: Sequence[Camera]) -> list[View]:
    """Of a pot with a wall and a floor, where no color matters."""
    wall = trimesh.creation.annulus(INNER, OUTER, 2 * TOP)
    floor = trimesh.creation.cylinder(INNER, 0.2)
    floor.apply_translation((0, 0, 0.1 - TOP))
    vertices = np.concatenate([wall.vertices, floor.vertices]).astype(np.float64)
    faces = np.concatenate([wall.faces, floor.faces + len(wall.vertices)]).astype(np.int64)
    views = []
    for number, camera in enumerate(cameras):
        seen = draw_mesh(vertices, faces, camera).face >= 0
        alpha = torch.from_numpy(seen).float()
        views.append(View(name=str(number), camera=camera, rgb=alpha[..., None].expand(-1, -1, 3), alpha=alpha))
    return views


@pytest.fixture(scope="module")
def views() -> StereoViews:
    return stereo_views(photographs(demo_cameras(40, 160, placement="above")), 80.0)


def pot_up_to(top: float, solid: Volume) -> np.ndarray:
    across, up = from_radius(torch.from_numpy(solid.points))
    wall = (across < OUTER) & (across > INNER) & (up.abs() < TOP)
    return ((wall | ((across < OUTER) & (up < 0.2 - TOP) & (up > -TOP))) & (up < top)).numpy().reshape(solid.shape)


def test_a_lost_rim_comes_back_without_a_lid(views: StereoViews) -> None:
    """From the side, the rim's open part is a strip, and the whole disk behind it would explain that, too."""
    solid = sample(hull, (0.8, 0.8, 0.8), CELLS, CPU)
    lost = pot_up_to(1.0, solid) & ~pot_up_to(TOP - 4 * solid.cell, solid)
    left, unknown = pot_up_to(TOP - 4 * solid.cell, solid), np.zeros(views.inside.shape, np.float32)
    across = from_radius(torch.from_numpy(solid.points))[0].numpy().reshape(solid.shape)
    lid = across < INNER - 3 * solid.cell
    found = missing(left, solid, views, unknown, 0.07, np.zeros(solid.shape, bool))
    assert (found & lost).sum() > 0.5 * lost.sum()
    assert (found & lid).sum() < 0.02 * lost.sum()
    assert (missing(left, solid, views, unknown, 0.07) & lid).sum() > 0.5 * lost.sum()


def test_nothing_is_missing_where_all_is_covered(views: StereoViews) -> None:
    solid = sample(hull, (0.8, 0.8, 0.8), CELLS, CPU)
    unknown = np.zeros(views.inside.shape, np.float32)
    assert not missing(solid.values < solid.cell, solid, views, unknown, 0.07).any()


def test_what_more_views_see_through_is_left_open(views: StereoViews) -> None:
    solid = sample(hull, (0.8, 0.8, 0.8), CELLS, CPU)
    far = np.full(views.inside.shape, 100.0, np.float32)
    assert not missing(pot_up_to(TOP - 4 * solid.cell, solid), solid, views, far, 0.07).any()
