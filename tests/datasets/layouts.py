"""One scene, written in every layout: shots of a ball with a pattern that no two directions share."""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from plain_scenes import write_image

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.types import Camera

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
RADIUS = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    name: str
    camera: Camera
    image: np.ndarray
    """RGBA, 8 bit, in the order of OpenCV."""


def ray_directions(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Of pixels (column, row), in the camera frame."""
    ways = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return np.concatenate([ways, np.ones((*ways.shape[:-1], 1))], axis=-1)


def picture(camera: Camera, directions: np.ndarray, background: np.ndarray | None = None) -> np.ndarray:
    """What rays of the camera frame, one a pixel, see of the ball: RGBA, with a hard outline."""
    pose = camera.world_to_camera.double().numpy()
    center = pose[:3, 3]
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    along = unit @ center
    beside = np.sqrt(np.maximum((center @ center) - along**2, 0))
    hit = beside < RADIUS
    depth = along - np.sqrt(np.maximum(RADIUS**2 - beside**2, 0))
    world = (unit * depth[..., None] - center) @ pose[:3, :3]
    # Smooth, so that resampling costs little, and different everywhere.
    waves = 0.5 + 0.4 * np.sin(world @ np.array([[5.0, 1, 2], [0, 6, -2], [3, -1, 4]]).T + [0.3, 1.1, 2.0])
    image = np.zeros((*hit.shape, 4), np.uint8)
    image[..., :3] = np.rint(255 * np.where(hit[..., None], waves, 0.0 if background is None else background))
    image[..., 3] = 255 * hit
    return image


def pixel_centers(width: int, height: int) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([columns, rows], axis=-1)


def make_shots(count: int = 6, side: int = 48) -> list[Shot]:
    cameras = demo_cameras(count, side)
    rays = [ray_directions(camera, pixel_centers(side, side)) for camera in cameras]
    return [
        Shot(name=f"r_{index:02d}", camera=camera, image=picture(camera, ray))
        for index, (camera, ray) in enumerate(zip(cameras, rays, strict=True))
    ]


def write_pictures(folder: Path, shots: Sequence[Shot], *, alpha: bool, masks: Path | None = None) -> None:
    folder.mkdir(parents=True)
    if masks is not None:
        masks.mkdir(parents=True)
    for shot in shots:
        write_image(folder / f"{shot.name}.png", shot.image if alpha else shot.image[..., :3])
        if masks is not None:
            write_image(masks / f"{shot.name}.png", shot.image[..., 3])


def opengl(camera: Camera) -> list[list[float]]:
    return (np.linalg.inv(camera.world_to_camera.numpy()) @ FLIP).tolist()


def write_blender(folder: Path, shots: Sequence[Shot]) -> Path:
    write_pictures(folder / "train", shots, alpha=True)
    frames = [{"file_path": f"train/{shot.name}", "transform_matrix": opengl(shot.camera)} for shot in shots]
    camera = shots[0].camera
    document = {"camera_angle_x": 2 * np.arctan(0.5 * camera.width / camera.fx), "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(document), encoding="utf-8")
    return folder


def write_omni(folder: Path, shots: Sequence[Shot]) -> Path:
    write_pictures(folder / "render" / "images", shots, alpha=True)
    frames = [{"file_path": shot.name, "transform_matrix": opengl(shot.camera), "scale": 1.0} for shot in shots]
    camera = shots[0].camera
    document = {"camera_angle_x": 2 * np.arctan(0.5 * camera.width / camera.fx), "frames": frames}
    (folder / "render" / "transforms.json").write_text(json.dumps(document), encoding="utf-8")
    return folder


def write_nerfstudio(folder: Path, shots: Sequence[Shot], **keys: Any) -> Path:
    write_pictures(folder / "images", shots, alpha=False, masks=folder / "masks")
    frames = []
    for shot in shots:
        camera = shot.camera
        lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
        frames.append(
            {
                "file_path": f"images/{shot.name}.png",
                "mask_path": f"masks/{shot.name}.png",
                "transform_matrix": opengl(camera),
                **lens,
                "w": camera.width,
                "h": camera.height,
            }
        )
    (folder / "transforms.json").write_text(
        json.dumps({"camera_model": "OPENCV", "frames": frames} | keys), encoding="utf-8"
    )
    return folder


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """w x y z, by the eigenvector of Bar-Itzhack's matrix: independent of the reader's formula."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    x, y, z, w = np.linalg.eigh(matrix)[1][:, -1]
    return np.array([w, x, y, z])


def write_colmap(
    folder: Path,
    shots: Sequence[Shot],
    *,
    text: bool = False,
    model: tuple[int, str] = (1, "PINHOLE"),
    values: Sequence[float] | None = None,
    points: np.ndarray | None = None,
    masks: bool = True,
    place: str = "sparse/0",
) -> Path:
    write_pictures(folder / "images", shots, alpha=False, masks=folder / "masks" if masks else None)
    (folder / place).mkdir(parents=True, exist_ok=True)
    first = shots[0].camera
    values = (first.fx, first.fy, first.cx, first.cy) if values is None else values
    points = np.zeros((0, 3)) if points is None else points
    write = _write_colmap_text if text else _write_colmap_binary
    write(folder / place, shots, model, values, points)
    return folder


def _write_colmap_binary(
    folder: Path, shots: Sequence[Shot], model: tuple[int, str], values: Sequence[float], points: np.ndarray
) -> None:
    camera = shots[0].camera
    data = struct.pack("<QiiQQ", 1, 1, model[0], camera.width, camera.height)
    (folder / "cameras.bin").write_bytes(data + struct.pack(f"<{len(values)}d", *values))
    data = struct.pack("<Q", len(shots))
    for index, shot in enumerate(shots):
        pose = shot.camera.world_to_camera.numpy()
        data += struct.pack("<i7di", index + 1, *quaternion(pose[:3, :3]), *pose[:3, 3], 1)
        data += f"{shot.name}.png".encode() + b"\0"
        # The first two images see every point, in the points' order.
        seen = [*range(1, len(points) + 1)] if index < 2 else [-1, -1]
        data += struct.pack("<Q", len(seen))
        data += b"".join(struct.pack("<ddq", 1.0, 2.0, number) for number in seen)
    (folder / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for index, point in enumerate(points):
        data += struct.pack("<Q3d3Bd", index + 1, *point, 10, 20, 30, 0.5)
        data += struct.pack("<Q", 2) + struct.pack("<iiii", 1, index, 2, index)
    (folder / "points3D.bin").write_bytes(data)


def _write_colmap_text(
    folder: Path, shots: Sequence[Shot], model: tuple[int, str], values: Sequence[float], points: np.ndarray
) -> None:
    camera = shots[0].camera
    numbers = " ".join(repr(float(value)) for value in values)
    lines = ["# Camera list", f"1 {model[1]} {camera.width} {camera.height} {numbers}"]
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# Image list with two lines of data per image:"]
    for index, shot in enumerate(shots):
        pose = shot.camera.world_to_camera.numpy()
        words = [repr(float(value)) for value in (*quaternion(pose[:3, :3]), *pose[:3, 3])]
        # Every other image has no observations: a blank line.
        lines += [" ".join([str(index + 1), *words, "1", f"{shot.name}.png"]), "1.0 2.0 -1" if index % 2 else ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# 3D point list"]
    lines += [f"{n + 1} {x!r} {y!r} {z!r} 10 20 30 0.5 1 0 2 0" for n, (x, y, z) in enumerate(points.tolist())]
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_idr(folder: Path, shots: Sequence[Shot], name: str = "cameras.npz") -> Path:
    write_pictures(folder / "image", shots, alpha=False, masks=folder / "mask")
    arrays = {}
    for index, shot in enumerate(shots):
        camera = shot.camera
        # Pixel centres are whole numbers there.
        inner = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
        matrix = np.eye(4)
        matrix[:3] = inner @ camera.world_to_camera.numpy()[:3]
        # Known up to a factor, which may be negative.
        arrays[f"world_mat_{index}"] = np.vstack([matrix[:3] * (-3.0 if index == 1 else 1.0), [0, 0, 0, 1]])
        arrays[f"scale_mat_{index}"] = np.diag([1.1, 1.1, 1.1, 1.0])
    np.savez(folder / name, **arrays)
    return folder


WRITERS = {
    "NeRF-Synthetic": write_blender,
    "OmniObject3D": write_omni,
    "nerfstudio": write_nerfstudio,
    "COLMAP binary": write_colmap,
    "COLMAP text": lambda folder, shots: write_colmap(folder, shots, text=True),
    "IDR": write_idr,
    "IDR sphere": lambda folder, shots: write_idr(folder, shots, "cameras_sphere.npz"),
}


def save_jpeg(path: Path, pixels: np.ndarray, quality: int = 95) -> None:
    done, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    path.write_bytes(data.tobytes())
