"""Drawing a mesh and asking what sees it, against a ball in closed form and a scene with an occluder."""

import numpy as np
import pytest
import torch
import trimesh
from small_scene import RADIUS, ball, color_at, view_of_ball

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.export.mesh_pixels import draw_mesh, visibility
from sculpt_framework.types import Camera

CAMERA = demo_cameras(3, 120)[1]


def test_depth_and_colours_of_a_ball():
    vertices, faces = ball(5)
    pixels = draw_mesh(vertices, faces, CAMERA)
    view = view_of_ball("ball", CAMERA)
    assert view.alpha is not None
    truth = view.alpha.numpy() > 0
    assert ((pixels.face >= 0) != truth).mean() < 0.002
    both = truth & (pixels.face >= 0)
    rgb = pixels.interpolate(faces, color_at(vertices))
    assert np.abs(rgb - view.rgb.numpy())[both].mean() < 2e-3
    pose = CAMERA.world_to_camera.numpy()
    world = pixels.interpolate(faces, vertices)
    depth = world @ pose[2, :3] + pose[2, 3]
    np.testing.assert_allclose(pixels.depth[both], depth[both], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(world[both], axis=1), RADIUS, atol=2e-3)
    # Perspective-correct: the place a pixel names projects back onto that pixel.
    local = world @ pose[:3, :3].T + pose[:3, 3]
    columns = CAMERA.fx * local[..., 0] / local[..., 2] + CAMERA.cx
    expected = np.broadcast_to(np.arange(CAMERA.width) + 0.5, columns.shape)
    np.testing.assert_allclose(columns[both], expected[both], atol=1e-3)


def test_faces_behind_the_camera_are_left_out():
    vertices = np.array([[0, 0, 1.0], [1, 0, 1], [0, 1, -1]])
    camera = Camera(
        world_to_camera=torch.eye(4, dtype=torch.float64), fx=10.0, fy=10.0, cx=5.0, cy=5.0, width=10, height=10
    )
    assert (draw_mesh(vertices, np.array([[0, 1, 2]]), camera).face == -1).all()


def test_visibility_against_rays():
    """Two boxes, one before the other: what a camera sees of them is what rays say, but for a pixel's width."""
    boxes = [trimesh.creation.box(extents=(1, 1, 1)), trimesh.creation.box(extents=(0.6, 0.6, 0.6))]
    boxes[1].apply_translation([1.2, 0.1, 0.2])
    shape = trimesh.util.concatenate([box.subdivide().subdivide().subdivide() for box in boxes])
    vertices, faces = np.array(shape.vertices, np.float64), np.array(shape.faces, np.int64)
    cameras = demo_cameras(6, 200)
    seen = visibility(vertices, faces, vertex_normals(vertices, faces), cameras, least=0.2)
    normals = vertex_normals(vertices, faces)
    rays = MeasuredMesh(Mesh(vertices=vertices, faces=faces), samples=100)
    truth = np.zeros(len(vertices), int)
    for camera in cameras:
        origin = camera.position.numpy()
        ways = vertices - origin
        length = np.linalg.norm(ways, axis=1)
        facing = -(ways * normals).sum(1) / length >= 0.2
        reached = rays.first_hits(np.broadcast_to(origin, ways.shape), ways)
        hidden = reached < 1 - 1e-3
        truth += facing & ~hidden
    # Six cameras; of what each says, at most a twentieth differs, along outlines.
    assert np.abs(seen.times_seen - truth).mean() / 6 < 0.05
    assert truth.mean() > 1


@pytest.mark.parametrize("count", [1, 5])
def test_unseen_vertices_have_no_angle(count: int):
    vertices, faces = ball(3)
    seen = visibility(vertices, faces, vertices / RADIUS, demo_cameras(count, 80))
    assert ((seen.times_seen == 0) == (seen.best_cosine == 0)).all()
    assert seen.times_seen.max() <= count
    if count == 1:
        position = demo_cameras(1, 80)[0].position.numpy()
        ways = position - vertices
        cosine = (ways * vertices / RADIUS).sum(1) / np.linalg.norm(ways, axis=1)
        np.testing.assert_allclose(seen.best_cosine, np.where(cosine >= 0.1, cosine, 0), atol=1e-4)
