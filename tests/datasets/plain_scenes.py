"""A scene of a grey ball, drawn as discs, that takes no time to make; tests spoil it in one place each."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sculpt_framework.demo_scenes.cameras import FIELD_OF_VIEW, demo_cameras
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.blender.config import BlenderConfig

SIDE = 40
RADIUS = 0.8
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def ball(side: int = SIDE) -> np.ndarray:
    """RGBA, 8 bit: a ball of RADIUS at the origin seen from distance 4, with a pattern on it."""
    rows, columns = np.indices((side, side)) + 0.5 - side / 2
    focal = 0.5 * side / np.tan(0.5 * FIELD_OF_VIEW)
    inside = np.hypot(rows, columns) < focal * RADIUS / np.sqrt(16 - RADIUS**2)
    image = np.zeros((side, side, 4), np.uint8)
    image[inside] = (60, 120, 180, 255)
    image[inside & (rows + columns > 0)] = (40, 160, 90, 255)
    return image


def write_image(path: Path, pixels: np.ndarray) -> None:
    done, data = cv2.imencode(path.suffix, pixels)
    assert done
    path.write_bytes(data.tobytes())


def make_scene(folder: Path, views: int = 6, image: np.ndarray | None = None, extension: str = ".png") -> Path:
    """A folder in NeRF-Synthetic layout with a train split only."""
    (folder / "train").mkdir(parents=True)
    frames = []
    for index, camera in enumerate(demo_cameras(views, SIDE)):
        matrix = np.linalg.inv(camera.world_to_camera.numpy())
        matrix[:3, 3] *= 4 / np.linalg.norm(matrix[:3, 3])
        frames.append({"file_path": f"./train/r_{index}", "transform_matrix": (matrix @ _FLIP).tolist()})
        write_image(folder / "train" / f"r_{index}{extension}", ball() if image is None else image)
    write_transforms(folder, {"camera_angle_x": FIELD_OF_VIEW, "frames": frames})
    return folder


def write_transforms(folder: Path, document: object, split: str = "train") -> None:
    (folder / f"transforms_{split}.json").write_text(json.dumps(document), encoding="utf-8")


def edit_transforms(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "transforms_train.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    path.write_text(json.dumps(document), encoding="utf-8")


def load(folder: Path, **options: Any) -> Scene:
    return BlenderConfig(**options).build(str(folder)).load()
