"""A folder with transforms.json, read whole."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float64

from sculpt_framework.datasets import Dataset
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.clues import Clues
from sculpt_framework.posed_images.folders import contents, scene_folder
from sculpt_framework.posed_images.image_files import NamedFiles, remarks
from sculpt_framework.posed_images.photographs import hold_out, load_photographs
from sculpt_framework.posed_images.reading import in_line, in_short, number, read_json
from sculpt_framework.posed_images.sparse_points import NO_POINTS, Points, read_ply_points, usable
from sculpt_framework.posed_images.transforms import Frame, posed_images, read_frames, rigid_matrix, with_masks
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.nerfstudio.config import NerfstudioConfig

NAME = "transforms.json"


class NerfstudioDataset(Dataset):
    """The world is the frame of the file's matrices; with ``original_frame`` the one before its applied_transform."""

    def __init__(self, config: NerfstudioConfig, data: str):
        """Raises DataError where there is no such folder."""
        self.config = config
        self.folder = scene_folder(data)

    def load(self) -> Scene:
        """Everything that can be checked without decoding an image is checked first."""
        path = self.folder / NAME
        if not path.is_file():
            raise DataError(f"{self.folder}: no {NAME}; found {contents(self.folder)}.")
        frames, notes = read_frames(path, "photographed", photographs=True)
        document = read_json(path)
        points, said = _points(self.folder, document, path)
        notes += said
        applied, scale = _applied(document, path)
        if self.config.original_frame:
            frames = [_before(frame, applied, scale) for frame in frames]
            points = (points / scale - applied[:3, 3]) @ applied[:3, :3]
        elif not (np.allclose(applied, np.eye(4)) and scale == 1):
            notes.append("the mesh will be in the frame of the file's matrices; --dataset.original-frame undoes them.")
        frames, said = with_masks(self.folder, frames)
        notes += said
        train, test, note = self._split(frames, document, path)
        reference = self.folder / "gt_mesh.ply"
        return load_photographs(
            self.folder.resolve().name,
            posed_images(train),
            posed_images(test),
            self.config,
            Clues(points=points),
            notes=[*notes, note],
            reference=reference if reference.is_file() else None,
        )

    def _split(
        self, frames: Sequence[Frame], document: Mapping[str, object], path: Path
    ) -> tuple[list[Frame], list[Frame], str]:
        named = {split: _names(document, f"{split}_filenames", path) for split in ("train", "val", "test")}
        held_out = named["test"] or named["val"]
        if self.config.test_every or not held_out:
            return hold_out(frames, self.config.test_every, str(path))
        test = [frame for frame in frames if _plain(frame.file_path) in held_out]
        train = [frame for frame in frames if _plain(frame.file_path) in named["train"]]
        if not named["train"]:
            train = [frame for frame in frames if _plain(frame.file_path) not in held_out]
        if not train:
            raise DataError(f"{path}: train_filenames names none of the {len(frames)} frames.")
        note = f"{len(train)} train and {len(test)} test views, as the file's lists say"
        there = {_plain(frame.file_path) for frame in frames}
        strange = sorted((named["train"] | held_out) - there)
        if strange:
            note += f"; {len(strange)} of the names in them are of no frame ({in_short([in_line(n) for n in strange])})"
        neither = sorted(there - named["train"] - held_out) if named["train"] else []
        if neither:
            note += f"; {len(neither)} frames are in none of them and are not used ({in_short(neither)})"
        return train, test, f"{note}."


def _names(document: Mapping[str, object], key: str, path: Path) -> frozenset[str]:
    value = document.get(key, [])
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise DataError(f"{path}: {key} is not a list of file names.")
    return frozenset(_plain(name) for name in value)


def _plain(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).as_posix()


def _applied(document: Mapping[str, object], path: Path) -> tuple[Float64[np.ndarray, "4 4"], float]:
    """What the file says was done to its poses: x = scale * (matrix x_original)."""
    matrix = np.eye(4)
    if document.get("applied_transform") is not None:
        matrix, stretch = rigid_matrix(document["applied_transform"], str(path), "applied_transform")
        if abs(stretch - 1) > 1e-6:
            raise DataError(f"{path}: applied_transform scales by {stretch:.3g}; expected that in applied_scale.")
    scale = 1.0
    if document.get("applied_scale") is not None:
        scale = number(document["applied_scale"], f"{path}: applied_scale")
    if not scale > 0:
        raise DataError(f"{path}: applied_scale is {scale:g}; expected more than 0.")
    return matrix, scale


def _before(frame: Frame, applied: Float64[np.ndarray, "4 4"], scale: float) -> Frame:
    pose = frame.camera_to_world.copy()
    pose[:3, 3] /= scale
    return replace(frame, camera_to_world=np.linalg.inv(applied) @ pose)


def _points(folder: Path, document: Mapping[str, object], path: Path) -> tuple[Points, list[str]]:
    """The sparse points the file names, in the frame of its matrices."""
    name = document.get("ply_file_path")
    if name is None:
        return NO_POINTS, []
    if not isinstance(name, str) or not name.strip():
        raise DataError(f"{path}: ply_file_path is not a path.")
    file = NamedFiles(folder).find(name)
    if file is None:
        return NO_POINTS, [f"the points {in_line(name)} that {path.name} names are not there."]
    points, notes = usable(read_ply_points(file.path), file.inside.as_posix())
    return points, [*remarks([file], "files of points"), *notes]
