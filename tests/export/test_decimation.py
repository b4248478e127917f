"""Fewer faces: closed as before, and where the surface was."""

import numpy as np
import pytest
import trimesh
from small_scene import ball, color_at

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.decimation import carry_over, decimate


def _rough(vertices: np.ndarray) -> np.ndarray:
    """With ripples that a decimated mesh has to follow."""
    return vertices * (1 + 0.03 * np.sin(9 * vertices[:, :1]) * np.cos(7 * vertices[:, 1:2]))


def _torus() -> tuple[np.ndarray, np.ndarray]:
    shape = trimesh.creation.torus(1.0, 0.4, major_sections=96, minor_sections=48)
    return _rough(np.array(shape.vertices, np.float64)), np.array(shape.faces, np.int64)


@pytest.mark.parametrize("target", [4000, 1000, 200])
def test_closed_of_the_same_genus_and_near(target: int):
    vertices, faces = _torus()
    points, triangles = decimate(vertices, faces, target)
    assert target - 2 <= len(triangles) <= target
    found = certify(points, triangles)
    assert found.watertight
    assert found.vertex_manifold
    assert found.outward
    assert (found.genus, found.components) == (1, 1)
    error = chamfer(Mesh(vertices=points, faces=triangles), Mesh(vertices=vertices, faces=faces), samples=20_000)
    assert error.point_to_surface < {4000: 0.001, 1000: 0.004, 200: 0.02}[target]


def test_the_error_of_a_reconstruction_grows_by_less_than_a_tenth():
    """20 000 faces of five times as many, of a surface that is as far from the truth as a good reconstruction is."""
    shape = trimesh.creation.torus(1.0, 0.4, major_sections=320, minor_sections=160)
    vertices, faces = _rough(np.array(shape.vertices, np.float64)), np.array(shape.faces, np.int64)
    # Smooth over several faces, as what images leave open is.
    x, y, z = (vertices[:, [axis]] for axis in range(3))
    found = vertices * (1 + 0.002 * np.sin(20 * x + 15 * y) * np.cos(18 * z))
    points, triangles = decimate(found, faces, 20_000)
    assert certify(points, triangles).watertight
    truth = MeasuredMesh(Mesh(vertices=vertices, faces=faces), 50_000)
    meshes = Mesh(vertices=found, faces=faces), Mesh(vertices=points, faces=triangles)
    before, after = (chamfer(mesh, truth, samples=50_000, point_to_point=False).point_to_surface for mesh in meshes)
    assert 2e-4 < before < 2e-3
    assert after < 1.1 * before


def test_pieces_stay_apart():
    vertices, faces = ball(3)
    twice = np.concatenate([vertices, vertices * 0.3 + [3.0, 0, 0]])
    both = np.concatenate([faces, faces + len(vertices)])
    points, triangles = decimate(twice, both, 800)
    assert certify(points, triangles).components == 2


@pytest.mark.parametrize(("scale", "shift"), [(1e-4, 0.0), (1e3, 5e4)])
def test_units_do_not_matter(scale: float, shift: float):
    vertices, faces = _torus()
    points, triangles = decimate(vertices * scale + shift, faces, 1000)
    same, others = decimate(vertices, faces, 1000)
    assert len(triangles) == len(others)
    assert certify(points, triangles).watertight
    assert abs(points.mean() - (same.mean() * scale + shift)) < 0.01 * scale


def test_small_meshes_come_back_as_they_are():
    vertices, faces = ball(1)
    points, triangles = decimate(vertices, faces, 500)
    assert points is vertices
    assert triangles is faces


def test_what_cannot_be_done_is_said():
    vertices, faces = ball(2)
    with pytest.raises(ConfigError, match=r"--target-faces is 3; expected 4 or more"):
        decimate(vertices, faces, 3)
    with pytest.raises(DataError, match=r"the mesh is not closed"):
        decimate(vertices, faces[1:], 100)


def test_colours_are_carried_over():
    vertices, faces = ball(4)
    points, _ = decimate(vertices, faces, 1000)
    colors = carry_over(color_at(vertices), vertices, faces, points)
    assert np.abs(colors - color_at(points)).max() < 0.02
