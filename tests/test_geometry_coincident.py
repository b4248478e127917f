"""Vertices at the same place are moved apart, and nothing else changes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.geometry.coincident import merged, separate


def shape(name: str) -> tuple[np.ndarray, np.ndarray]:
    made = trimesh.creation.icosphere(subdivisions=2) if name == "ball" else trimesh.creation.torus(1.0, 0.4, 24, 12)
    return np.array(made.vertices, np.float64), np.array(made.faces, np.int64)


def distinct(vertices: np.ndarray) -> int:
    return len(np.unique(vertices.astype(np.float32) + np.float32(0), axis=0))


@st.composite
def with_coincident_vertices(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, and which vertices are at the place of another: at an edge's other end or anywhere; up to whole
    faces in one point; some a rounding error apart."""
    vertices, faces = shape(draw(st.sampled_from(["ball", "torus"])))
    scale = 10.0 ** draw(st.integers(-4, 4))
    shift = np.array(draw(st.tuples(*[st.floats(-5, 5)] * 3)))
    vertices = (vertices + shift) * scale
    moved = np.zeros(len(vertices), bool)
    for _ in range(draw(st.integers(1, 8))):
        face = faces[draw(st.integers(0, len(faces) - 1))]
        source = int(face[0])
        targets = (
            face[1 : draw(st.integers(2, 3))] if draw(st.booleans()) else [draw(st.integers(0, len(vertices) - 1))]
        )
        for target in targets:
            vertices[target] = vertices[source] * (1 + draw(st.sampled_from([0.0, 1e-9])))
    names = merged(vertices, np.arange(len(vertices))[:, None].repeat(3, 1))[:, 0]
    moved = np.bincount(names, minlength=len(names))[names] > 1
    return vertices, faces, moved


@given(given_mesh=with_coincident_vertices(), rescale=st.sampled_from([1e-3, 0.37, 1.0, 25.4]))
@settings(max_examples=60, deadline=None)
def test_no_two_vertices_coincide_afterwards_at_any_scale(
    given_mesh: tuple[np.ndarray, np.ndarray, np.ndarray], rescale: float
):
    vertices, faces, moved = given_mesh
    apart = separate(vertices, faces)
    assert distinct(apart * rescale) == len(vertices)
    found = certify(apart * rescale, faces)
    assert found.coincident_vertices == 0
    assert found.watertight_merged
    assert found.degenerate_faces == 0
    way = np.linalg.norm(apart - vertices, axis=1)
    assert (way[moved] > 0).sum() >= moved.sum() - 1
    assert way.max() < 0.02 * np.ptp(vertices, axis=0).max()
    near = KDTree(vertices).query(vertices, k=2)[0][:, 1]
    assert (way[near > 1e-5 * np.abs(vertices).max()] == 0).all()
    np.testing.assert_array_equal(separate(apart, faces), apart)


@pytest.mark.parametrize("name", ["ball", "torus"])
def test_a_mesh_without_them_comes_back_itself(name: str):
    vertices, faces = shape(name)
    assert separate(vertices, faces) is vertices


def test_the_ends_of_a_short_edge_draw_apart_and_sheets_that_touch_part():
    vertices, faces = shape("ball")
    a, b = faces[10, :2]
    short = vertices.copy()
    short[a] = short[b]
    apart = separate(short, faces)
    assert 1e-5 < np.linalg.norm(apart[a] - apart[b]) < 1e-2
    # Two balls that touch in a point: each draws back into itself.
    two = np.concatenate([vertices, vertices + np.array([2 * vertices[:, 0].max(), 0, 0])])
    apart = separate(two, np.concatenate([faces, faces + len(vertices)]))
    changed = np.flatnonzero((apart != two).any(axis=1))
    assert len(changed) == 2
    assert apart[changed[0], 0] < two[changed[0], 0] < apart[changed[1], 0]


def test_where_32_bit_floats_are_too_coarse_nothing_is_moved():
    vertices, faces = shape("ball")
    far = vertices + 1e8
    assert separate(far, faces) is far
    assert certify(far, faces).coincident_vertices > 0


def test_the_certificate_says_what_other_programs_find():
    vertices, faces = shape("ball")
    vertices[faces[10, 0]] = vertices[faces[10, 1]]
    found = certify(vertices, faces)
    assert (found.watertight, found.watertight_merged) == (True, False)
    assert (found.coincident_vertices, found.degenerate_faces) == (1, 2)
    assert not trimesh.Trimesh(vertices, faces).is_watertight
    # Two balls that touch in a point stay closed when it is one vertex.
    whole, _ = shape("ball")
    two = np.concatenate([whole, whole + np.array([2 * whole[:, 0].max(), 0, 0])])
    found = certify(two, np.concatenate([faces, faces + len(whole)]))
    assert (found.coincident_vertices, found.watertight_merged) == (1, True)
