"""A folder of photographs with a sparse model, read whole."""

from functools import partial
from pathlib import Path

import numpy as np
import torch

from sculpt_framework.datasets import Dataset
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.clues import Clues
from sculpt_framework.posed_images.folders import contents, scene_folder
from sculpt_framework.posed_images.lens import Pinhole
from sculpt_framework.posed_images.masks import find_masks
from sculpt_framework.posed_images.photographs import hold_out, load_photographs
from sculpt_framework.posed_images.views import PosedImage
from sculpt_framework.types import Camera, Scene
from sculpt_plugins.datasets.colmap import binary, text
from sculpt_plugins.datasets.colmap.config import ColmapConfig
from sculpt_plugins.datasets.colmap.lenses import lens_of
from sculpt_plugins.datasets.colmap.model import SparseCamera, SparseImage, SparseModel, find_model

_ASPECT_TOLERANCE = 0.01


class ColmapDataset(Dataset):
    """The world is the frame of the sparse model."""

    def __init__(self, config: ColmapConfig, data: str):
        """Raises DataError where there is no such folder."""
        self.config = config
        self.folder = scene_folder(data)

    def load(self) -> Scene:
        """Everything that can be checked without decoding an image is checked first."""
        place = find_model(self.folder, self.config.model)
        model = read_model(place)
        pictures = self.folder / self.config.images
        if not pictures.is_dir():
            raise DataError(
                f"{self.folder}: no folder {self.config.images}/ of photographs; found {contents(self.folder)}; name "
                "it with --dataset colmap --dataset.images FOLDER."
            )
        images = sorted(model.images, key=lambda image: image.name)
        there = [image for image in images if (pictures / image.name).is_file()]
        if not there:
            raise DataError(
                f"{pictures}: none of the {len(images)} images of {place} is here, such as {images[0].name}; found "
                f"{contents(pictures)}."
            )
        masks = find_masks(self.folder, [image.name for image in there])
        posed = [_posed(model, image, pictures, mask, place) for image, mask in zip(there, masks, strict=True)]
        train, test, note = hold_out(posed, self.config.test_every, str(place))
        notes = [note]
        if len(there) < len(images):
            missing = next(image.name for image in images if image not in there)
            notes.append(f"{len(images) - len(there)} of {len(images)} images of the model are not there ({missing}).")
        unposed = sum(path.is_file() for path in pictures.rglob("*")) - len(there)
        if unposed > 0:
            notes.append(f"{unposed} files in {pictures.name}/ have no camera in the model and are not used.")
        clues = Clues(points=model.points)
        return load_photographs(self.folder.resolve().name, train, test, self.config, clues, notes=notes)


def read_model(folder: Path) -> SparseModel:
    """The model in a folder, binary where both are there. Raises DataError where it is damaged or empty."""
    end, reader = (".bin", binary) if (folder / "cameras.bin").is_file() else (".txt", text)
    cameras = reader.read_cameras(folder / f"cameras{end}")
    images = reader.read_images(folder / f"images{end}")
    if not images:
        raise DataError(f"{folder / f'images{end}'}: holds no image; COLMAP could not place any.")
    for image in images:
        if image.camera not in cameras:
            raise DataError(f"{folder}: {image.name} names camera {image.camera}, which cameras{end} does not have.")
    place = folder / f"points3D{end}"
    points = reader.read_points(place) if place.is_file() else np.zeros((0, 3))
    return SparseModel(cameras=cameras, images=images, points=points)


def _posed(model: SparseModel, image: SparseImage, pictures: Path, mask: Path | None, where: Path) -> PosedImage:
    camera = model.cameras[image.camera]
    pinhole, distortion = lens_of(camera.model, camera.values, f"{where}: camera {image.camera}")
    path = pictures / image.name
    if ".." in Path(image.name).parts or Path(image.name).is_absolute():
        raise DataError(f"{where}: the image name {image.name} leaves the folder of photographs.")
    if path.stat().st_size == 0:
        raise DataError(f"{path}: the image file is empty; write it again.")
    return PosedImage(
        name=str(Path(image.name).with_suffix("")),
        path=path,
        camera=partial(_camera, image, camera, pinhole, path),
        size=(camera.width, camera.height),
        distortion=distortion,
        mask=mask,
    )


def _camera(image: SparseImage, camera: SparseCamera, pinhole: Pinhole, path: Path, width: int, height: int) -> Camera:
    if abs(width / height * camera.height / camera.width - 1) > _ASPECT_TOLERANCE:
        raise DataError(
            f"{path}: the image is {width}x{height}, its camera in the model {camera.width}x{camera.height}; expected "
            "the same size or the same shape."
        )
    whole = pinhole.camera(torch.from_numpy(image.world_to_camera), camera.width, camera.height)
    return whole.resized(width, height)
