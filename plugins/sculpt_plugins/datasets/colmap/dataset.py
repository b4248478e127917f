"""A folder of photographs with a sparse model, read whole."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import torch

from sculpt_framework.datasets import Dataset
from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.clues import Clues
from sculpt_framework.posed_images.folders import contents, scene_folder
from sculpt_framework.posed_images.image_files import (
    FoundFile,
    NamedFiles,
    each_once,
    is_image_name,
    left_out,
    remarks,
    view_names,
)
from sculpt_framework.posed_images.lens import ASPECT_TOLERANCE, Pinhole
from sculpt_framework.posed_images.masks import find_masks
from sculpt_framework.posed_images.photographs import hold_out, load_photographs
from sculpt_framework.posed_images.reading import in_line, in_short
from sculpt_framework.posed_images.sparse_points import NO_POINTS, Points, read_ply_points, usable
from sculpt_framework.posed_images.views import PosedImage
from sculpt_framework.types import Camera, Scene
from sculpt_plugins.datasets.colmap import binary, text
from sculpt_plugins.datasets.colmap.config import ColmapConfig
from sculpt_plugins.datasets.colmap.lenses import lens_of
from sculpt_plugins.datasets.colmap.model import SparseCamera, SparseImage, SparseModel, find_model


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
        images = sorted(model.images, key=lambda image: image.name)
        pictures, asked = self._pictures(images, place)
        there = [(image, file) for image, file in zip(images, asked, strict=True) if file is not None]
        missing = [in_line(image.name) for image, file in zip(images, asked, strict=True) if file is None]
        found = [file for _, file in there]
        notes = left_out(missing, len(images), str(place), pictures)
        kept, again = each_once(found, "images of the model")
        there = [there[index] for index in kept]
        notes += [*remarks(found, "images of the model"), *again, *model.notes]
        masks, said = find_masks(self.folder, [file.path for _, file in there])
        names = view_names([file.inside for _, file in there])
        posed = [
            _posed(model, image, file.path, name, mask, place)
            for (image, file), name, mask in zip(there, names, masks, strict=True)
        ]
        train, test, note = hold_out(posed, self.config.test_every, str(place))
        notes = [note, *notes, *said, *_without_camera(pictures, self.folder, [file.path for _, file in there], masks)]
        clues = Clues(points=model.points)
        return load_photographs(self.folder.resolve().name, train, test, self.config, clues, notes=notes)

    def _pictures(self, images: Sequence[SparseImage], place: Path) -> tuple[Path, list[FoundFile | None]]:
        """The folder of the photographs, and the file of each image there, None where there is none."""
        given = self.config.images
        # Some programs put the photographs beside the model; a folder that was named is the only one that counts.
        names = [given] if given != ColmapConfig.images else [given, "image", "."]
        folders = [self.folder / name for name in names]
        if given == ColmapConfig.images and place not in folders:
            folders.append(place)
        there = [folder for folder in folders if folder.is_dir()]
        for folder in there:
            files = NamedFiles(folder)
            found = [files.find(image.name) for image in images]
            if any(found):
                return folder, found
        if not there or (there[0] != folders[0]):
            raise DataError(
                f"{self.folder}: no folder {given}/ of photographs; found {contents(self.folder)}; name it with "
                "--dataset colmap --dataset.images FOLDER."
            )
        raise DataError(
            f"{there[0]}: none of the {len(images)} images of {place} is here, such as {in_line(images[0].name)}; "
            f"found {contents(there[0])}."
        )


def _without_camera(pictures: Path, root: Path, used: Sequence[Path], masks: Sequence[Path | None]) -> list[str]:
    """The note on photographs that the model does not know, and on masks beside the photographs that are of none."""
    # The data folder itself holds other folders than those of photographs.
    listed = pictures.iterdir() if pictures.resolve() == root.resolve() else pictures.rglob("*")
    known = {path.resolve() for path in (*used, *masks) if path is not None}
    files = sorted(path for path in listed if is_image_name(path.name) and path.is_file())
    others = [path.relative_to(pictures).as_posix() for path in files if path.resolve() not in known]
    if not others:
        return []
    return [
        f"{len(others)} files in {pictures.name}/ have no camera in the model and are not used ({in_short(others)})."
    ]


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
    points, notes = _points(folder, end, reader.read_points)
    return SparseModel(cameras=cameras, images=images, points=points, notes=tuple(notes))


def _points(folder: Path, end: str, read: Callable[[Path], Points]) -> tuple[Points, list[str]]:
    """Of the model's own file, or else of the PLY that other programs leave in its place."""
    own, notes = folder / f"points3D{end}", []
    if own.is_file():
        points, notes = usable(read(own) if own.stat().st_size else NO_POINTS, own.name)
        if len(points):
            return points, notes
    ply = NamedFiles(folder).find("points3D.ply")
    if ply is not None:
        points, said = usable(read_ply_points(ply.path), ply.path.name)
        return points, [*notes, f"the sparse points are those of {ply.path.name}.", *said]
    return NO_POINTS, notes or [f"there is no {own.name} beside the cameras: no sparse points say where the object is."]


def _posed(model: SparseModel, image: SparseImage, path: Path, name: str, mask: Path | None, where: Path) -> PosedImage:
    camera = model.cameras[image.camera]
    pinhole, distortion = lens_of(camera.model, camera.values, f"{where}: camera {image.camera}")
    if path.stat().st_size == 0:
        raise DataError(f"{path}: the image file is empty; write it again.")
    return PosedImage(
        name=name,
        path=path,
        camera=partial(_camera, image, camera, pinhole, path),
        size=(camera.width, camera.height),
        distortion=distortion,
        mask=mask,
    )


def _camera(image: SparseImage, camera: SparseCamera, pinhole: Pinhole, path: Path, width: int, height: int) -> Camera:
    if abs(width / height * camera.height / camera.width - 1) > ASPECT_TOLERANCE:
        raise DataError(
            f"{path}: the image is {width}x{height}, its camera in the model {camera.width}x{camera.height}; expected "
            "the same size or the same shape."
        )
    whole = pinhole.camera(torch.from_numpy(image.world_to_camera), camera.width, camera.height)
    return whole.resized(width, height)
