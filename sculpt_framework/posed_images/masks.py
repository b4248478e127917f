"""Masks in files of their own: white where the object is."""

import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from jaxtyping import Float32

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.decoding import read_image
from sculpt_framework.posed_images.image_files import folded, is_image_name
from sculpt_framework.posed_images.lens import ASPECT_TOLERANCE
from sculpt_framework.posed_images.reading import in_short

MASK_FOLDERS = ("masks", "mask", "object_mask")
_MARK = re.compile(r"[._-]masks?$")
"""Behind the name of the image that a mask is of."""
_OF_SYSTEMS = ("thumbs.db", "desktop.ini")
"""What file managers leave in folders, beside files whose name starts with a dot."""


def has_mask_files(root: Path) -> bool:
    """Whether a folder of photographs has a folder of masks, or a ``transforms.json`` that names masks."""
    if mask_folders(root):
        return True
    named = root / "transforms.json"
    return named.is_file() and re.search(rb'"mask_path"\s*:\s*"', named.read_bytes()) is not None


def find_masks(
    root: Path, images: Sequence[Path], named: Sequence[Path | None] = ()
) -> tuple[list[Path | None], list[str]]:
    """The mask of each image, None where there is none, and notes on files that are no image's mask.

    Looked for in the folders of masks below ``root``: of ``images/a/b.jpg`` it is ``images/a/b``, ``a/b`` or ``b``
    there, with any extension behind or in place of the image's, or ``b.mask``, ``b_mask``; the latter two are also
    found beside the image. Case does not count. Those that are ``named`` elsewhere, one for each image, come first.

    Raises DataError where there are masks but none is named after an image, and where one is named after several.
    """
    given = list(named) or [None] * len(images)
    folders = mask_folders(root)
    files = [(folder, path) for folder in folders for path in _files(folder)]
    by_name = _by_name([path.relative_to(folder) for folder, path in files], [path for _, path in files])
    inside = [_relative(image, root) for image in images]
    beside = {folder: _beside(folder, set(images)) for folder in {image.parent for image in images}}
    found = [
        mask or _look_up(by_name, _ends(path)) or _look_up(beside[image.parent], _ends(PurePosixPath(path.name)))
        for mask, image, path in zip(given, images, inside, strict=True)
    ]
    _require_own(found, given, inside)
    used = {mask.resolve() for mask in found if mask is not None}
    unused = [path for _, path in files if path.resolve() not in used]
    pictures = [path for path in unused if is_image_name(path.name)]
    if pictures and not used:
        raise DataError(
            f"{pictures[0].parent}: holds {len(pictures)} masks ({pictures[0].name}, ...), none named after an image; "
            f"expected names such as {inside[0].with_suffix('.png').name}."
        )
    notes = []
    if unused:
        names = in_short([path.relative_to(root).as_posix() for path in unused])
        notes.append(f"{len(unused)} of {len(files)} files of masks belong to no image and are not used ({names}).")
    return found, notes


def mask_folders(root: Path) -> list[Path]:
    """Those in a folder of photographs; none where it may not be listed."""
    if not (root.is_dir() and os.access(root, os.R_OK | os.X_OK)):
        return []
    return sorted(path for path in root.iterdir() if path.name.casefold() in MASK_FOLDERS and path.is_dir())


def without_masks(files: Sequence[Path]) -> list[Path]:
    """Images of one folder, without those that are called masks of others: ``a.mask.png``, ``a_mask.png`` of ``a``."""
    names = {folded(name) for path in files for name in (path.name, path.stem)}
    return [path for path in files if (key := folded(path.stem)) == (cut := _MARK.sub("", key)) or cut not in names]


def _files(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.name.startswith(".") and path.name.casefold() not in _OF_SYSTEMS:
            yield path


def _by_name(names: Sequence[Path], paths: Sequence[Path]) -> dict[str, Path]:
    """Masks by the names of the images they may be of; a name that is a mask's own goes before one that was cut."""
    found: dict[str, Path] = {}
    pictures = [(name, path) for name, path in zip(names, paths, strict=True) if is_image_name(name.name)]
    # Of a.png and a.webp the first.
    for cut in (False, True):
        for name, path in pictures:
            key = folded(name.with_suffix("").as_posix())
            marked = _MARK.sub("", key)
            if not cut or marked != key:
                found.setdefault(marked if cut else key, path)
    return found


def _ends(path: PurePosixPath) -> list[str]:
    """Under what names the mask of an image may be found: ever shorter ends of its path, with its extension first."""
    ends = [PurePosixPath(*path.parts[start:]) for start in range(len(path.parts))]
    return [folded(name) for end in ends for name in (end.as_posix(), end.with_suffix("").as_posix())]


def _look_up(by_name: Mapping[str, Path], names: Sequence[str]) -> Path | None:
    return next((by_name[name] for name in names if name in by_name), None)


def _beside(folder: Path, images: Collection[Path]) -> dict[str, Path]:
    """Masks in a folder of images, by the names of the images they are of, with or without extension."""
    marked = {path: key for path in sorted(folder.iterdir()) if _MARK.search(key := folded(path.stem))}
    return {_MARK.sub("", key): path for path, key in marked.items() if path not in images and is_image_name(path.name)}


def _relative(image: Path, root: Path) -> PurePosixPath:
    """Of photographs in a folder of their own elsewhere, the whole path."""
    inside = image.relative_to(root) if image.is_relative_to(root) else image.relative_to(image.anchor)
    return PurePosixPath(inside.as_posix())


def _require_own(found: Sequence[Path | None], given: Sequence[Path | None], inside: Sequence[PurePosixPath]) -> None:
    first: dict[Path, PurePosixPath] = {}
    for mask, explicit, image in zip(found, given, inside, strict=True):
        if mask is None or explicit is not None:
            continue
        other = first.setdefault(mask, image)
        if other != image:
            raise DataError(
                f"{mask}: may be the mask of {other} and of {image}; expected one for each, named with the image's "
                f"folder and extension, such as masks/{other}.png."
            )


def read_mask(path: Path, full_size: tuple[int, int], width: int, height: int) -> Float32[np.ndarray, "h w"]:
    """Coverage in [0, 1] of a mask for an image of ``full_size``, at ``width`` x ``height``.

    Raises DataError where it cannot be read or has another shape than the image.
    """
    coverage = mask_coverage(path)
    rows, columns = coverage.shape
    if abs(columns / rows * full_size[1] / full_size[0] - 1) > ASPECT_TOLERANCE:
        raise DataError(
            f"{path}: the mask is {columns}x{rows}, its image {full_size[0]}x{full_size[1]}; expected the same shape."
        )
    if coverage.shape == (height, width):
        return coverage
    how = cv2.INTER_AREA if columns >= width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(coverage, (width, height), interpolation=how), np.float32)


def mask_coverage(path: Path) -> Float32[np.ndarray, "h w"]:
    """Coverage in [0, 1] at the mask's own size.

    A mask with an alpha channel that says something is that channel, another one its brightness; where there are two
    levels, 0 and another one, that one means all. Raises DataError where it cannot be read.
    """
    mask = read_image(path)
    if mask.alpha is not None and not (mask.alpha == 1).all():
        return mask.alpha
    brightness = mask.rgb.mean(axis=2, dtype=np.float32)
    top = float(brightness.max())
    labels = 0 < top < 1 and bool(((brightness == 0) | (brightness == top)).all())
    return (brightness > 0).astype(np.float32) if labels else brightness
