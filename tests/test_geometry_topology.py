"""Topology checks on meshes whose answer is known."""

import numpy as np
import pytest
import torch
import trimesh

from sculpt_framework.geometry.topology import (
    boundary_edges,
    components,
    euler_characteristic,
    is_consistently_oriented,
    is_edge_manifold,
    is_vertex_manifold,
    signed_volume,
)

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("convert", [np.asarray, torch.as_tensor], ids=["numpy", "torch"])
def test_tetrahedron(convert):
    faces, points = convert(TETRAHEDRON), convert(POINTS)
    assert len(boundary_edges(faces)) == 0
    assert is_edge_manifold(faces)
    assert is_vertex_manifold(faces)
    assert is_consistently_oriented(faces)
    assert euler_characteristic(faces) == 2
    assert signed_volume(points, faces) == pytest.approx(1 / 6)
    assert components(faces)[0] == 1


@pytest.mark.parametrize(
    ("mesh", "euler"),
    [(trimesh.creation.icosphere(3), 2), (trimesh.creation.torus(1.0, 0.3), 0), (trimesh.creation.box(), 2)],
    ids=["sphere", "torus", "box"],
)
def test_closed_meshes_agree_with_trimesh(mesh: trimesh.Trimesh, euler: int):
    faces = np.asarray(mesh.faces)
    assert len(boundary_edges(faces)) == 0
    assert is_vertex_manifold(faces)
    assert is_consistently_oriented(faces)
    assert euler_characteristic(faces) == euler == mesh.euler_number
    assert signed_volume(np.asarray(mesh.vertices), faces) == pytest.approx(mesh.volume)
    assert signed_volume(np.asarray(mesh.vertices), faces[:, ::-1]) == pytest.approx(-mesh.volume)


def test_open_mesh():
    faces = TETRAHEDRON[:3]
    assert sorted(map(tuple, boundary_edges(faces).tolist())) == [(0, 2), (2, 3), (3, 0)]
    assert is_vertex_manifold(faces)
    assert is_consistently_oriented(faces)
    assert euler_characteristic(faces) == 1


def test_two_tetrahedra_at_a_vertex_are_not_vertex_manifold():
    touching = np.concatenate([TETRAHEDRON, np.where(TETRAHEDRON == 0, 0, TETRAHEDRON + 3)])
    assert is_edge_manifold(touching)
    assert not is_vertex_manifold(touching)
    assert components(touching)[0] == 1


def test_two_tetrahedra_at_an_edge_are_not_edge_manifold():
    touching = np.concatenate([TETRAHEDRON, np.where(TETRAHEDRON <= 1, TETRAHEDRON, TETRAHEDRON + 2)])
    assert not is_edge_manifold(touching)
    assert not is_vertex_manifold(touching)


def test_turned_face_is_noticed():
    faces = TETRAHEDRON.copy()
    faces[1] = faces[1, ::-1]
    assert not is_consistently_oriented(faces)
    assert is_vertex_manifold(faces)


def test_components_label_faces():
    count, label = components(np.concatenate([TETRAHEDRON + 10, TETRAHEDRON + 90, TETRAHEDRON + 50]))
    assert count == 3
    assert len({tuple(label[n : n + 4]) for n in (0, 4, 8)}) == 3
    assert all(len(set(label[n : n + 4])) == 1 for n in (0, 4, 8))


def test_volume_is_accurate_far_from_the_origin():
    points = torch.tensor(POINTS, dtype=torch.float64) * 1e-3 + 100.0
    assert signed_volume(points, torch.tensor(TETRAHEDRON)) == pytest.approx(1e-9 / 6, rel=1e-6)
