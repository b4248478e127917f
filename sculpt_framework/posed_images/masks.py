"""Masks in files of their own: white where the object is."""

import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.decoding import DecodedImage, read_image

MASK_FOLDERS = ("masks", "mask", "object_mask")
EXTENSIONS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG", ".tif", ".bmp")
_ASPECT_TOLERANCE = 0.01


def has_mask_files(root: Path) -> bool:
    """Whether a folder of photographs has a folder of masks, or a ``transforms.json`` that names masks."""
    if any((root / name).is_dir() for name in MASK_FOLDERS):
        return True
    named = root / "transforms.json"
    return named.is_file() and re.search(rb'"mask_path"\s*:\s*"', named.read_bytes()) is not None


def find_masks(root: Path, names: Sequence[str]) -> list[Path | None]:
    """The mask of each image in a folder of masks below ``root``; None where there is none.

    ``names`` are paths relative to the folder of images, with their extension. A mask of ``a/b.jpg`` is ``a/b.png`` or
    ``a/b.jpg.png``, or another image format; a mask may also lie at the top, as ``b.png``. Raises DataError where
    there are masks but none is named after an image.
    """
    folder = next((root / name for name in MASK_FOLDERS if (root / name).is_dir()), None)
    if folder is None:
        return [None] * len(names)
    found = [_find(folder, name) for name in names]
    files = sorted(path.name for path in folder.rglob("*") if path.suffix in EXTENSIONS)
    if files and not any(found):
        raise DataError(
            f"{folder}: holds {len(files)} masks ({files[0]}, ...), none named after an image; expected names such as "
            f"{Path(names[0]).with_suffix('.png').name}."
        )
    return found


def _find(folder: Path, name: str) -> Path | None:
    inside = Path(name)
    for base in dict.fromkeys((inside, Path(inside.name))):
        for extension in EXTENSIONS:
            for candidate in (base.with_suffix(extension), base.with_name(base.name + extension)):
                if (folder / candidate).is_file():
                    return folder / candidate
    return None


def read_mask(path: Path, full_size: tuple[int, int], width: int, height: int) -> Float32[np.ndarray, "h w"]:
    """Coverage in [0, 1] of a mask for an image of ``full_size``, at ``width`` x ``height``.

    A mask with an alpha channel that says something is that channel, another one its brightness; one that holds 0 and
    1 of 255 means 0 and 255. Raises DataError where it cannot be read or has another shape than the image.
    """
    mask = read_image(path)
    rows, columns = mask.rgb.shape[:2]
    if abs(columns / rows * full_size[1] / full_size[0] - 1) > _ASPECT_TOLERANCE:
        raise DataError(
            f"{path}: the mask is {columns}x{rows}, its image {full_size[0]}x{full_size[1]}; expected the same shape."
        )
    coverage = _coverage(mask)
    if coverage.shape == (height, width):
        return coverage
    how = cv2.INTER_AREA if columns >= width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(coverage, (width, height), interpolation=how), np.float32)


def _coverage(mask: DecodedImage) -> Float32[np.ndarray, "h w"]:
    if mask.alpha is not None and not (mask.alpha == 1).all():
        return mask.alpha
    brightness = mask.rgb.mean(axis=2, dtype=np.float32)
    top = float(brightness.max())
    labels = mask.bits == 8 and 0 < top <= 1.01 / 255
    return (brightness / top).astype(np.float32) if labels else brightness
