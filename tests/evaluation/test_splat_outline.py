"""The measure of outlines, on shapes whose outline is known."""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.splat_outline import (
    OutlineError,
    contour_points,
    fine_alpha,
    is_covered,
    outline_offsets,
    signed_offsets,
    silhouette,
)
from sculpt_framework.testing import camera_at, tetrahedron
from sculpt_framework.types import Gaussians
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
CUBE_FACES = np.array([half for a, b, c, d in QUADS for half in ((a, b, c), (a, c, d))], dtype=np.int64)


def cube(half_side: float, z: float = 0.0) -> Mesh:
    return Mesh(vertices=half_side * CUBE + [0.0, 0.0, z], faces=CUBE_FACES)


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(vertices=np.concatenate([mesh.vertices for mesh in meshes]), faces=np.concatenate(faces))


def disc_coverage(size: int, radius: float, edge: float) -> NDArray[np.float64]:
    """A disc in the middle with an edge that is a normal distribution of deviation ``edge``."""
    places = np.arange(size) + 0.5 - size / 2
    distance = np.hypot(places[:, None], places[None]) - radius
    return 0.5 - 0.5 * np.vectorize(math.erf)(distance / edge / math.sqrt(2.0))


def test_the_contour_of_a_disc_is_its_rim():
    points = contour_points(disc_coverage(64, 20.3, 1.0)) - 32.0
    np.testing.assert_allclose(np.hypot(*points.T), 20.3, atol=0.02)
    angles = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    assert np.diff(angles).max() < 0.1


def test_the_silhouette_of_a_cube_seen_face_on_is_its_near_square():
    # The near face at 4 - 0.5, focal length 24: a square with corners 24 * 0.5 / 3.5 from the middle.
    outline = silhouette(cube(0.5), camera_at(4.0))
    half = 24 * 0.5 / 3.5
    beyond = np.abs(outline.pieces - 12.0).max(axis=2)
    np.testing.assert_allclose(beyond, half, atol=1e-12)
    lengths = np.linalg.norm(outline.pieces[:, 1] - outline.pieces[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(8 * half)
    points = np.array([[12.0, 12.0 + half + 0.25], [12.0 - half + 0.5, 12.0], [12.0 + half + 0.3, 12.0 + half + 0.4]])
    np.testing.assert_allclose(signed_offsets(points, outline), [0.25, -0.5, 0.5], atol=1e-9)


def test_edges_with_matter_behind_them_are_no_outline():
    alone = silhouette(cube(0.5), camera_at(4.0))
    before_a_larger_one = silhouette(joined(cube(0.2, -1.0), cube(0.5)), camera_at(4.0))
    assert len(before_a_larger_one.pieces) == len(alone.pieces)


def test_a_partly_hidden_edge_counts_as_far_as_it_is_seen():
    moved = Mesh(vertices=cube(0.5).vertices + np.array([0.6, 0.3, 0.0]), faces=CUBE_FACES)
    outline = silhouette(joined(cube(0.5), moved), camera_at(4.0))
    half, dx, dy = 24 * 0.5 / 3.5, 24 * 0.6 / 3.5, 24 * 0.3 / 3.5
    lengths = np.linalg.norm(outline.pieces[:, 1] - outline.pieces[:, 0], axis=1)
    # Going round two overlapping squares is as far as going round the box that holds both.
    assert lengths.sum() == pytest.approx(2 * (2 * half + dx) + 2 * (2 * half + dy), abs=0.2)


def test_an_open_mesh_has_no_silhouette():
    with pytest.raises(ValueError, match="not closed"):
        silhouette(Mesh(vertices=CUBE, faces=CUBE_FACES[:-1]), camera_at(4.0))


def test_a_mesh_behind_the_camera_has_no_silhouette():
    with pytest.raises(ValueError, match="in front"):
        silhouette(cube(0.5, -4.0), camera_at(4.0))


def test_points_off_all_triangles_are_not_covered():
    triangles = np.array([[[0.0, 0.0], [0.0, 4.0], [4.0, 0.0]]])
    points = np.array([[1.0, 1.0], [3.0, 3.0], [-1.0, 1.0], [9.0, -5.0], [0.5, 3.0]])
    assert is_covered(points, triangles).tolist() == [True, False, False, False, True]


def one_gaussian(deviation: float) -> Gaussians:
    return Gaussians(
        means=torch.zeros(1, 3),
        scales=torch.full((1, 3), deviation),
        rotations=torch.eye(3)[None],
        opacities=torch.tensor([0.99]),
        sh=torch.zeros(1, 1, 3),
        face=torch.zeros(1, dtype=torch.int64),
    )


def test_alpha_between_the_pixels_is_that_of_the_same_picture():
    rasterizer, camera = ReferenceRasterizerConfig().build(torch.device("cpu")), camera_at(4.0)
    gaussians = one_gaussian(0.3)
    fine = fine_alpha(gaussians, camera, rasterizer, low_pass_px2=0.3, finer=3)
    coarse = rasterizer.render(gaussians, camera, torch.zeros(3), low_pass_px2=0.3).alpha.numpy()
    np.testing.assert_allclose(fine[1::3, 1::3], coarse, atol=1e-5)


def test_the_offset_of_one_gaussian_is_the_radius_of_its_half_opacity():
    rasterizer, camera = ReferenceRasterizerConfig().build(torch.device("cpu")), camera_at(4.0, size=48)
    small = tetrahedron()
    mesh = Mesh(vertices=1e-4 * small.vertices.double().numpy(), faces=small.faces.numpy())
    offsets = outline_offsets(mesh, one_gaussian(0.3), camera, rasterizer, low_pass_px2=0.5, finer=4)
    radius = math.sqrt(2.0 * math.log(2.0 * 0.99) * ((48 * 0.3 / 4.0) ** 2 + 0.5))
    error = OutlineError.of(offsets)
    assert error.mean == pytest.approx(radius, abs=0.01)
    assert error.p95 == pytest.approx(radius, abs=0.02)


def test_nothing_drawn_is_no_measure():
    with pytest.raises(ValueError, match="no contour"):
        OutlineError.of(np.zeros(0))
