"""The certificate on meshes whose facts are known, and against trimesh's own counts."""

import numpy as np
import pytest
import trimesh

from sculpt_framework.evaluation.certificate import Certificate, certify


def certificate(shape: trimesh.Trimesh, **options: bool) -> Certificate:
    return certify(np.array(shape.vertices, float), np.array(shape.faces, np.int64), **options)


def chain_of_tori(count: int) -> trimesh.Trimesh:
    return trimesh.util.concatenate(
        [trimesh.creation.torus(1, 0.2).apply_translation([5 * i, 0, 0]) for i in range(count)]
    )


def test_sphere():
    measured = certificate(trimesh.creation.icosphere(subdivisions=4), self_intersections=True)
    assert measured.watertight
    assert measured.vertex_manifold
    assert measured.outward
    assert (measured.components, measured.genus, measured.euler_characteristic) == (1, 0, 2)
    assert measured.signed_volume == pytest.approx(4 / 3 * np.pi, rel=0.005)
    assert measured.area == pytest.approx(4 * np.pi, rel=0.005)
    assert measured.self_intersections == 0


@pytest.mark.parametrize("count", [1, 3])
def test_genus_adds_up_over_components(count: int):
    measured = certificate(chain_of_tori(count))
    assert (measured.components, measured.genus) == (count, count)


def test_genus_two_in_one_piece():
    """A cube with two square tunnels, as the outer faces of a grid of cells."""
    cells = np.ones((5, 3, 1), dtype=bool)
    cells[1, 1], cells[3, 1] = False, False
    measured = certificate(boxes_surface(cells))
    assert measured.watertight
    assert measured.vertex_manifold
    assert (measured.components, measured.genus) == (1, 2)
    assert measured.signed_volume == pytest.approx(13)


def test_a_hole_is_a_boundary():
    shape = trimesh.creation.icosphere(subdivisions=2)
    shape.update_faces(np.arange(len(shape.faces)) != 7)
    measured = certificate(shape)
    assert not measured.watertight
    assert not measured.outward
    assert measured.boundary_edges == 3
    assert measured.genus is None
    assert measured.edge_manifold


def test_inside_out():
    shape = trimesh.creation.icosphere(subdivisions=2)
    shape.invert()
    measured = certificate(shape)
    assert measured.watertight
    assert measured.consistently_oriented
    assert not measured.outward
    assert measured.signed_volume < 0


def test_one_face_turned_round():
    shape = trimesh.creation.icosphere(subdivisions=2)
    faces = np.array(shape.faces, np.int64)
    faces[3] = faces[3, ::-1]
    measured = certify(np.array(shape.vertices), faces)
    assert measured.watertight
    assert not measured.consistently_oriented
    assert not measured.outward
    assert measured.genus is None


def test_two_cubes_that_share_an_edge_or_a_corner():
    edge = np.zeros((2, 2, 1), dtype=bool)
    edge[0, 0] = edge[1, 1] = True
    measured = certificate(boxes_surface(edge))
    assert not measured.edge_manifold
    assert not measured.watertight
    corner = np.zeros((2, 2, 2), dtype=bool)
    corner[0, 0, 0] = corner[1, 1, 1] = True
    measured = certificate(boxes_surface(corner))
    assert measured.edge_manifold
    assert measured.watertight
    assert not measured.vertex_manifold
    assert measured.genus is None


def test_self_intersections_are_those_a_pairwise_test_finds():
    one = trimesh.creation.icosphere(subdivisions=1)
    other = one.copy().apply_translation([0.7, 0.11, 0.03])
    measured = certificate(trimesh.util.concatenate([one, other]), self_intersections=True)
    expected = sum(crosses(a, b) or crosses(b, a) for a in one.triangles for b in other.triangles)
    assert expected > 10
    assert measured.self_intersections == expected


def test_degenerate_faces_and_unused_vertices_are_counted():
    shape = trimesh.creation.icosphere(subdivisions=1)
    vertices = np.concatenate([np.array(shape.vertices), [[9.0, 9, 9]]])
    faces = np.concatenate([np.array(shape.faces, np.int64), [[0, 0, 1]]])
    measured = certify(vertices, faces)
    assert measured.degenerate_faces == 1
    assert measured.unused_vertices == 1


def test_no_faces():
    measured = certify(np.zeros((0, 3)), np.zeros((0, 3), np.int64), self_intersections=True)
    assert not measured.watertight
    assert (measured.components, measured.genus, measured.signed_volume) == (0, None, 0)
    assert measured.self_intersections == 0


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_trimesh_on_random_soups(seed: int):
    generator = np.random.default_rng(seed)
    shape = trimesh.creation.icosphere(subdivisions=2)
    shape.update_faces(generator.random(len(shape.faces)) < 0.7)
    shape.remove_unreferenced_vertices()
    measured = certificate(shape)
    assert measured.watertight == shape.is_watertight
    assert measured.euler_characteristic == shape.euler_number
    assert measured.components == shape.body_count
    assert measured.boundary_edges == len(trimesh.grouping.group_rows(shape.edges_sorted, require_count=1))


def boxes_surface(cells: np.ndarray) -> trimesh.Trimesh:
    """The faces between full and empty unit cells, two triangles each, corners at the same place merged."""
    padded = np.pad(cells, 1)
    triangles = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for step in (1, -1):
            open_ = padded & ~np.roll(padded, -step, axis=axis)
            for cell in np.argwhere(open_):
                origin = cell + (step > 0) * np.eye(3)[axis]
                quad = [origin, origin + u, origin + u + v, origin + v][::step]
                triangles += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
    shape = trimesh.Trimesh(**trimesh.triangles.to_kwargs(np.array(triangles, float)), process=False)
    shape.merge_vertices()
    return shape


def crosses(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether an edge of triangle ``a`` passes through triangle ``b``, by solving for the crossing."""
    for i in range(3):
        start, end = a[i], a[(i + 1) % 3]
        matrix = np.stack([b[1] - b[0], b[2] - b[0], start - end], axis=1)
        if abs(np.linalg.det(matrix)) > 1e-14:
            u, v, t = np.linalg.solve(matrix, start - b[0])
            if u >= 0 and v >= 0 and u + v <= 1 and 0 < t < 1:
                return True
    return False
