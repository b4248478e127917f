"""A scene without files: cameras and pictures made here, of a torus whose true surface is known.

python examples/3_scene_from_arrays.py
"""

import math
from pathlib import Path

import numpy as np
import torch
import trimesh
import tyro

import sculpt_framework as sculpt
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.mesh_pixels import draw_mesh


def main(
    out: Path = Path("outputs/torus.ply"),
    method: str = "gaussian-sculpting",
    views: int = 40,
    side: int = 200,
    seconds: float = 60,
) -> None:
    torus = trimesh.creation.torus(0.6, 0.25, major_sections=96, minor_sections=48)
    truth = Mesh(vertices=np.array(torus.vertices), faces=np.array(torus.faces, np.int64))
    pictures = [photograph(truth, camera_at(number, views, side), f"view {number}") for number in range(views)]
    box = sculpt.Box.between((-1.0, -1.0, -0.5), (1.0, 1.0, 0.5))
    scene = sculpt.Scene(name="torus", train=tuple(pictures), test=(), box=box)
    mesh = sculpt.Session(scene, sculpt.methods[method](), max_time=seconds).run()
    distance = chamfer(mesh.mesh, MeasuredMesh(truth)).point_to_surface
    print(f"{len(mesh.faces)} faces, {distance:.5f} from the truth, whose tube is 0.25 thick")
    out.parent.mkdir(parents=True, exist_ok=True)
    mesh.to_trimesh().export(out)
    print("saved:", out)


def camera_at(number: int, views: int, side: int) -> sculpt.Camera:
    """On a spiral round the origin, 3 away, looking at it. Axes of OpenCV: x right, y down, z ahead."""
    height = 1.8 * (number + 0.5) / views - 0.9
    angle = math.pi * (3 - math.sqrt(5)) * number
    level = math.sqrt(1 - height**2)
    place = 3 * np.array([level * math.cos(angle), level * math.sin(angle), height])
    ahead = -place / np.linalg.norm(place)
    right = np.cross(ahead, (0, 0, 1))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ place
    return sculpt.Camera(
        width=side,
        height=side,
        fx=1.4 * side,
        fy=1.4 * side,
        cx=side / 2,
        cy=side / 2,
        world_to_camera=torch.tensor(pose, dtype=torch.float32),
    )


def photograph(truth: Mesh, camera: sculpt.Camera, name: str) -> sculpt.View:
    """Stripes in plain light, with the mask as alpha."""
    drawn = draw_mesh(truth.vertices, truth.faces, camera)
    color = 0.5 + 0.4 * np.sin(12 * truth.vertices + np.array([0.0, 1.0, 2.0]))
    alpha = (drawn.face >= 0).astype(np.float32)
    rgb = np.where(alpha[..., None] > 0, drawn.interpolate(truth.faces, color), 1.0).astype(np.float32)
    return sculpt.View(name=name, camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(alpha))


if __name__ == "__main__":
    tyro.cli(main)
