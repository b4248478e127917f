"""cameras.bin, images.bin and points3D.bin: little endian, a count of 64 bits, then that many records."""

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sculpt_framework.errors import DataError
from sculpt_plugins.datasets.colmap.lenses import model_of
from sculpt_plugins.datasets.colmap.model import SparseCamera, SparseImage, checked_camera, pose

_LONGEST_NAME = 4096


class _Records:
    """A file read from front to back."""

    def __init__(self, path: Path):
        """Raises DataError where the file cannot be read."""
        self.path = path
        self.at = 0
        try:
            self.data = path.read_bytes()
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror}).") from None

    def take(self, layout: str) -> tuple:
        size = struct.calcsize(layout)
        self.skip(size)
        return struct.unpack_from(layout, self.data, self.at - size)

    def skip(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise DataError(f"{self.path}: the file is cut off at byte {len(self.data)}; copy or write it again.")
        self.at += size

    def count(self, least: int, what: str) -> int:
        """How many records of at least ``least`` bytes follow."""
        (number,) = self.take("<Q")
        if number * least > len(self.data) - self.at:
            raise DataError(
                f"{self.path}: announces {number} {what}, more than it holds; the file is cut off or damaged."
            )
        return number

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            raise DataError(f"{self.path}: the name of an image has no end; the file is damaged.")
        raw, self.at = self.data[self.at : end], end + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError:
            raise DataError(f"{self.path}: the name of an image is not text; the file is damaged.") from None

    def finish(self) -> None:
        if self.at != len(self.data):
            raise DataError(f"{self.path}: {len(self.data) - self.at} bytes too many; the file is damaged.")


def read_cameras(path: Path) -> dict[int, SparseCamera]:
    """Raises DataError where the file is damaged or holds a camera of no use."""
    records, cameras = _Records(path), {}
    for _ in range(records.count(24, "cameras")):
        number, kind, width, height = records.take("<iiQQ")
        where = f"{path}: camera {number}"
        model = model_of(kind, where)
        if number in cameras:
            raise DataError(f"{where}: there is another camera of that number; expected numbers of their own.")
        cameras[number] = checked_camera(model, width, height, records.take(f"<{model.parameters}d"), where)
    records.finish()
    return cameras


def read_images(path: Path) -> list[SparseImage]:
    """Raises DataError where the file is damaged or holds a pose that is none."""
    records, images = _Records(path), []
    numbers: dict[int, str] = {}
    for _ in range(records.count(73, "images")):
        number, *values = records.take("<i7d")
        (camera,) = records.take("<i")
        name = records.name()
        records.skip(24 * records.count(24, "observations"))
        if numbers.setdefault(number, name) != name:
            raise DataError(f"{path}: image {number} is {name} and {numbers[number]}; the file is damaged.")
        images.append(SparseImage(name=name, camera=camera, world_to_camera=pose(values, f"{path}: {name}")))
    records.finish()
    return images


def read_points(path: Path) -> Float64[np.ndarray, "n 3"]:
    """Positions, which may be not finite. Raises DataError where the file is damaged."""
    records = _Records(path)
    number = records.count(51, "points")
    points = np.zeros((number, 3))
    for index in range(number):
        points[index] = records.take("<Q3d3Bd")[1:4]
        records.skip(8 * records.count(8, "observations"))
    records.finish()
    return points
