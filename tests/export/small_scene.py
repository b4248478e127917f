"""A ball, its cameras and what they see, in closed form; no run is needed to export from it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import trimesh

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.export.mesh_files import write_mesh_ply
from sculpt_framework.serialization import config_to_json
from sculpt_framework.types import Camera, View
from sculpt_methods.sculpting import gaussian_sculpting_tiny

RADIUS = 0.8


def ball(subdivisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    shape = trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS)
    return np.array(shape.vertices, np.float64), np.array(shape.faces, np.int64)


def color_at(points: np.ndarray) -> np.ndarray:
    """sRGB of places on the ball: smooth, and nowhere the same."""
    return 0.5 + 0.4 * np.sin(points @ np.array([[5.0, 1, 2], [0, 6, -2], [3, -1, 4]]).T + [0.3, 1.1, 2.0])


def view_of_ball(name: str, camera: Camera) -> View:
    """By intersecting each pixel's ray with the ball."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    ways = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], axis=2)
    pose = camera.world_to_camera.double().numpy()
    center = pose[:3, 3]
    unit = ways / np.linalg.norm(ways, axis=2, keepdims=True)
    along = unit @ center
    beside = np.sqrt(np.maximum(center @ center - along**2, 0))
    hit = beside < RADIUS
    depth = along - np.sqrt(np.maximum(RADIUS**2 - beside**2, 0))
    world = (unit * depth[..., None] - center) @ pose[:3, :3]
    rgb = np.where(hit[..., None], color_at(world), 0.0).astype(np.float32)
    return View(name=name, camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(hit.astype(np.float32)))


def views_of_ball(count: int = 10, side: int = 96, only_above: bool = False) -> list[View]:
    cameras = demo_cameras(count if not only_above else 4 * count, side)
    if only_above:
        cameras = tuple(camera for camera in cameras if float(camera.position[2]) > 1.0)[:count]
    return [view_of_ball(f"r_{index}", replace(camera)) for index, camera in enumerate(cameras)]


def write_run(folder: Path, data: Path) -> None:
    """What an export needs of a run directory."""
    vertices, faces = ball()
    folder.mkdir()
    write_mesh_ply(folder / "mesh.ply", vertices, faces, color_at(vertices))
    config = replace(gaussian_sculpting_tiny(), data=str(data))
    (folder / "config.json").write_text(config_to_json(config), encoding="utf-8")
