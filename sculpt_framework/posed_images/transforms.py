"""Frames of a transforms file, as Blender exporters write them: parsed, checked, turned into cameras.

All of it before any image is decoded. Layouts differ in what the file is called and where the images are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np
import torch
from jaxtyping import Float64

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.distortion import Distortion
from sculpt_framework.posed_images.image_files import (
    LEAST,
    FoundFile,
    NamedFiles,
    each_once,
    left_out,
    remarks,
    view_names,
)
from sculpt_framework.posed_images.lens import LENS_KEYS, Lens, read_lens
from sculpt_framework.posed_images.lens_keys import read_distortion
from sculpt_framework.posed_images.masks import MASK_FOLDERS, find_masks
from sculpt_framework.posed_images.reading import in_line, number, read_json, required
from sculpt_framework.posed_images.views import PosedImage
from sculpt_framework.types import Camera

# Matrices written with four decimals deviate from a rotation by 1e-4; what exceeds this is no rounding.
_RIGID_TOLERANCE = 2e-3
# Coordinates beyond this lose their digits in float32 wherever they are used later.
_FARTHEST = 1e9
# From OpenGL's camera axes (y up, z backward) to OpenCV's (y down, z forward).
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    name: str
    image: Path
    camera_to_world: Float64[np.ndarray, "4 4"]
    """Rigid; OpenGL axes."""
    lens: Lens
    file_path: str = ""
    """As the file has it."""
    distortion: Distortion | None = None
    mask: Path | None = None


def read_frames(
    path: Path, split: str, images: str | None = None, *, photographs: bool = False, least: int = LEAST
) -> tuple[list[Frame], list[str]]:
    """The frames of a transforms file and notes on what was unusual about them.

    ``file_path`` is relative to the file's folder; with ``images``, only its last part counts, the name of a file in
    that folder below. ``split`` is what the notes call the frames. ``photographs`` may have distorted lenses; without
    it, one is an error. Frames whose image is not there are left out.

    Raises DataError for the first thing that is missing or malformed, naming file and frame, and where images are
    missing so that fewer than ``least`` frames are left.
    """
    document = read_json(path)
    entries = required(document, "frames", str(path))
    if not isinstance(entries, list):
        raise DataError(f"{path}: 'frames' is not a list; expected one object per image.")
    if not entries:
        raise DataError(f"{path}: 'frames' is empty; expected one object per image.")
    files = NamedFiles(path.parent)
    frames, found, masks, missing, scales = [], [], [], [], []
    for index, entry in enumerate(entries):
        where = f"{path}: frame {index}"
        if not isinstance(entry, dict):
            raise DataError(f"{where} is not an object; expected file_path and transform_matrix.")
        file_path = required(entry, "file_path", where)
        if not isinstance(file_path, str) or not file_path.strip():
            raise DataError(f"{where}: file_path is not a path; expected text such as ./train/r_0.")
        where = f"{where} ({in_line(file_path)})"
        matrix, scale = rigid_matrix(required(entry, "transform_matrix", where), where, "transform_matrix")
        merged = {**{k: v for k, v in document.items() if k != "frames"}, **entry}
        lens = read_lens(_without_overruled(merged, entry), where, distorted=photographs)
        distortion = read_distortion(merged, where) if photographs else None
        # Absolute paths of somebody else's machine are common where only the name counts.
        below = file_path if images is None else f"{images}/{PurePosixPath(file_path.replace(chr(92), '/')).name}"
        file = files.find(below)
        if file is None:
            missing.append(file_path)
            continue
        if file.path.stat().st_size == 0:
            raise DataError(f"{file.path}: the image file is empty; write it again.")
        found.append(file)
        scales.append(scale)
        mask = _mask(files, entry, file.path, where)
        masks += [] if mask is None else [mask]
        frames.append(
            Frame(
                name=file.inside.as_posix(),
                image=file.path,
                camera_to_world=matrix,
                lens=lens,
                file_path=file_path,
                distortion=distortion,
                mask=None if mask is None else mask.path,
            )
        )
    notes = left_out([in_line(name) for name in missing], len(entries), str(path), path.parent, least=least)
    kept, again = each_once(found, f"{split} frames")
    notes += [*remarks(found, f"{split} images"), *remarks(masks, "masks"), *again, *_scaled(scales, split)]
    names = view_names([found[index].inside for index in kept])
    return [replace(frames[index], name=name) for index, name in zip(kept, names, strict=True)], notes


def _scaled(scales: Sequence[float], split: str) -> list[str]:
    scaled = [scale for scale in scales if abs(scale - 1) > _RIGID_TOLERANCE]
    if not scaled:
        return []
    return [
        f"{len(scaled)} of {len(scales)} {split} cameras have a rotation scaled by {min(scaled):.3g} to "
        f"{max(scaled):.3g}: the scale is taken out, positions stay."
    ]


def with_masks(folder: Path, frames: Sequence[Frame]) -> tuple[list[Frame], list[str]]:
    """The frames with masks from files in ``folder`` where the transforms name none, and notes on those files.

    Raises DataError where masks do not fit the images' names.
    """
    masks, notes = find_masks(folder, [frame.image for frame in frames], [frame.mask for frame in frames])
    return [replace(frame, mask=mask) for frame, mask in zip(frames, masks, strict=True)], notes


def posed_images(frames: Sequence[Frame]) -> list[PosedImage]:
    """The frames with their cameras in OpenCV axes, as ``load_views`` takes them."""
    return [
        PosedImage(
            name=frame.name,
            path=frame.image,
            camera=partial(_camera, frame),
            size=_size(frame.lens),
            distortion=frame.distortion,
            mask=frame.mask,
        )
        for frame in frames
    ]


def _size(lens: Lens) -> tuple[int, int] | None:
    return None if lens.width is None or lens.height is None else (round(lens.width), round(lens.height))


def _camera(frame: Frame, width: int, height: int) -> Camera:
    pinhole = frame.lens.at_size(width, height, frame.image)
    # Rigid, so the inverse is exact to rounding; float64 throughout.
    rotation, position = (frame.camera_to_world @ _OPENGL_TO_OPENCV)[:3, :3], frame.camera_to_world[:3, 3]
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation.T
    world_to_camera[:3, 3] = -rotation.T @ position
    return pinhole.camera(torch.from_numpy(world_to_camera), width, height)


def _mask(files: NamedFiles, entry: Mapping[str, object], image: Path, where: str) -> FoundFile | None:
    value = entry.get("mask_path")
    if value is None:
        return None
    if not isinstance(value, str) or not value.strip():
        raise DataError(f"{where}: mask_path is not a path; expected text such as ./masks/r_0.png.")
    found = files.find(value, MASK_FOLDERS[0])
    # The end of a mask's path may be that of its image.
    if found is None or found.path == image:
        raise DataError(
            f"{where}: there is no mask {in_line(value)} in {files.folder}; leave mask_path out where there is none."
        )
    return found


def _without_overruled(merged: Mapping[str, object], entry: Mapping[str, object]) -> dict[str, object]:
    """A frame's own angle overrules the file's focal length, and the other way round."""
    overruled: set[str] = set()
    if any(key.startswith("camera_angle") for key in entry):
        overruled |= {key for key in LENS_KEYS if key.startswith("fl_") and key not in entry}
    if any(key.startswith("fl_") for key in entry):
        overruled |= {key for key in LENS_KEYS if key.startswith("camera_angle") and key not in entry}
    return {key: value for key, value in merged.items() if key not in overruled}


def rigid_matrix(value: object, where: str, key: str) -> tuple[Float64[np.ndarray, "4 4"], float]:
    """A rigid matrix, given as 3 or 4 rows under ``key``, and the uniform scale that was taken out of its rotation.

    Raises DataError where it is no rotation with a position.
    """
    rows = value if isinstance(value, list) else []
    if len(rows) not in (3, 4) or not all(isinstance(row, list) and len(row) == 4 for row in rows):
        raise DataError(f"{where}: {key} is not 4 rows of 4 numbers.")
    matrix = np.eye(4)
    for r, row in enumerate(rows):
        for c, item in enumerate(row):
            matrix[r, c] = number(item, f"{where}: {key}[{r}][{c}]")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > _RIGID_TOLERANCE:
        raise DataError(f"{where}: the last row of {key} is {matrix[3].tolist()}; expected 0 0 0 1.")
    largest = np.abs(matrix).max()
    if largest > _FARTHEST:
        raise DataError(f"{where}: {key} holds {largest:.3g}; expected a camera near the object.")
    left, sizes, right = np.linalg.svd(matrix[:3, :3])
    if sizes[2] <= 1e-9 * max(sizes[0], 1e-300) or sizes[0] < 1e-9:
        raise DataError(f"{where}: {key} is singular; expected a rotation and a position.")
    if np.linalg.det(matrix[:3, :3]) < 0:
        raise DataError(f"{where}: {key} mirrors (determinant below 0); expected right-handed axes.")
    scale = float(np.exp(np.log(sizes).mean()))
    if np.abs(sizes / scale - 1).max() > _RIGID_TOLERANCE:
        raise DataError(
            f"{where}: {key} stretches its axes by {sizes[0]:.3g}, {sizes[1]:.3g}, {sizes[2]:.3g}; "
            "expected a rotation and a position."
        )
    matrix[:3, :3] = left @ right
    matrix[3] = (0, 0, 0, 1)
    return matrix, scale
