"""Pictures of a mesh: as it turns, and its depths and normals from given cameras."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float64, Int64, UInt8

from sculpt_framework.errors import ConfigError, OutputError
from sculpt_framework.export.assets import TexturedMesh
from sculpt_framework.export.atomic import cannot_write, make_folder, write_atomically
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.export.mesh_pixels import MeshPixels, draw_mesh
from sculpt_framework.types import Camera, View

Picture = UInt8[np.ndarray, "h w 3"]
_SAMPLES = 2
"""Along each side of a pixel."""
_TILT = np.radians(20.0)
_ANGLE = np.radians(35.0)
"""How wide a turntable's camera sees."""


def turntable_cameras(
    vertices: Float64[np.ndarray, "v 3"], up: Float64[np.ndarray, " 3"], frames: int, size: int
) -> Iterator[Camera]:
    """Cameras on a circle around a mesh, a little above it, that look at the middle of its box; world frame. ``up`` is
    a unit vector."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = 0.5 * (low + high)
    radius = 0.5 * float(np.linalg.norm(high - low))
    distance = 1.02 * radius / np.sin(0.5 * _ANGLE)
    first = np.eye(3)[int(np.abs(up).argmin())]
    first = first - up * (first @ up)
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    focal = 0.5 * size / np.tan(0.5 * _ANGLE)
    for turn in 2 * np.pi * np.arange(frames) / frames:
        around = np.cos(turn) * first + np.sin(turn) * second
        position = middle + distance * (np.cos(_TILT) * around + np.sin(_TILT) * up)
        forward = (middle - position) / distance
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ position
        half = 0.5 * size
        yield Camera(
            world_to_camera=torch.from_numpy(pose), fx=focal, fy=focal, cx=half, cy=half, width=size, height=size
        )


def paint(
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    colors: Float[np.ndarray, "v 3"] | TexturedMesh,
    camera: Camera,
) -> Float[np.ndarray, "h w 3"]:
    """The mesh from a camera, in vertex colours or its texture as they are, sRGB, antialiased, on white."""
    fine = camera.resized(camera.width * _SAMPLES, camera.height * _SAMPLES)
    pixels = draw_mesh(vertices, faces, fine)
    if isinstance(colors, TexturedMesh):
        rgb = _textured(pixels, colors)
    else:
        rgb = pixels.interpolate(faces, colors.astype(np.float32))
    rgb = np.where((pixels.face >= 0)[..., None], rgb, np.float32(1))
    return np.asarray(cv2.resize(rgb, (camera.width, camera.height), interpolation=cv2.INTER_AREA))


def _textured(pixels: MeshPixels, mesh: TexturedMesh) -> Float[np.ndarray, "h w 3"]:
    atlas = mesh.atlas
    uv = pixels.interpolate(atlas.faces, atlas.uv)
    columns = (uv[..., 0] * atlas.width - 0.5).astype(np.float32)
    rows = ((1 - uv[..., 1]) * atlas.height - 0.5).astype(np.float32)
    return cv2.remap(mesh.texture.rgb, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def write_turntable(path: Path, frames: Iterator[Picture], frames_per_second: int) -> None:
    """GIF or MP4, by the name's ending.

    Raises ConfigError for another ending, OutputError where the file cannot be written.
    """
    ending = path.suffix.lower()
    if ending == ".gif":
        _write_gif(path, frames, frames_per_second)
    elif ending == ".mp4":
        _write_mp4(path, frames, frames_per_second)
    else:
        raise ConfigError(f"{path.name}: a turntable is a .gif or an .mp4 file; name one with --out.")


def _write_gif(path: Path, frames: Iterator[Picture], frames_per_second: int) -> None:
    from PIL import Image

    pictures = [Image.fromarray(frame).quantize(colors=255, dither=Image.Dither.FLOYDSTEINBERG) for frame in frames]
    first, *rest = pictures
    step = round(1000 / frames_per_second)
    write_atomically(
        path, lambda file: first.save(file, "GIF", save_all=True, append_images=rest, duration=step, loop=0)
    )


def _write_mp4(path: Path, frames: Iterator[Picture], frames_per_second: int) -> None:
    """OpenCV writes videos to a named file only, so the file beside is made here."""
    aside = path.with_name(f".{path.stem}.{os.getpid()}.partial.mp4")
    writer = None
    try:
        try:
            with open(aside, "wb"):
                pass
            for frame in frames:
                if writer is None:
                    code = cv2.VideoWriter.fourcc(*"mp4v")
                    writer = cv2.VideoWriter(str(aside), code, frames_per_second, (frame.shape[1], frame.shape[0]))
                    if not writer.isOpened():
                        raise OutputError(f"cannot write {path}: no MP4 encoder here; name a .gif file with --out.")
                writer.write(np.ascontiguousarray(frame[:, :, ::-1]))
            if writer is not None:
                writer.release()
            if aside.stat().st_size == 0:
                raise OutputError(f"cannot write {path} (the video encoder wrote nothing); free space or take .gif.")
            os.replace(aside, path)
        finally:
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from error


def write_maps(
    folder: Path,
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    views: Sequence[View],
) -> int:
    """Depth and normals of the mesh from the cameras of views, into ``depth`` and ``normal`` of a folder.

    ``depth/NAME.tiff``: camera z in world units, 32-bit floats, 0 where there is no surface. ``normal/NAME.png``: world
    normal n as 65535 (n + 1) / 2 in 16 bits, red x, 0 where there is no surface. Returns the number of views; raises
    OutputError where a file cannot be written. Folders in names become underscores, or stay if two names would be one.
    """
    normals = vertex_normals(vertices, faces)
    names = [view.name.replace("/", "_") for view in views]
    if len(set(names)) < len(views):
        names = [view.name for view in views]
    for name, view in zip(names, views, strict=True):
        pixels = draw_mesh(vertices, faces, view.camera)
        seen = pixels.face >= 0
        depth = np.where(seen, pixels.depth, 0).astype(np.float32)
        normal = pixels.interpolate(faces, normals)
        length = np.linalg.norm(normal, axis=2, keepdims=True)
        code = np.rint((normal / np.maximum(length, 1e-12) + 1) * 32767.5).astype(np.uint16)
        code[~seen] = 0
        _write_image(folder / "depth" / f"{name}.tiff", depth)
        _write_image(folder / "normal" / f"{name}.png", np.ascontiguousarray(code[:, :, ::-1]))
    return len(views)


def _write_image(path: Path, pixels: np.ndarray) -> None:
    done, data = cv2.imencode(path.suffix, pixels)
    if not done:
        raise ValueError(f"{path.name} cannot be encoded")
    make_folder(path.parent)
    write_atomically(path, data.tobytes())
