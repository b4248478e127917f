"""Meshes written by us, read back by trimesh."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.export.mesh_files import (
    read_colored_mesh,
    srgb_to_linear,
    vertex_normals,
    write_mesh_glb,
    write_mesh_obj,
    write_mesh_ply,
)

WRITERS = {"ply": write_mesh_ply, "obj": write_mesh_obj, "glb": write_mesh_glb}


@pytest.fixture
def shape() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    torus = trimesh.creation.torus(1, 0.3)
    vertices = np.array(torus.vertices, float) + np.array([3.0, -2.0, 0.5])
    return vertices, np.array(torus.faces, np.int64), np.random.default_rng(0).random((len(vertices), 3))


@pytest.mark.parametrize("suffix", WRITERS)
def test_round_trip(suffix: str, shape: tuple, tmp_path: Path):
    vertices, faces, colors = shape
    path = tmp_path / f"mesh.{suffix}"
    WRITERS[suffix](path, vertices, faces, colors)
    read = next(iter(trimesh.load_scene(path, process=False).geometry.values()))
    np.testing.assert_allclose(read.vertices, vertices, atol=1e-6)
    np.testing.assert_array_equal(read.faces, faces)
    assert certify(np.array(read.vertices, float), np.array(read.faces, np.int64)).genus == 1
    if suffix == "glb":
        read_colors, expected = read.visual.vertex_attributes["color"], srgb_to_linear(colors)
    else:
        read_colors, expected = np.asarray(read.visual.vertex_colors)[:, :3] / 255, colors
    np.testing.assert_allclose(read_colors, expected, atol=1 / 255)


@pytest.mark.parametrize("suffix", WRITERS)
def test_colours_are_optional_and_our_reader_reads_it(suffix: str, shape: tuple, tmp_path: Path):
    vertices, faces, _ = shape
    path = tmp_path / f"mesh.{suffix}"
    WRITERS[suffix](path, vertices.astype(np.float32), faces)
    read = load_mesh(path)
    np.testing.assert_array_equal(read.faces, faces)
    np.testing.assert_allclose(read.vertices, vertices, atol=1e-6)


def test_our_reader_gives_back_what_was_written(shape: tuple, tmp_path: Path):
    vertices, faces, colors = shape
    write_mesh_ply(tmp_path / "mesh.ply", vertices, faces, colors)
    read_vertices, read_faces, read_colors = read_colored_mesh(tmp_path / "mesh.ply")
    write_mesh_ply(tmp_path / "again.ply", read_vertices, read_faces, read_colors)
    assert (tmp_path / "again.ply").read_bytes() == (tmp_path / "mesh.ply").read_bytes()
    write_mesh_ply(tmp_path / "plain.ply", vertices, faces)
    assert read_colored_mesh(tmp_path / "plain.ply")[2] is None
    with pytest.raises(DataError, match="no mesh file"):
        read_colored_mesh(tmp_path / "none.ply")


def test_colours_outside_the_range_are_clipped(shape: tuple, tmp_path: Path):
    vertices, faces, colors = shape
    write_mesh_ply(tmp_path / "mesh.ply", vertices, faces, colors * 4 - 2)
    read = trimesh.load_mesh(tmp_path / "mesh.ply", process=False)
    assert read.visual.vertex_colors[:, :3].min() == 0
    assert read.visual.vertex_colors[:, :3].max() == 255


def test_glb_carries_normals_that_point_outwards(shape: tuple, tmp_path: Path):
    vertices, faces, colors = shape
    write_mesh_glb(tmp_path / "mesh.glb", vertices, faces, colors)
    read = next(iter(trimesh.load_scene(tmp_path / "mesh.glb", process=False).geometry.values()))
    np.testing.assert_allclose(read.vertex_normals, vertex_normals(vertices, faces), atol=1e-6)


def test_vertex_normals_of_a_sphere_point_away_from_its_centre():
    sphere = trimesh.creation.icosphere(subdivisions=4)
    normals = vertex_normals(np.array(sphere.vertices), np.array(sphere.faces, np.int64))
    np.testing.assert_allclose(normals, sphere.vertices, atol=0.01)


def test_a_vertex_without_area_gets_some_unit_normal():
    normals = vertex_normals(np.zeros((4, 3)), np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(np.linalg.norm(normals, axis=1), 1)


@pytest.mark.parametrize("suffix", WRITERS)
def test_an_empty_mesh_can_be_written(suffix: str, tmp_path: Path):
    WRITERS[suffix](tmp_path / f"mesh.{suffix}", np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3)))
    assert (tmp_path / f"mesh.{suffix}").exists()


def test_srgb_to_linear_known_values():
    np.testing.assert_allclose(srgb_to_linear(np.array([[0.0, 0.5, 1.0]])), [[0, 0.21404, 1]], atol=1e-5)
