"""A folder of photographs without cameras: which files, of which camera, and what EXIF says of its focal length."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.decoding import read_image
from sculpt_framework.posed_images.headers import ImageHeader, read_headers
from sculpt_framework.posing.source import find_photographs

_MODEL, _EXIF, _FOCAL, _FOCAL_35 = 272, 0x8769, 37386, 41989
"""EXIF tags: the camera's name, the table of settings, and in it the focal length, and the same on 35 mm film."""
_DIAGONAL_35 = math.hypot(36, 24)


@dataclass(frozen=True, kw_only=True)
class Photograph:
    path: Path
    name: str
    """Its path below the folder of the photographs."""
    width: int
    """Of the stored pixels: cameras are those of these, whatever the orientation in EXIF."""
    height: int
    camera: str
    """What tells photographs of one camera at one zoom from others."""
    focal: float | None
    """In pixels, by EXIF; None where it does not say."""


def list_photographs(folder: str) -> list[Photograph]:
    """By name. Raises DataError where the folder holds fewer than three, or one that cannot be read."""
    found = find_photographs(Path(folder))
    headers = read_headers(found.paths)
    with warnings.catch_warnings():
        # Of EXIF that is cut off, and of very large images.
        warnings.simplefilter("ignore")
        return [_photograph(found.root, name, header) for name, header in zip(found.names, headers, strict=True)]


def read_grey(photograph: Photograph) -> UInt8[np.ndarray, "h w"]:
    """The stored pixels. Raises DataError for a file that is damaged."""
    grey = cv2.cvtColor(read_image(photograph.path).rgb, cv2.COLOR_RGB2GRAY)
    return np.rint(grey * 255).astype(np.uint8)


def _photograph(root: Path, name: str, header: ImageHeader | None) -> Photograph:
    path = root / name
    if header is None:
        raise DataError(f"{path}: cannot be read as an image; remove it or write it again.")
    model, settings = _exif(path)
    length, film = _positive(settings.get(_FOCAL)), _positive(settings.get(_FOCAL_35))
    width, height = header.width, header.height
    return Photograph(
        path=path,
        name=name,
        width=width,
        height=height,
        camera=f"{model} {width}x{height}" + ("" if length is None else f" {length:g} mm"),
        focal=None if film is None else film / _DIAGONAL_35 * math.hypot(width, height),
    )


def _exif(path: Path) -> tuple[str, Mapping[int, object]]:
    """The camera's name and its settings; HEIC's are not looked for, its lens is calibrated on the board."""
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            return str(exif.get(_MODEL, "camera")), exif.get_ifd(_EXIF)
    except (OSError, ValueError, SyntaxError):
        return "camera", {}


def _positive(value: object) -> float | None:
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < math.inf else None
