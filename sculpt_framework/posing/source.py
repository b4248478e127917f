"""What there is to pose: the photographs in a folder, or a video."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.folders import contents
from sculpt_framework.posed_images.masks import MASK_FOLDERS, find_masks, mask_folders, without_masks

CONVERTED = (".heic", ".heif", ".webp", ".avif")
"""What pycolmap does not read: the scene gets JPEGs, or PNGs where there is alpha."""
PHOTOGRAPHS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", *CONVERTED)
VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts")
FEWEST = 3
_IMAGE_FOLDERS = ("images", "image")
_RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
"""Photographs that are not read; a message names them."""


@dataclass(frozen=True, kw_only=True)
class Photographs:
    root: Path
    """The folder of the photographs."""
    names: tuple[str, ...]
    """Paths below ``root``, sorted."""
    masks: tuple[Path | None, ...]
    """The file of each photograph's mask."""
    notes: tuple[str, ...] = ()
    """On files of masks that are no photograph's."""

    @property
    def paths(self) -> list[Path]:
        return [self.root / name for name in self.names]


def is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEOS and path.is_file()


def holds_photographs(folder: Path) -> bool:
    """Whether the folder holds photographs, at its top or in its folder of images."""
    return any(
        path.suffix.lower() in PHOTOGRAPHS
        for place in (folder, *_image_folders(folder))
        for path in place.iterdir()
        if not path.name.startswith(".")
    )


def find_photographs(folder: Path, besides: Path | None = None) -> Photographs:
    """All photographs below a folder, or below its ``images/`` where there is one; folders of masks are left out, and
    so is what is in the folder ``besides``, if that is below.

    Raises DataError where there is no such folder, fewer than three photographs in it, or one whose name is not UTF-8,
    and what ``find_masks`` raises.
    """
    if not folder.is_dir():
        what = "is no folder and no video" if folder.exists() else "no such folder or file"
        raise DataError(f"{folder}: {what}; expected a folder of photographs, or a video ({', '.join(VIDEOS)}).")
    root = next(iter(_image_folders(folder)), folder)
    files = {path for path in root.rglob("*") if path.suffix.lower() in PHOTOGRAPHS and path.is_file()}
    if besides is not None and root.resolve() in (own := besides.resolve()).parents:
        files = {path for path in files if own not in path.resolve().parents}
    by_folder = groupby(sorted(file for file in files if not _set_aside(file.relative_to(root))), lambda at: at.parent)
    paths = sorted(path for _, beside in by_folder for path in without_masks(list(beside)))
    # What an earlier call has made of a file beside it is not another photograph.
    paths = [
        path
        for path in paths
        if path.with_suffix("").suffix.lower() not in CONVERTED or path.with_suffix("") not in files
    ]
    names = tuple(path.relative_to(root).as_posix() for path in paths)
    for name in names:
        if any("\ud800" <= letter <= "\udfff" for letter in name):
            raise DataError(f"{root}: the name of the file {name!a} is not UTF-8; rename it.")
    if len(names) < FEWEST:
        raise DataError(_too_few(root, names))
    # Masks are in a folder inside that of the photographs, or else beside it.
    masks, notes = find_masks(root if mask_folders(root) else root.resolve().parent, paths)
    return Photographs(root=root, names=names, masks=tuple(masks), notes=tuple(notes))


def _set_aside(inside: Path) -> bool:
    return any(part.casefold() in MASK_FOLDERS or part.startswith(".") for part in inside.parts)


def _image_folders(folder: Path) -> list[Path]:
    """Those in a folder, the usual name first."""
    inside = [path for path in sorted(folder.iterdir()) if path.name.casefold() in _IMAGE_FOLDERS and path.is_dir()]
    return sorted(inside, key=lambda path: _IMAGE_FOLDERS.index(path.name.casefold()))


def _too_few(root: Path, names: Sequence[str]) -> str:
    others = Counter(path.suffix.lower() for path in root.rglob("*") if path.suffix.lower() in _RAW)
    if others:
        unread = ", ".join(f"{number} {suffix}" for suffix, number in others.most_common())
        return f"{root}: {len(names)} photographs that can be read, and {unread}, which cannot; convert them to JPEG."
    if not names:
        return f"{root}: no photographs; expected {', '.join(PHOTOGRAPHS)}; found {contents(root)}."
    return (
        f"{root}: {len(names)} {'photograph' if len(names) == 1 else 'photographs'}; expected {FEWEST} or more, better "
        "thirty to a hundred and fifty, from all sides."
    )


def fingerprint(paths: Sequence[Path]) -> str:
    """A digest of files' names, sizes and times of change: the same as long as they are. Raises DataError."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            state = path.stat()
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror}).") from error
        digest.update(f"{path.name}\0{state.st_size}\0{state.st_mtime_ns}\n".encode())
    return digest.hexdigest()
