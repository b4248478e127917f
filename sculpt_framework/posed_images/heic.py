"""HEIC, the format of iPhones: read with pillow-heif, which the extra ``heic`` brings; and files that others read."""

from io import BytesIO
from pathlib import Path
from types import ModuleType

import numpy as np
from PIL import Image

from sculpt_framework.errors import DataError

_HEIC = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs")
_EITHER = (b"mif1", b"msf1")
"""Brands of the container, whatever codec is in it."""
_QUALITY = 95
CONVERSIONS = (".jpg", ".png")
"""Suffixes of what ``converted`` makes."""


def is_heic(data: bytes) -> bool:
    """By the first bytes; AVIF, which has the same container, is not."""
    brand, others = data[8:12], data[16:64]
    return data[4:8] == b"ftyp" and (brand in _HEIC or (brand in _EITHER and b"avif" not in others))


def heic_size(path: Path) -> tuple[int, int] | None:
    """Width and height as the image is decoded, upright; None for another format, or where it cannot be read."""
    try:
        with open(path, "rb") as file:
            if not is_heic(file.read(64)):
                return None
        return _reader(path).open_heif(path).size
    except (OSError, ValueError, EOFError, RuntimeError, DataError):
        return None


def read_heic(data: bytes, path: Path) -> tuple[np.ndarray | None, tuple[int, int]]:
    """Pixels in OpenCV's order of channels, turned upright as the file says, None if damaged; and width and height.

    Raises DataError where pillow-heif is not installed.
    """
    reader = _reader(path)
    try:
        image = reader.read_heif(data)
        pixels = np.asarray(image)
    except (OSError, ValueError, EOFError, RuntimeError):
        return None, (0, 0)
    if pixels.ndim == 3:
        pixels = pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]
    return np.ascontiguousarray(pixels), (pixels.shape[1], pixels.shape[0])


def converted(path: Path) -> tuple[str, bytes]:
    """The image, HEIC or whatever Pillow reads, as a JPEG file, or as a PNG where it has alpha; and the suffix of that.

    EXIF goes with it; HEIC is turned upright. Raises DataError where it cannot be read.
    """
    try:
        with open(path, "rb") as file:
            heic = is_heic(file.read(64))
        image = _reader(path).open_heif(path).to_pillow() if heic else Image.open(path)
        exif = (image.info.get("exif") or b"") if heic else image.getexif()
        if image.has_transparency_data:
            png = BytesIO()
            image.convert("RGBA").save(png, "PNG", exif=exif)
            return ".png", png.getvalue()
        jpeg = BytesIO()
        image.convert("RGB").save(jpeg, "JPEG", quality=_QUALITY, subsampling=0, exif=exif)
    except (OSError, ValueError, EOFError, RuntimeError, SyntaxError, Image.DecompressionBombError) as error:
        raise DataError(f"{path}: cannot be read as an image ({error}); remove it, or convert it again.") from error
    return ".jpg", jpeg.getvalue()


def _reader(path: Path) -> ModuleType:
    try:
        import pillow_heif
    except ImportError:
        raise DataError(
            f"{path}: HEIC is read with the extra heic: pip install 'gaussian-sculpting[heic]'; or convert the images "
            "to JPEG."
        ) from None
    return pillow_heif
