"""Chamfer distance and its company: known answers, a second implementation, degenerate meshes."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from sculpt_framework.errors import DataError
from sculpt_framework.evaluation import face_search
from sculpt_framework.evaluation.face_search import face_grid
from sculpt_framework.evaluation.geometry import CURVE_THRESHOLD, MeasuredMesh, chamfer, sample_surface
from sculpt_framework.evaluation.mesh import Mesh, load_mesh

OFFSET = 0.02


def mesh_of(shape: trimesh.Trimesh, scale: float = 1.0) -> Mesh:
    return Mesh(vertices=np.array(shape.vertices, float) * scale, faces=np.array(shape.faces, np.int64))


def sphere(radius: float = 1.0, subdivisions: int = 5) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def torus(minor: float) -> Mesh:
    return mesh_of(trimesh.creation.torus(1.0, minor, major_sections=192, minor_sections=96))


@pytest.mark.parametrize(
    ("result", "reference"),
    [(sphere(1 + OFFSET), sphere()), (sphere(1 - OFFSET), sphere()), (torus(0.3 + OFFSET), torus(0.3))],
)
def test_a_smooth_surface_moved_along_its_normal_by_d_is_at_chamfer_d(result: Mesh, reference: Mesh):
    measured = chamfer(result, reference, samples=20_000)
    for distance in (measured.accuracy, measured.completeness, measured.point_to_surface):
        assert distance == pytest.approx(OFFSET, rel=0.01)
    assert measured.point_to_surface_squared == pytest.approx(OFFSET**2, rel=0.02)
    assert measured.normal_consistency > 0.999


def test_a_plate_above_a_larger_plate():
    """Accuracy is the gap everywhere; completeness also sees the part that is missing."""
    small, large = plate(0.5, height=OFFSET), plate(1.0, height=0.0)
    measured = chamfer(small, large, samples=50_000)
    assert measured.accuracy == pytest.approx(OFFSET, rel=1e-9)
    across = np.abs(sample_surface(large, 50_000, 3).points[:, :2])
    expected = np.sqrt(OFFSET**2 + (np.maximum(across - 0.5, 0) ** 2).sum(1)).mean()
    assert measured.completeness == pytest.approx(expected, rel=0.01)
    assert measured.point_to_surface == pytest.approx(0.5 * (measured.accuracy + measured.completeness), rel=1e-12)


def test_cube_grown_by_d_on_every_side():
    """The larger cube sees the smaller one exactly: distance d over a face's middle, farther at its rim."""
    cube = mesh_of(trimesh.creation.box(extents=(2, 2, 2)))
    grown = mesh_of(trimesh.creation.box(extents=(2 + 2 * OFFSET,) * 3))
    measured = chamfer(grown, cube, samples=100_000)
    assert measured.completeness == pytest.approx(OFFSET, rel=1e-9)
    assert measured.accuracy == pytest.approx(OFFSET, rel=0.01)


def test_agrees_with_dense_nearest_samples():
    """A second implementation: trimesh's sampling, and nearest neighbours among samples so dense that their floor is
    small against the distance."""
    result = trimesh.creation.icosphere(subdivisions=4)
    result.vertices = result.vertices * [1.4, 1.2, 0.7] + [0.0, 0.05, 0.0]
    reference = trimesh.creation.icosphere(subdivisions=4)
    measured = chamfer(mesh_of(result), mesh_of(reference), samples=50_000)

    def one_way(source: trimesh.Trimesh, target: trimesh.Trimesh) -> float:
        queries, dense = source.sample(50_000, seed=5), target.sample(80_000, seed=6)
        return float(cKDTree(dense).query(queries, workers=-1)[0].mean())

    assert measured.accuracy == pytest.approx(one_way(result, reference), rel=0.01)
    assert measured.completeness == pytest.approx(one_way(reference, result), rel=0.01)


def test_other_samples_of_a_mesh_share_what_searches_it(monkeypatch: pytest.MonkeyPatch):
    mesh = mesh_of(trimesh.creation.icosphere(subdivisions=3))
    few = MeasuredMesh(mesh, samples=500)
    many = few.with_samples(4000)
    assert len(few.samples.points) == 500
    built = []
    monkeypatch.setattr(face_search, "face_grid", lambda mesh: built.append(mesh) or face_grid(mesh))
    np.testing.assert_array_equal(few.squared_distances(np.ones((1, 3))), many.squared_distances(np.ones((1, 3))))
    assert len(built) == 1
    result = mesh_of(trimesh.creation.icosphere(subdivisions=2, radius=0.9))
    assert chamfer(result, many, samples=4000) == chamfer(result, mesh, samples=4000)


def test_exact_distances_agree_with_trimesh():
    target = trimesh.creation.icosphere(subdivisions=2)
    points = np.random.default_rng(0).normal(size=(200, 3))
    squared, face = MeasuredMesh(mesh_of(target), samples=10).squared_distances(points)
    closest, expected, _ = trimesh.proximity.closest_point_naive(target, points)
    np.testing.assert_allclose(np.sqrt(squared), expected, atol=1e-12)
    corners = target.triangles[face]
    np.testing.assert_allclose(trimesh.triangles.closest_point(corners, points), closest, atol=1e-9)


