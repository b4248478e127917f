"""Size, orientation and EXIF of image files without decoding them."""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from sculpt_framework.posed_images.heic import heic_size

_ORIENTATION, _SETTINGS = 274, 0x8769
"""EXIF tags: the turn, and the table of settings."""


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """What a file says of itself; ``width`` and ``height`` are those of the stored pixels, not yet turned upright."""

    width: int
    height: int
    orientation: int
    """EXIF: 1 upright; 2 to 8 mirrored, turned or both."""

    @property
    def upright_size(self) -> tuple[int, int]:
        """Width and height after the turn that the orientation asks for."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)


@contextmanager
def heads_alone() -> Iterator[None]:
    """Pillow neither refuses nor warns of very large images, nor warns of damaged ones: their pixels are not read here,
    and phones take 200 million. Not from several threads at once."""
    most = Image.MAX_IMAGE_PIXELS
    Image.MAX_IMAGE_PIXELS = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        Image.MAX_IMAGE_PIXELS = most


def exif_of(image: Image.Image) -> Image.Exif:
    """Without decoding pixels, which Pillow does for PNG files that have no EXIF in front of them."""
    return Image.Exif() if image.format == "PNG" and "exif" not in image.info else image.getexif()


def exif_settings(image: Image.Image) -> Mapping[int, object]:
    """EXIF's table of the camera's settings, empty where there is none."""
    return exif_of(image).get_ifd(_SETTINGS)


def positive(value: object) -> float | None:
    """A number of EXIF; None where it is none, or not above 0: cameras without electronics in the lens write 0/0."""
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < math.inf else None


def read_headers(paths: Sequence[Path]) -> list[ImageHeader | None]:
    """One for each file; None for a file that cannot be opened, which decoding will explain.

    Not from several threads at once.
    """
    with heads_alone():
        return [_read(path) for path in paths]


def _read(path: Path) -> ImageHeader | None:
    upright = heic_size(path)
    if upright is not None:
        return ImageHeader(width=upright[0], height=upright[1], orientation=1)
    try:
        with Image.open(path) as image:
            orientation = exif_of(image).get(_ORIENTATION, 1)
            width, height = image.size
    except (OSError, ValueError, SyntaxError):
        return None
    valid = isinstance(orientation, int) and 1 <= orientation <= 8
    return ImageHeader(width=width, height=height, orientation=orientation if valid else 1)
