"""Shapes of triangles with known angles."""

import numpy as np
import pytest
import trimesh

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.triangle_quality import sliver_share, triangle_quality, triangle_shapes

EQUILATERAL = [[0.0, 0, 0], [1, 0, 0], [0.5, 3**0.5 / 2, 0]]
RIGHT_ISOSCELES = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]


def triangles(*corners: list[list[float]]) -> Mesh:
    return Mesh(
        vertices=np.array(corners, float).reshape(-1, 3),
        faces=np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3),
    )


def test_equilateral_is_the_best_there_is():
    shapes = triangle_shapes(triangles(EQUILATERAL))
    np.testing.assert_allclose([shapes.minimum_angle[0], shapes.maximum_angle[0]], 60)
    np.testing.assert_allclose([shapes.radius_ratio[0], shapes.aspect_ratio[0]], 1)


def test_right_isosceles():
    shapes = triangle_shapes(triangles(RIGHT_ISOSCELES))
    assert shapes.minimum_angle[0] == pytest.approx(45)
    assert shapes.maximum_angle[0] == pytest.approx(90)
    inradius = 1 - 2**0.5 / 2
    assert shapes.radius_ratio[0] == pytest.approx(2**0.5 / 2 / (2 * inradius))
    assert shapes.aspect_ratio[0] == pytest.approx(2**0.5 / (2 * 3**0.5 * inradius))


@pytest.mark.parametrize("angle", [1e-6, 0.1, 9.99])
def test_needles_keep_their_angle(angle: float):
    """Isosceles with the given angle at the tip: a cosine would lose it to rounding."""
    half = np.tan(np.radians(angle) / 2)
    shapes = triangle_shapes(triangles([[0, 0, 0], [1, half, 0], [1, -half, 0]]))
    assert shapes.minimum_angle[0] == pytest.approx(angle, rel=1e-6)
    assert shapes.maximum_angle[0] == pytest.approx(90 - angle / 2)


def test_no_area_is_the_worst_there_is():
    for corners in ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1, 1, 1]] * 3):
        shapes = triangle_shapes(triangles(corners))
        assert (shapes.minimum_angle[0], shapes.maximum_angle[0]) == (0, 180)
        assert (shapes.radius_ratio[0], shapes.aspect_ratio[0]) == (np.inf, np.inf)


def test_summary_counts_faces():
    half = np.tan(np.radians(5) / 2)
    sliver = [[0, 0, 0], [1, half, 0], [1, -half, 0]]
    flat = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    quality = triangle_quality(triangles(EQUILATERAL, RIGHT_ISOSCELES, sliver, flat))
    assert quality.under10_pct == 50
    assert quality.aspect_over4_pct == 50
    assert quality.radius_over4_pct == 50
    assert quality.smallest_angle == 0
    assert quality.largest_angle == 180
    assert np.isfinite(quality.mean_radius_ratio)
    assert quality.minimum_angles.counts.sum() == 4
    assert quality.maximum_angles.counts.sum() == 4
    assert quality.aspect_ratios.counts.sum() == 2
    assert quality.summary()["under10_pct"] == 50


def test_angles_agree_with_trimesh_and_do_not_depend_on_scale():
    shape = trimesh.creation.torus(1, 0.3)
    vertices, faces = np.array(shape.vertices, float), np.array(shape.faces, np.int64)
    shapes = triangle_shapes(Mesh(vertices=vertices, faces=faces))
    np.testing.assert_allclose(shapes.minimum_angle, np.degrees(shape.face_angles).min(1), atol=1e-6)
    tiny = triangle_shapes(Mesh(vertices=vertices * 1e-5, faces=faces))
    np.testing.assert_allclose(tiny.radius_ratio, shapes.radius_ratio, rtol=1e-6)


def test_a_mesh_without_faces_has_no_quality():
    with pytest.raises(ValueError, match="without faces"):
        triangle_quality(Mesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int64)))


def test_share_of_slivers_alone_is_that_of_all_shapes():
    half = np.tan(np.radians([9.99, 10.01]) / 2)
    needles = [[[0, 0, 0], [1, h, 0], [1, -h, 0]] for h in half.tolist()]
    without_area = [[[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1, 1, 1]] * 3]
    mesh = triangles(*needles, *without_area, EQUILATERAL, RIGHT_ISOSCELES)
    assert sliver_share(mesh) == pytest.approx(50)
    anything = triangles(*np.random.default_rng(0).normal(size=(2000, 3, 3)).tolist())
    assert sliver_share(anything) == pytest.approx(triangle_quality(anything).under10_pct)
    assert 0 < sliver_share(anything) < 100
    with pytest.raises(ValueError, match="without faces"):
        sliver_share(Mesh(vertices=np.zeros((1, 3)), faces=np.zeros((0, 3), np.int64)))
