"""Meshes of one capture side by side, from where it was photographed and from behind.

    python docs/compare_meshes.py CAPTURE MESH ... --out PICTURE [--views 3] [--photographs]

A row per mesh, in plain shading: first as some of the cameras see it, spread over all, then from the far side, from
the left, the right and from below of the middle camera, where no photograph may show anything. ``--photographs`` puts
the photographs above.
"""

import argparse
from pathlib import Path
from typing import cast

import cv2
import igl
import numpy as np
import torch

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.types import Camera, Scene

TURNS = ((0.0, 180.0), (0.0, 90.0), (0.0, -90.0), (90.0, 0.0))
"""Degrees about the middle camera's horizontal and vertical axes, through the middle of the box."""
LIGHT = np.array([0.3, 0.4, 0.85])
HEIGHT = 240
"""Pixels of a picture's rows."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture")
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--photographs", action="store_true")
    request = parser.parse_args()
    scene = cast(DatasetConfig, registry.default("dataset", "auto")).build(request.capture).load()
    chosen = [scene.train[i] for i in np.linspace(0, len(scene.train) - 1, request.views + 2).astype(int)[1:-1]]
    cameras = [view.camera for view in chosen]
    cameras += turned(scene, scene.train[len(scene.train) // 2].camera)
    rows = [[shaded(load_mesh(path), camera) for camera in cameras] for path in request.meshes]
    if request.photographs:
        blank = [np.full_like(picture, 255) for picture in rows[0][request.views :]]
        rows.insert(0, [np.rint(255 * view.rgb.numpy()).astype(np.uint8) for view in chosen] + blank)
    strips = [np.hstack([scaled(picture) for picture in row]) for row in rows]
    cv2.imwrite(str(request.out), np.vstack(strips)[..., ::-1])


def turned(scene: Scene, camera: Camera) -> list[Camera]:
    """The camera carried around the middle of the box, at the distance that shows all of it."""
    pose, center = camera.world_to_camera.double().numpy(), scene.box.center.double().numpy()
    size = min(camera.width, camera.height)
    reach = float(np.linalg.norm(scene.box.half_sides.double().numpy())) * scene.box.scale
    made = []
    for degrees in TURNS:
        about_x, _ = cv2.Rodrigues(np.radians([degrees[0], 0.0, 0.0]))
        about_y, _ = cv2.Rodrigues(np.radians([0.0, degrees[1], 0.0]))
        rotation = about_x @ about_y @ pose[:3, :3]
        moved = np.eye(4)
        moved[:3, :3] = rotation
        moved[:3, 3] = np.array([0.0, 0.0, 1.7 * reach]) - rotation @ center
        made.append(
            Camera(
                world_to_camera=torch.from_numpy(moved), fx=1.3 * size, fy=1.3 * size, cx=size / 2, cy=size / 2,
                width=size, height=size,
            )
        )  # fmt: skip
    return made


def shaded(mesh: Mesh, camera: Camera) -> np.ndarray:
    normals = np.nan_to_num(np.asarray(igl.per_vertex_normals(mesh.vertices, mesh.faces)))
    towards = -(normals @ camera.world_to_camera[:3, :3].double().numpy().T) @ LIGHT
    # What looks away from the camera shows the inside of a mesh that is not closed: dark.
    values = (0.12 + 0.85 * towards.clip(0, 1))[:, None].repeat(3, axis=1)
    drawn = draw_mesh(mesh.vertices, mesh.faces, camera)
    image = np.where(drawn.face[..., None] >= 0, drawn.interpolate(mesh.faces, values), 1.0)
    return np.rint(255 * image.clip(0, 1)).astype(np.uint8)


def scaled(picture: np.ndarray) -> np.ndarray:
    width = round(picture.shape[1] * HEIGHT / picture.shape[0])
    return cv2.resize(picture, (width, HEIGHT), interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    main()
