"""A folder with cameras.npz, image/ and mask/, read whole."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np
import torch
from jaxtyping import Float64

from sculpt_framework.datasets import Dataset
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.clues import Clues
from sculpt_framework.posed_images.folders import contents, scene_folder
from sculpt_framework.posed_images.image_files import is_image_name, left_out, view_names
from sculpt_framework.posed_images.masks import find_masks, mask_folders, without_masks
from sculpt_framework.posed_images.photographs import hold_out, load_photographs
from sculpt_framework.posed_images.sparse_points import NO_POINTS
from sculpt_framework.posed_images.views import PosedImage
from sculpt_framework.types import Camera, Scene
from sculpt_plugins.datasets.idr.cameras import NAMES, PlacedCamera, ball_box, placed_camera, read_matrices
from sculpt_plugins.datasets.idr.config import IdrConfig

IMAGE_FOLDERS = ("image", "images", "rgb")


class IdrDataset(Dataset):
    """The world is the frame that ``world_mat`` maps from: not the unit ball, but where that ball is."""

    def __init__(self, config: IdrConfig, data: str):
        """Raises DataError where there is no such folder."""
        self.config = config
        self.folder = scene_folder(data)

    def load(self) -> Scene:
        """Everything that can be checked without decoding an image is checked first."""
        path = next((self.folder / name for name in NAMES if (self.folder / name).is_file()), None)
        if path is None:
            raise DataError(f"{self.folder}: no {' or '.join(NAMES[:2])}; found {contents(self.folder)}.")
        matrices = read_matrices(path)
        images = without_masks(self._images())
        placed, notes = _placed(images, matrices, path)
        masks, said = self._masks(images)
        names = view_names([PurePosixPath(image.name) for image in images])
        posed = [
            PosedImage(name=name, path=image, camera=partial(_camera, camera), mask=mask)
            for name, image, camera, mask in zip(names, images, placed, masks, strict=True)
        ]
        train, test, note = hold_out(posed, self.config.test_every, str(path))
        clues = Clues(points=NO_POINTS, box=ball_box(matrices, path), box_name="the ball of scale_mat_0")
        reference = self.folder / "gt_mesh.ply"
        return load_photographs(
            self.folder.resolve().name,
            train,
            test,
            self.config,
            clues,
            notes=[note, *notes, *said],
            reference=reference if reference.is_file() else None,
        )

    def _images(self) -> list[Path]:
        folder = next((self.folder / name for name in IMAGE_FOLDERS if (self.folder / name).is_dir()), None)
        if folder is None:
            raise DataError(f"{self.folder}: no folder {IMAGE_FOLDERS[0]}/ of images; found {contents(self.folder)}.")
        files = _image_files(folder)
        if not files:
            raise DataError(f"{folder}: no images in it; found {contents(folder)}.")
        empty = next((path for path in files if path.stat().st_size == 0), None)
        if empty is not None:
            raise DataError(f"{empty}: the image file is empty; write it again.")
        return files

    def _masks(self, images: Sequence[Path]) -> tuple[list[Path | None], list[str]]:
        """By their order, as names of images and masks need not agree; where there are fewer or more, by names."""
        folders = mask_folders(self.folder)
        ordered = _image_files(folders[0]) if len(folders) == 1 else []
        return find_masks(self.folder, images, ordered if len(ordered) == len(images) else ())


def _image_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if is_image_name(path.name) and path.is_file())


def _placed(
    images: Sequence[Path], matrices: Mapping[str, Float64[np.ndarray, "4 4"]], path: Path
) -> tuple[list[PlacedCamera], list[str]]:
    """The camera of each image: by the numbers that name the images, where these are those of the matrices, else by
    their order.

    Raises DataError where neither tells which matrix is whose.
    """
    there = {int(key.removeprefix("world_mat_")) for key in matrices if key.startswith("world_mat_")}
    chosen, notes = list(range(len(images))), []
    named = [int(image.stem) if image.stem.isdecimal() else -1 for image in images]
    if len(there) == len(images):
        # By the alphabet 10.png comes before 2.png.
        if set(named) == there and named != chosen:
            chosen = named
            notes = ["images and matrices are paired by their numbers, which is not the order of the images' names."]
    else:
        if not set(named) <= there or len(set(named)) != len(named):
            raise DataError(
                f"{path}: {len(images)} images need as many matrices world_mat_I, found {len(there)}; or images named "
                "by the numbers I of their matrices."
            )
        chosen = named
        missing = [f"{number}" for number in sorted(there - set(named))]
        notes = left_out(missing, len(there), str(path), images[0].parent)
    lost = next((number for number in chosen if number not in there), None)
    if lost is not None:
        raise DataError(f"{path}: no world_mat_{lost}; expected one for each of {len(images)} images, from 0 on.")
    return [placed_camera(matrices[f"world_mat_{number}"], f"{path}: world_mat_{number}") for number in chosen], notes


def _camera(placed: PlacedCamera, width: int, height: int) -> Camera:
    return placed.pinhole.camera(torch.from_numpy(placed.world_to_camera), width, height)
