"""A folder of photographs without cameras: which files, of which camera, and what EXIF says of its focal length."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.decoding import read_image
from sculpt_framework.posed_images.headers import (
    ImageHeader,
    exif_of,
    exif_settings,
    heads_alone,
    positive,
    read_headers,
)
from sculpt_framework.posing.source import find_photographs

_MODEL, _FOCAL, _FOCAL_35 = 272, 37386, 41989
"""EXIF tags: the camera's name, and in the table of settings the focal length, and the same on 35 mm film."""
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
    mask: Path | None
    """The file of its mask."""


def list_photographs(folder: str) -> list[Photograph]:
    """By name. Raises DataError where the folder holds fewer than three, or one that cannot be read."""
    found = find_photographs(Path(folder))
    headers = read_headers(found.paths)
    with heads_alone():
        return [
            _photograph(found.root, name, header, mask)
            for name, header, mask in zip(found.names, headers, found.masks, strict=True)
        ]


def read_grey(photograph: Photograph) -> UInt8[np.ndarray, "h w"]:
    """The stored pixels. Raises DataError for a file that is damaged."""
    grey = cv2.cvtColor(read_image(photograph.path).rgb, cv2.COLOR_RGB2GRAY)
    return np.rint(grey * 255).astype(np.uint8)


def _photograph(root: Path, name: str, header: ImageHeader | None, mask: Path | None) -> Photograph:
    path = root / name
    if header is None:
        raise DataError(f"{path}: cannot be read as an image; remove it or write it again.")
    model, settings = _exif(path)
    length, film = positive(settings.get(_FOCAL)), positive(settings.get(_FOCAL_35))
    width, height = header.width, header.height
    return Photograph(
        path=path,
        name=name,
        width=width,
        height=height,
        camera=f"{model} {width}x{height}" + ("" if length is None else f" {length:g} mm"),
        focal=None if film is None else film / _DIAGONAL_35 * math.hypot(width, height),
        mask=mask,
    )


def _exif(path: Path) -> tuple[str, Mapping[int, object]]:
    """The camera's name and its settings; HEIC's are not looked for, its lens is calibrated on the board."""
    try:
        with Image.open(path) as image:
            return str(exif_of(image).get(_MODEL, "camera")), exif_settings(image)
    except (OSError, ValueError, SyntaxError):
        return "camera", {}
