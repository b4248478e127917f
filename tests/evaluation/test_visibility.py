"""What cameras see of a surface, where it is known, and distances over that part alone."""

import numpy as np
import pytest
import torch
import trimesh

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.visibility import Observed, seen_by, visible_distances
from sculpt_framework.types import Box, Camera

FROM_ABOVE = torch.tensor([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]], dtype=torch.float64)
"""At (0, 0, 4), looking down; the image's x is the world's."""


def camera(focal: float = 100.0, pose: torch.Tensor = FROM_ABOVE) -> Camera:
    return Camera(world_to_camera=pose, fx=focal, fy=focal, cx=50.0, cy=50.0, width=100, height=100)


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(vertices=np.array(shape.vertices, float), faces=np.array(shape.faces, np.int64))


def test_a_box_from_above_shows_its_top_alone():
    surface = MeasuredMesh(mesh_of(trimesh.creation.box(extents=(1, 1, 1))), samples=6000)
    seen = seen_by(surface, [camera()])
    np.testing.assert_array_equal(seen, surface.samples.points[:, 2] > 0.5 - 1e-9)


def test_a_sphere_shows_a_cap():
    """From distance d the cap with z above r^2 / d."""
    surface = MeasuredMesh(mesh_of(trimesh.creation.icosphere(subdivisions=5)), samples=20_000)
    height = surface.samples.points[:, 2]
    seen = seen_by(surface, [camera()])
    assert seen[height > 0.27].all()
    assert not seen[height < 0.23].any()
    assert seen.mean() == pytest.approx(0.5 * (1 - 0.25), abs=0.01)


def test_how_many_cameras_see_a_place():
    """Two from above and one from the side: of a box, the top is seen by two, a side by one."""
    surface = MeasuredMesh(mesh_of(trimesh.creation.box(extents=(1, 1, 1))), samples=6000)
    across = torch.tensor([[0.0, 0, -1, 0], [0, -1, 0, 0], [-1.0, 0, 0, 4], [0, 0, 0, 1]], dtype=torch.float64)
    cameras = [camera(), camera(pose=across), camera()]
    top, side = surface.samples.points[:, 2] > 0.5 - 1e-9, surface.samples.points[:, 0] > 0.5 - 1e-9
    # A point beside an edge may be seen across it.
    clear = (np.abs(surface.samples.points) < 0.499).sum(axis=1) == 2
    np.testing.assert_array_equal(seen_by(surface, cameras)[clear], (top | side)[clear])
    np.testing.assert_array_equal(seen_by(surface, cameras, 2)[clear], top[clear])
    assert not seen_by(surface, cameras, 3)[clear].any()


def test_the_median_leaves_out_what_is_far_off():
    """A box whose top is right but for a tenth of it, far too high."""
    wide, tower = trimesh.creation.box(extents=(1, 1, 1)), trimesh.creation.box(extents=(0.3, 0.3, 1))
    tower.apply_translation((0, 0, 0.5))
    reference = MeasuredMesh(mesh_of(wide), samples=6000)
    measured = visible_distances(
        mesh_of(trimesh.boolean.union([wide, tower])), reference, seen_by(reference, [camera()])
    )
    assert measured.median < 1e-9
    assert measured.point_to_surface > 0.02


def test_what_is_outside_the_image_or_behind_is_not_seen():
    surface = MeasuredMesh(mesh_of(trimesh.creation.icosphere(subdivisions=4)), samples=5000)
    near = seen_by(surface, [camera(focal=400.0)])
    points = surface.samples.points[near]
    # 50 pixels from the middle, at focal length 400, are an eighth of the depth.
    assert np.abs(points[:, :2]).max() <= (4 - points[:, 2]).max() / 8
    assert 0 < near.sum() < seen_by(surface, [camera()]).sum()
    turned = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64)) @ FROM_ABOVE
    assert not seen_by(surface, [camera(pose=turned)]).any()


def test_something_in_between_hides():
    """A plate below a smaller one: what is left are the rays that miss the smaller."""
    upper, lower = trimesh.creation.box(extents=(1, 1, 0.01)), trimesh.creation.box(extents=(2, 2, 0.01))
    upper.apply_translation([0, 0, 2])
    both = MeasuredMesh(mesh_of(trimesh.util.concatenate([upper, lower])), samples=20_000)
    seen = seen_by(both, [camera()])
    x, y, z = both.samples.points.T
    on_top = np.isclose(z, 0.005)
    # The upper plate's lower edge is at depth 2.005 and half-width 0.5; on the lower plate its shadow is larger.
    shadow = np.maximum(np.abs(x), np.abs(y)) < 0.5 * 3.995 / 2.005
    np.testing.assert_array_equal(seen[on_top & shadow], False)
    outside = np.maximum(np.abs(x), np.abs(y)) > 0.5 * 3.995 / 1.995
    assert seen[on_top & outside].all()


