"""Files in a folder, by the names that other files give them.

Those names are written by other programs on other machines: with back-slashes, in another case, with the paths of that
machine, without an extension. No name leads out of the folder: what is opened is always one of the files that are
listed in it. Links in the folder are the user's own and are followed.
"""

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.folders import contents
from sculpt_framework.posed_images.reading import in_line, in_short

IMAGE_EXTENSIONS = (
    ".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".avif", ".heic", ".heif", ".jp2", ".jxl",
    ".ppm", ".pgm", ".gif", ".exr", ".hdr",
)  # fmt: skip
"""In lower case; of several images with the name that is looked for, the first is taken."""
LEAST = 3
"""Views from which on a surface is more than a guess."""
_NUMBERED = re.compile(rf"(.+({'|'.join(map(re.escape, IMAGE_EXTENSIONS))}))(\d+)(\.\w+)", re.IGNORECASE)
"""Blender puts the frame's number and an extension behind a file name that has one: a.png0001.png."""
_DOUBLED = re.compile(r"(.+(\.\w+))\2", re.IGNORECASE)

Remark = Literal["as named", "case", "tail", "numbered"]
_REMARKS: dict[Remark, str] = {
    "case": "are found under a name in other case or encoding",
    "tail": "are found by the end of their path",
    "numbered": "are found without the number or the second extension that was put behind their name",
}


@dataclass(frozen=True, kw_only=True)
class FoundFile:
    asked: str
    """The name as another file gives it."""
    path: Path
    inside: PurePosixPath
    """Relative to the folder, as the file is called on disk."""
    remark: Remark


