"""The nearest triangle by a grid, against libigl's tree."""

from collections.abc import Callable

import igl
import numpy as np
import pytest
import trimesh

from sculpt_framework.evaluation.face_search import FaceSearch, face_grid
from sculpt_framework.evaluation.mesh import Mesh


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(vertices=np.array(shape.vertices, np.float64), faces=np.array(shape.faces, np.int64))


def bumpy() -> Mesh:
    ball = mesh_of(trimesh.creation.icosphere(subdivisions=4, radius=0.7))
    return Mesh(
        vertices=ball.vertices + np.random.default_rng(0).normal(0, 0.01, ball.vertices.shape), faces=ball.faces
    )


def soup() -> Mesh:
    """Triangles that do not know of each other, slivers among them."""
    generator = np.random.default_rng(1)
    corners = generator.uniform(-1, 1, (400, 1, 3)) + generator.normal(0, 0.05, (400, 3, 3))
    corners[:40, 2] = corners[:40, 0] + 0.3 * (corners[:40, 1] - corners[:40, 0]) + 1e-9
    return Mesh(vertices=corners.reshape(-1, 3), faces=np.arange(1200).reshape(-1, 3))


def by_tree(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Squared distances, by libigl alone."""
    return np.asarray(igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces)[0])


def points_near(mesh: Mesh, deviation: float) -> np.ndarray:
    generator = np.random.default_rng(2)
    on = mesh.vertices[generator.integers(0, len(mesh.vertices), 3000)]
    return on + generator.normal(0, deviation, on.shape)


@pytest.mark.parametrize("deviation", [0.0, 0.003, 0.05, 0.5, 20.0])
@pytest.mark.parametrize("make", [bumpy, soup])
def test_it_finds_what_the_tree_finds(make: Callable[[], Mesh], deviation: float):
    mesh = make()
    search, points = FaceSearch(mesh), points_near(mesh, deviation)
    assert face_grid(mesh) is not None
    squared, face = search.squared_distances(points)
    np.testing.assert_allclose(np.sqrt(squared), np.sqrt(by_tree(mesh, points)), atol=1e-7)
    # The face is one that is as near.
    for number in range(20):
        alone = by_tree(Mesh(vertices=mesh.vertices, faces=mesh.faces[face[number]][None]), points[number : number + 1])
        np.testing.assert_allclose(np.sqrt(alone[0]), np.sqrt(squared[number]), atol=1e-7)


def test_a_few_far_points_need_no_tree(monkeypatch: pytest.MonkeyPatch):
    mesh = bumpy()
    search, points = FaceSearch(mesh), points_near(mesh, 0.003)
    points[:20] *= np.linspace(0.0, 0.9, 20)[:, None]
    points[20:40] *= np.linspace(2.0, 9.0, 20)[:, None]
    with monkeypatch.context() as patched:
        patched.setattr(igl, "AABB", lambda: pytest.fail("a tree is built"))
        squared, _ = search.squared_distances(points)
    np.testing.assert_allclose(squared, by_tree(mesh, points), atol=1e-12)


def test_triangles_of_all_sizes_are_left_to_the_tree():
    box, ball = trimesh.creation.box(extents=(9, 9, 9)), trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    mesh = mesh_of(trimesh.util.concatenate([box, ball]))
    assert face_grid(mesh) is None
    squared, face = FaceSearch(mesh).squared_distances(np.array([[0.0, 0.0, 4.0], [0.2, 0.0, 0.0]]))
    assert squared[0] == pytest.approx(0.25)
    assert face[0] < 12 <= face[1]


def test_one_triangle_and_a_point_that_is_no_number():
    mesh = Mesh(vertices=np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), faces=np.array([[0, 1, 2]]))
    squared, face = FaceSearch(mesh).squared_distances(np.array([[0.2, 0.2, 3.0], [2.0, 0.0, 0.0], [1.0, 1.0, 0.0]]))
    np.testing.assert_allclose(squared, [9.0, 1.0, 0.5])
    assert (face == 0).all()
    squared, _ = FaceSearch(bumpy()).squared_distances(np.array([[np.nan, 0.0, 0.0], [0.7, 0.0, 0.0]]))
    assert not squared[0] < 1e300
    assert squared[1] < 1e-2


def test_what_is_far_away_does_not_fill_the_cells_nearby():
    ball = mesh_of(trimesh.creation.icosphere(subdivisions=6, radius=0.7))
    far = np.array([[300.0, 300.0, 300.0], [300.01, 300.0, 300.0], [300.0, 300.01, 300.0]])
    vertices = np.concatenate([ball.vertices, far])
    alone, unused = face_grid(ball), face_grid(Mesh(vertices=vertices, faces=ball.faces))
    assert alone is not None
    assert unused is not None
    assert unused.side == alone.side
    faces = np.concatenate([ball.faces, np.arange(3)[None] + len(ball.vertices)])
    assert face_grid(Mesh(vertices=vertices, faces=faces)) is None
