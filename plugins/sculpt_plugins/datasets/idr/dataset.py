"""A folder with cameras.npz, image/ and mask/, read whole."""

from functools import partial
from pathlib import Path

import numpy as np
import torch

from sculpt_framework.datasets import Dataset
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.clues import Clues
from sculpt_framework.posed_images.folders import contents, scene_folder
from sculpt_framework.posed_images.masks import EXTENSIONS, MASK_FOLDERS
from sculpt_framework.posed_images.photographs import hold_out, load_photographs
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
        images = self._files(IMAGE_FOLDERS, "images")
        masks = self._files(MASK_FOLDERS, "masks") if self._has(MASK_FOLDERS) else []
        # Files and matrices are matched by their order, as the names of images and masks need not agree.
        if masks and len(masks) != len(images):
            raise DataError(
                f"{self.folder}: {len(images)} images and {len(masks)} masks; expected a mask for each image."
            )
        posed = []
        for index, image in enumerate(images):
            name = f"world_mat_{index}"
            if name not in matrices:
                there = sum(key.startswith("world_mat") for key in matrices)
                raise DataError(f"{path}: no {name}; {len(images)} images need as many matrices, found {there}.")
            placed = placed_camera(matrices[name], f"{path}: {name}")
            mask = masks[index] if masks else None
            posed.append(PosedImage(name=image.stem, path=image, camera=partial(_camera, placed), mask=mask))
        train, test, note = hold_out(posed, self.config.test_every, str(path))
        clues = Clues(points=np.zeros((0, 3)), box=ball_box(matrices, path), box_name="the ball of scale_mat_0")
        reference = self.folder / "gt_mesh.ply"
        return load_photographs(
            self.folder.resolve().name,
            train,
            test,
            self.config,
            clues,
            notes=[note],
            reference=reference if reference.is_file() else None,
        )

    def _has(self, names: tuple[str, ...]) -> bool:
        return any((self.folder / name).is_dir() for name in names)

    def _files(self, names: tuple[str, ...], what: str) -> list[Path]:
        folder = next((self.folder / name for name in names if (self.folder / name).is_dir()), None)
        if folder is None:
            raise DataError(f"{self.folder}: no folder {names[0]}/ of {what}; found {contents(self.folder)}.")
        files = sorted(path for path in folder.iterdir() if path.suffix in EXTENSIONS and path.is_file())
        if not files:
            raise DataError(f"{folder}: no {what} in it; found {contents(folder)}.")
        empty = next((path for path in files if path.stat().st_size == 0), None)
        if empty is not None:
            raise DataError(f"{empty}: the image file is empty; write it again.")
        return files


def _camera(placed: PlacedCamera, width: int, height: int) -> Camera:
    return placed.pinhole.camera(torch.from_numpy(placed.world_to_camera), width, height)