class NamedFiles:
    """The files of one folder, each of whose subfolders is listed once."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._listed: dict[Path, _Listing] = {}

    def find(self, name: str, home: str = "images") -> FoundFile | None:
        """The file that a name means, with or without its extension; None if there is none, or if it is not clear.

        Where the name leads out of the folder, or to nothing, ever shorter ends of it are looked for in the folder and
        in ``home`` in it. Raises DataError where the folder cannot be listed.
        """
        parts, leaves = self._parts(name)
        for start in range(len(parts)):
            moved = leaves or start > 0
            for base in ("", home) if moved else ("",):
                wanted = [base, *parts[start:]] if base else list(parts[start:])
                found = self._walk(wanted)
                if found is not None:
                    inside, remark = found
                    path = self.folder / inside
                    return FoundFile(asked=name, path=path, inside=inside, remark="tail" if moved else remark)
        return None

    def _parts(self, name: str) -> tuple[tuple[str, ...], bool]:
        """The parts of a path, without those that lead up, and whether it leaves the folder."""
        text = name.replace("\\", "/")
        root = self.folder.absolute().as_posix()
        if text.startswith(root + "/"):
            text = text[len(root) + 1 :]
        leaves = text.startswith("/") or text[1:2] == ":"
        parts: list[str] = []
        for part in text[2 if text[1:2] == ":" else 0 :].split("/"):
            if part == "..":
                leaves = leaves or not parts
                parts = parts[:-1]
            elif part not in ("", "."):
                parts.append(part)
        return tuple(parts), leaves

    def _walk(self, parts: Sequence[str]) -> tuple[PurePosixPath, Remark] | None:
        at, inside, remark = self.folder, PurePosixPath(), "as named"
        for part in parts[:-1]:
            name = self._list(at).folders.get(part)
            if name is None:
                return None
            remark = remark if name == part else "case"
            at, inside = at / name, inside / name
        found = _match(self._list(at).files, parts[-1])
        if found is None:
            return None
        name, how = found
        return inside / name, how if remark == "as named" else remark

    def _list(self, folder: Path) -> "_Listing":
        if folder not in self._listed:
            names: dict[str, list[str]] = {"folder": [], "file": []}
            try:
                with os.scandir(folder) as entries:
                    for entry in entries:
                        kind = _kind(entry)
                        if kind is not None:
                            names[kind].append(entry.name)
            except OSError as error:
                raise DataError(f"{folder}: the folder cannot be listed ({error.strerror}).") from None
            self._listed[folder] = _Listing(folders=_Names(names["folder"]), files=_Names(names["file"]))
        return self._listed[folder]


class _Names:
    """Names in a folder, found also where case and encoding differ, or what Blender put behind them."""

    def __init__(self, names: Sequence[str]):
        self._same: dict[str, list[str]] = {}
        self._made_of: dict[str, list[str]] = {}
        for name in names:
            self._same.setdefault(folded(name), []).append(name)
            for reduced in _reduced(name):
                self._made_of.setdefault(reduced, []).append(name)

    def get(self, name: str) -> str | None:
        """This name, or else the only one that differs in case and encoding alone."""
        same = self._same.get(folded(name), [])
        return name if name in same else same[0] if len(same) == 1 else None

    def made_of(self, name: str) -> str | None:
        """The only name that was made of this one."""
        longer = self._made_of.get(name, [])
        return longer[0] if len(longer) == 1 else None


@dataclass(frozen=True, kw_only=True)
class _Listing:
    folders: _Names
    files: _Names


def _kind(entry: os.DirEntry[str]) -> Literal["folder", "file"] | None:
    """None for devices and for links that lead nowhere."""
    try:
        return "folder" if entry.is_dir() else "file" if entry.is_file() else None
    except OSError:
        return None


def folded(name: str) -> str:
    """A name without its case, and with letters with accents as one sign each: systems differ in both."""
    return unicodedata.normalize("NFC", name).casefold()


def _match(files: _Names, name: str) -> tuple[str, Remark] | None:
    extended = [files.get(name + end) for end in IMAGE_EXTENSIONS]
    for given in (files.get(name), *extended):
        # Extensions differ in case from camera to camera, so that of a name without one is no remark.
        if given is not None and given.startswith(name):
            return given, "as named"
    for given in (files.get(name), *extended):
        if given is not None:
            return given, "case"
    blender = [*(files.get(plain) for plain in _reduced(name)), files.made_of(name)]
    return next(((given, "numbered") for given in blender if given is not None), None)


def _reduced(name: str) -> tuple[str, ...]:
    """Names of which this one was made by putting a number or an extension behind them."""
    numbered, doubled = _NUMBERED.fullmatch(name), _DOUBLED.fullmatch(name)
    found = (numbered[1], numbered[3] + numbered[4]) if numbered else ()
    return (*found, doubled[1]) if doubled else found


def is_image_name(name: str) -> bool:
    return os.path.splitext(name)[1].casefold() in IMAGE_EXTENSIONS


def view_names(inside: Sequence[PurePosixPath]) -> list[str]:
    """Paths without the extension, where that tells them apart."""
    short = [path.with_suffix("").as_posix() if is_image_name(path.name) else path.as_posix() for path in inside]
    times = Counter(short)
    return [path.as_posix() if times[name] > 1 else name for path, name in zip(inside, short, strict=True)]


def each_once(found: Sequence[FoundFile], what: str) -> tuple[list[int], list[str]]:
    """Which of them to keep so that no file is read twice, and the note on the others. ``what`` names them, plural."""
    first: dict[Path, int] = {}
    for index, file in enumerate(found):
        first.setdefault(file.path.resolve(), index)
    kept = sorted(first.values())
    if len(kept) == len(found):
        return kept, []
    again = in_short([file.inside.as_posix() for index, file in enumerate(found) if index not in first.values()])
    number = len(found) - len(kept)
    return kept, [f"{number} of {len(found)} {what} name an image again ({again}): it is used once, at its first pose."]


def remarks(found: Sequence[FoundFile], what: str) -> list[str]:
    """One note for each way in which files are not called as they were asked for. ``what`` they are, in the plural."""
    notes = []
    for remark, words in _REMARKS.items():
        moved = [file for file in found if file.remark == remark]
        if moved:
            notes.append(
                f"{len(moved)} of {len(found)} {what} {words} ({in_line(moved[0].asked)} is {moved[0].inside})."
            )
    return notes


def left_out(missing: Sequence[str], total: int, where: str, folder: Path, *, least: int = LEAST) -> list[str]:
    """The note that names images that are not in the folder. Raises DataError where fewer than ``least`` are left."""
    if not missing:
        return []
    names = in_short(missing, 20)
    left = total - len(missing)
    if left < least:
        raise DataError(
            f"{where}: {len(missing)} of {total} images are not there ({names}), which leaves {left}; expected "
            f"{least} or more; looked for in {folder} alone, which holds {contents(folder)}."
        )
    return [f"{len(missing)} of {total} images are not there and are left out: {names}."]
