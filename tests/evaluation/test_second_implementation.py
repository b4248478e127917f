"""Our figures beside those of other people's code, to 1 %: trimesh's nearest points, scipy's trees, Heron's formula."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from sculpt_framework.evaluation.geometry import chamfer, sample_surface
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.triangle_quality import triangle_quality, triangle_shapes

SAMPLES = 2000


def ours(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(vertices=np.array(shape.vertices, float), faces=np.array(shape.faces, np.int64))


def pair() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """A bumpy ellipsoid and a sphere: far apart in places, through each other in others."""
    result = trimesh.creation.icosphere(subdivisions=3)
    result.vertices *= [1.15, 1.0, 0.9]
    result.vertices += 0.02 * np.sin(7 * result.vertices[:, [1, 2, 0]])
    return result, trimesh.creation.icosphere(subdivisions=3)


def nearest(points: np.ndarray, normals: np.ndarray, target: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Distances to trimesh's nearest points, and |cosines| with the normals of their faces."""
    distance, face = np.empty(len(points)), np.empty(len(points), dtype=int)
    for start in range(0, len(points), 500):
        part = slice(start, start + 500)
        _, distance[part], face[part] = trimesh.proximity.closest_point_naive(target, points[part])
    return distance, np.abs((normals * target.face_normals[face]).sum(axis=1))


def drawn(shape: trimesh.Trimesh, seed: int) -> tuple[np.ndarray, np.ndarray]:
    points, face = trimesh.sample.sample_surface(shape, SAMPLES, seed=seed)
    return points, shape.face_normals[face]


def fscore(there: np.ndarray, back: np.ndarray, threshold: float) -> float:
    precision, recall = (there < threshold).mean(), (back < threshold).mean()
    return 2 * precision * recall / max(precision + recall, 1e-9)


def test_the_same_samples_give_the_same_figures():
    result, reference = pair()
    measured = chamfer(ours(result), ours(reference), samples=SAMPLES)
    mine, theirs = sample_surface(ours(result), SAMPLES, 1), sample_surface(ours(reference), SAMPLES, 0)
    there, cosine_there = nearest(mine.points, mine.normals, reference)
    back, cosine_back = nearest(theirs.points, theirs.normals, result)
    assert measured.accuracy == pytest.approx(there.mean(), rel=1e-9)
    assert measured.completeness == pytest.approx(back.mean(), rel=1e-9)
    assert measured.point_to_surface == pytest.approx(0.5 * (there.mean() + back.mean()), rel=1e-9)
    assert measured.point_to_surface_squared == pytest.approx(0.5 * ((there**2).mean() + (back**2).mean()), rel=1e-9)
    # Nearest points on an edge belong to two faces, of which each implementation names one.
    expected = 0.5 * (cosine_there.mean() + cosine_back.mean())
    assert measured.normal_consistency == pytest.approx(expected, rel=0.01)
    diagonal = np.linalg.norm(reference.bounds[1] - reference.bounds[0])
    for share, score in measured.fscore_relative.items():
        assert score == pytest.approx(fscore(there, back, share * diagonal), abs=1e-9)
    for threshold, score in measured.fscore_absolute.items():
        assert score == pytest.approx(fscore(there, back, threshold), abs=1e-9)
    to_theirs, to_mine = (cKDTree(a.points).query(b.points)[0] for a, b in ((theirs, mine), (mine, theirs)))
    assert measured.point_to_point_accuracy == pytest.approx(to_theirs.mean(), rel=1e-9)
    assert measured.point_to_point == pytest.approx(0.5 * (to_theirs.mean() + to_mine.mean()), rel=1e-9)
    squares = 0.5 * ((to_theirs**2).mean() + (to_mine**2).mean())
    assert measured.point_to_point_squared == pytest.approx(squares, rel=1e-9)


def test_their_own_samples_give_the_same_figures_within_the_error_of_sampling():
    result, reference = pair()
    measured = chamfer(ours(result), ours(reference), samples=50_000, point_to_point=False)
    there, cosine_there = nearest(*drawn(result, 1), reference)
    back, cosine_back = nearest(*drawn(reference, 2), result)
    spread = 0.5 * (np.var(there) / SAMPLES + np.var(back) / SAMPLES) ** 0.5
    assert measured.point_to_surface == pytest.approx(0.5 * (there.mean() + back.mean()), abs=3 * spread)
    assert measured.normal_consistency == pytest.approx(0.5 * (cosine_there.mean() + cosine_back.mean()), rel=0.01)


def test_triangle_shapes_from_side_lengths_alone():
    shape, _ = pair()
    corners = shape.triangles
    a, b, c = (np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in ((1, 2), (2, 0), (0, 1)))
    s = 0.5 * (a + b + c)
    area = np.sqrt(s * (s - a) * (s - b) * (s - c))
    inradius, circumradius = area / s, a * b * c / (4 * area)
    shapes = triangle_shapes(ours(shape))
    np.testing.assert_allclose(shapes.radius_ratio, circumradius / (2 * inradius), rtol=1e-6)
    np.testing.assert_allclose(shapes.aspect_ratio, np.max([a, b, c], axis=0) / (2 * 3**0.5 * inradius), rtol=1e-6)
    angles = np.degrees(
        [np.arccos((y * y + z * z - x * x) / (2 * y * z)) for x, y, z in ((a, b, c), (b, c, a), (c, a, b))]
    )
    np.testing.assert_allclose(shapes.minimum_angle, angles.min(axis=0), atol=1e-5)
    np.testing.assert_allclose(shapes.maximum_angle, angles.max(axis=0), atol=1e-5)
    quality = triangle_quality(ours(shape))
    assert quality.under10_pct == pytest.approx(100 * (angles.min(axis=0) < 10).mean())
    expected, _ = np.histogram(angles.min(axis=0), bins=30, range=(0, 60))
    np.testing.assert_array_equal(quality.minimum_angles.counts, expected)
