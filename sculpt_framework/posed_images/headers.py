"""Size and orientation of image files without decoding them."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from sculpt_framework.posed_images.heic import heic_size

_ORIENTATION = 274
"""The EXIF tag."""


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


def read_headers(paths: Sequence[Path]) -> list[ImageHeader | None]:
    """One for each file; None for a file that cannot be opened, which decoding will explain.

    Not from several threads at once: warnings, of very large images and damaged ones, are turned off meanwhile.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [_read(path) for path in paths]


def _read(path: Path) -> ImageHeader | None:
    upright = heic_size(path)
    if upright is not None:
        return ImageHeader(width=upright[0], height=upright[1], orientation=1)
    try:
        with Image.open(path) as image:
            orientation = image.getexif().get(_ORIENTATION, 1)
            width, height = image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None
    valid = isinstance(orientation, int) and 1 <= orientation <= 8
    return ImageHeader(width=width, height=height, orientation=orientation if valid else 1)