def test_a_mesh_against_itself_shows_the_sampling_floor():
    measured = chamfer(sphere(), sphere(), samples=20_000)
    assert measured.point_to_surface < 1e-12
    assert measured.point_to_point == pytest.approx(measured.point_to_point_floor, rel=0.1)
    assert measured.fscore == 1


def test_fscore_counts_both_directions():
    """Half of the reference is missing: precision 1, recall a half."""
    both = Mesh(
        vertices=np.concatenate([plate(1.0, 0.0).vertices, plate(1.0, 5.0).vertices]),
        faces=np.concatenate([plate(1.0, 0.0).faces, plate(1.0, 5.0).faces + 4]),
    )
    measured = chamfer(plate(1.0, 0.0), both, samples=10_000)
    assert measured.fscore_absolute[0.01] == pytest.approx(2 / 3, abs=1e-3)
    assert measured.fscore == measured.fscore_relative[CURVE_THRESHOLD]
    assert measured.reference_diagonal == pytest.approx((4 + 4 + 25) ** 0.5)


def test_samples_are_uniform_in_area_and_reproducible():
    mesh = mesh_of(trimesh.creation.box(extents=(1, 2, 4)))
    samples = sample_surface(mesh, 40_000, seed=3)
    share = np.bincount(samples.face, minlength=12) / 40_000
    np.testing.assert_allclose(share, mesh.areas / mesh.areas.sum(), atol=1e-4)
    np.testing.assert_allclose(samples.points.mean(0), 0, atol=0.02)
    np.testing.assert_array_equal(samples.points, sample_surface(mesh, 40_000, seed=3).points)
    assert (samples.points != sample_surface(mesh, 40_000, seed=4).points).any()


def test_samples_fill_a_triangle_evenly():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = sample_surface(Mesh(vertices=corners, faces=np.array([[0, 1, 2]])), 50_000, seed=0).points
    np.testing.assert_allclose(points.mean(0), [1 / 3, 1 / 3, 0], atol=0.005)
    assert (points[:, :2].sum(1) < 0.5).mean() == pytest.approx(0.25, abs=0.01)


def test_a_result_without_area_is_infinitely_far():
    nothing = Mesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int64))
    needle = Mesh(vertices=np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), faces=np.array([[0, 1, 2]]))
    for result in (nothing, needle):
        measured = chamfer(result, sphere(subdivisions=2), samples=1000)
        assert measured.point_to_surface == np.inf
        assert measured.fscore == 0
        with pytest.raises(ValueError, match="without area"):
            chamfer(sphere(subdivisions=2), result, samples=1000)


def test_faces_without_area_change_nothing():
    mesh = sphere(1 + OFFSET, 3)
    spoilt = Mesh(vertices=mesh.vertices, faces=np.concatenate([[[0, 0, 5]], mesh.faces, [[7, 7, 7]]]))
    plain = chamfer(mesh, sphere(), samples=5000)
    assert chamfer(spoilt, sphere(), samples=5000).point_to_surface == pytest.approx(plain.point_to_surface, rel=1e-12)
    assert chamfer(sphere(), spoilt, samples=5000).point_to_surface == pytest.approx(
        chamfer(sphere(), mesh, samples=5000).point_to_surface, rel=1e-12
    )


def test_a_prepared_reference_gives_the_same_figures():
    prepared = MeasuredMesh(sphere(), samples=5000)
    assert chamfer(torus(0.4), prepared, samples=5000) == chamfer(torus(0.4), sphere(), samples=5000)


def test_point_to_point_can_be_left_out():
    result, reference = torus(0.4), sphere()
    whole, part = (chamfer(result, reference, samples=2000, point_to_point=asked) for asked in (True, False))
    assert part.point_to_point is None
    assert part.point_to_surface == whole.point_to_surface


def test_point_to_point_agrees_with_brute_force():
    result, reference = sphere(1.3, 2), torus(0.4)
    measured = chamfer(result, reference, samples=1000)
    ours, theirs = sample_surface(result, 1000, 1).points, sample_surface(reference, 1000, 0).points
    pairs = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    assert measured.point_to_point_accuracy == pytest.approx(pairs.min(1).mean(), rel=1e-9)
    assert measured.point_to_point_completeness == pytest.approx(pairs.min(0).mean(), rel=1e-9)
    squares = 0.5 * ((pairs.min(1) ** 2).mean() + (pairs.min(0) ** 2).mean())
    assert measured.point_to_point_squared == pytest.approx(squares, rel=1e-9)


def test_the_stated_error_is_that_of_the_sampling():
    figures = [chamfer(torus(0.4), sphere(subdivisions=3), samples=2000, seed=10 * s) for s in range(20)]
    spread = np.std([figure.point_to_surface for figure in figures])
    assert spread < 2 * figures[0].point_to_surface_error


def test_invalid_meshes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="not finite"):
        Mesh(vertices=np.array([[np.nan, 0, 0]] * 3), faces=np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="outside"):
        Mesh(vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 3]]))
    with pytest.raises(DataError, match="no mesh file"):
        load_mesh(tmp_path / "none.ply")
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat nonsense")
    with pytest.raises(DataError, match="cannot be read"):
        load_mesh(tmp_path / "broken.ply")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    with pytest.raises(DataError):
        load_mesh(tmp_path / "points.ply")


def plate(half_side: float, height: float) -> Mesh:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half_side + [0, 0, height]
    return Mesh(vertices=corners, faces=np.array([[0, 1, 2], [0, 2, 3]]))