def test_all_of_a_convex_object_is_seen_from_all_sides():
    surface = MeasuredMesh(mesh_of(trimesh.creation.icosphere(subdivisions=3, radius=0.8)), samples=3000)
    assert seen_by(surface, demo_cameras(60, 200)).mean() > 0.99
    assert not seen_by(surface, []).any()


def test_what_nobody_sees_is_not_counted():
    """A result without the box's bottom: over all of it that costs, over what is seen from above it does not."""
    whole = mesh_of(trimesh.creation.box(extents=(1, 1, 1)))
    reference = MeasuredMesh(whole, samples=5000)
    open_below = Mesh(vertices=whole.vertices, faces=whole.faces[whole.corners[:, :, 2].max(axis=1) > 0])
    seen = seen_by(reference, [camera()])
    assert chamfer(open_below, reference, samples=5000).completeness > 0.02
    measured = visible_distances(open_below, reference, seen)
    assert measured.seen_share == pytest.approx(1 / 6, abs=0.01)
    assert measured.completeness == pytest.approx(0, abs=1e-9)
    assert measured.point_to_surface == pytest.approx(0, abs=1e-9)
    # What is made up below the box is nearest to its bottom, and is not counted either.
    below = trimesh.creation.box(extents=(1, 1, 0.2)).apply_translation([0, 0, -1])
    made_up = mesh_of(trimesh.util.concatenate([trimesh.Trimesh(whole.vertices, whole.faces), below]))
    assert chamfer(made_up, reference, samples=5000).accuracy > 0.05
    assert visible_distances(made_up, reference, seen).accuracy == pytest.approx(0, abs=1e-9)


def test_where_the_box_cuts_the_object_nothing_is_compared():
    """A bar that goes on beyond the box; the result is closed at the box's wall, as it has to be."""
    bar = mesh_of(trimesh.creation.box(extents=(4, 1, 1)))
    cut = mesh_of(trimesh.creation.box(extents=(2, 1, 1)))
    reference, cameras = MeasuredMesh(bar, samples=8000), demo_cameras(40, 100)
    seen, half = seen_by(reference, cameras), torch.tensor([1.0, 0.6, 0.6], dtype=torch.float64)
    observed = Observed(cameras=cameras, box=Box(minimum=-half, maximum=half))
    assert visible_distances(cut, reference, seen).point_to_surface > 0.05
    measured = visible_distances(cut, reference, seen, observed=observed)
    assert measured.point_to_surface == pytest.approx(0, abs=1e-9)
    # What no camera sees of the result does not count either: a wall inside.
    walled = trimesh.util.concatenate(
        [trimesh.creation.box(extents=(2, 1, 1)), trimesh.creation.box(extents=(0.2, 0.2, 0.2))]
    )
    assert visible_distances(mesh_of(walled), reference, seen, observed=observed).accuracy == pytest.approx(0, abs=1e-9)


def test_where_all_is_seen_it_is_the_plain_distance():
    reference = MeasuredMesh(mesh_of(trimesh.creation.icosphere(subdivisions=4)), samples=5000)
    result = mesh_of(trimesh.creation.icosphere(subdivisions=4, radius=1.05))
    plain = chamfer(result, reference, samples=5000)
    measured = visible_distances(result, reference, np.ones(5000, dtype=bool))
    assert measured.accuracy == plain.accuracy
    assert measured.completeness == plain.completeness


@pytest.mark.parametrize("degrees", [0.0, 10.0, 170.0])
def test_the_angle_between_two_sheets(degrees: float):
    """Which of a sheet's sides is its front does not matter."""
    corners = np.array([[-0.5, -0.5, 0.5], [0.5, -0.5, 0.5], [0.5, 0.5, 0.5], [-0.5, 0.5, 0.5]])
    sheet = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    tilted = sheet.copy().apply_translation((0, 0, -0.5))
    tilted.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), (0, 1, 0)))
    tilted.apply_translation((0, 0, 0.5))
    reference = MeasuredMesh(mesh_of(sheet), samples=5000)
    measured = visible_distances(mesh_of(tilted), reference, seen_by(reference, [camera()]))
    assert measured.normal_error == pytest.approx(min(degrees, 180 - degrees), abs=0.7)


def test_nothing_to_measure_is_infinitely_far():
    reference = MeasuredMesh(mesh_of(trimesh.creation.icosphere(subdivisions=1)), samples=100)
    nothing = Mesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int64))
    assert visible_distances(nothing, reference, np.ones(100, dtype=bool)).point_to_surface == np.inf
    assert visible_distances(reference.mesh, reference, np.zeros(100, dtype=bool)).accuracy == np.inf
