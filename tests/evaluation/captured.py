"""A ball in a pattern as a folder of photographs, in nerfstudio's layout."""

import json
from pathlib import Path

import cv2
import numpy as np
from photographed_ball import ball, ring, view_of_ball

from sculpt_framework.export.mesh_files import write_mesh_ply

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_capture(folder: Path, *, masks: bool = True, truth: bool = True, views: int = 6) -> Path:
    """Views 12 degrees apart, of 120 x 120 pixels before black; 30 of them go all the way around."""
    names = ("images", "masks") if masks else ("images",)
    for name in names:
        (folder / name).mkdir(parents=True)
    frames = []
    for index, camera in enumerate(ring(views, 12, 120)):
        view = view_of_ball(camera)
        assert view.alpha is not None
        pictures = {"images": view.rgb.numpy()[..., ::-1], "masks": view.alpha.numpy()}
        for name in names:
            cv2.imwrite(str(folder / name / f"{index}.png"), np.rint(255 * pictures[name]).astype(np.uint8))
        frames.append(
            {
                "file_path": f"images/{index}.png",
                "transform_matrix": (np.linalg.inv(camera.world_to_camera.numpy()) @ _OPENGL).tolist(),
                **{"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy},
                **{"w": camera.width, "h": camera.height},
            }
        )
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}), encoding="utf-8")
    if truth:
        write_ball(folder / "gt_mesh.ply", 1.0)
    return folder


def write_ball(path: Path, size: float) -> None:
    """The ball as a mesh, so many times as large."""
    mesh = ball(4)
    write_mesh_ply(path, size * mesh.vertices, mesh.faces)
