"""A ball in a pattern, photographed from a ring of cameras, in closed form; meshes of it, and photographs of meshes."""

import numpy as np
import torch
import trimesh

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.types import Camera, View

RADIUS, DISTANCE = 0.8, 3.0
_LIGHT = np.array([0.36, -0.48, 0.8])


def ball(subdivisions: int = 5, radius: float = RADIUS) -> Mesh:
    shape = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Mesh(vertices=np.array(shape.vertices, np.float64), faces=np.array(shape.faces, np.int64))


def moved(mesh: Mesh, vertices: np.ndarray) -> Mesh:
    return Mesh(vertices=np.ascontiguousarray(vertices), faces=mesh.faces)


def ring(count: int, degrees: float, side: int) -> list[Camera]:
    """Cameras a little above the equator, so many degrees apart, looking at the origin."""
    cameras = []
    for angle in np.radians(degrees) * np.arange(count):
        position = DISTANCE * np.array([np.cos(angle) * 0.96, np.sin(angle) * 0.96, 0.28])
        forward = -position / np.linalg.norm(position)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ position
        cameras.append(
            Camera(
                world_to_camera=torch.from_numpy(pose),
                fx=1.7 * side,
                fy=1.7 * side,
                cx=side / 2,
                cy=side / 2,
                width=side,
                height=side,
            )
        )
    return cameras


def pattern(points: np.ndarray) -> np.ndarray:
    """sRGB of places, nowhere the same: waves a few hundredths to a few tenths long in many directions."""
    generator = np.random.default_rng(3)
    waves = generator.normal(size=(3, 40)) * np.geomspace(8, 60, 40)
    grey = 0.5 + 0.06 * np.sin(points @ waves + generator.uniform(0, 6, 40)).sum(axis=-1)
    return np.repeat(np.clip(grey, 0, 1)[..., None], 3, axis=-1)


def view_of_ball(camera: Camera, name: str = "view", plain: bool = False) -> View:
    """By intersecting each pixel's ray with the ball."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    ways = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], axis=2)
    pose = camera.world_to_camera.double().numpy()
    unit = ways / np.linalg.norm(ways, axis=2, keepdims=True)
    along = unit @ pose[:3, 3]
    beside = pose[:3, 3] @ pose[:3, 3] - along**2
    hit = beside < RADIUS**2
    depth = along - np.sqrt(np.maximum(RADIUS**2 - beside, 0))
    world = (unit * depth[..., None] - pose[:3, 3]) @ pose[:3, :3]
    color = np.full(world.shape, 0.6) if plain else pattern(world)
    rgb = torch.from_numpy(np.where(hit[..., None], color, 0).astype(np.float32))
    return View(name=name, camera=camera, rgb=rgb, alpha=torch.from_numpy(hit.astype(np.float32)))


def photograph(mesh: Mesh, camera: Camera) -> View:
    """A grey, matt mesh under a light from one side that leaves nothing dark."""
    pixels = draw_mesh(mesh.vertices, mesh.faces, camera)
    grey = 0.5 + 0.45 * vertex_normals(mesh.vertices, mesh.faces) @ _LIGHT
    rgb = pixels.interpolate(mesh.faces, np.repeat(grey[:, None], 3, axis=1)).astype(np.float32)
    alpha = (pixels.face >= 0).astype(np.float32)
    return View(name="view", camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(alpha))
