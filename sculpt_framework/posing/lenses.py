"""Which photographs were taken through the same lens, from sizes and EXIF; and which files are no photographs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from PIL import Image

from sculpt_framework.posed_images.decoding import find_damage
from sculpt_framework.posed_images.headers import exif_settings, heads_alone, positive, read_headers
from sculpt_framework.posing.options import Cameras
from sculpt_framework.posing.source import Photographs
from sculpt_framework.threads import in_threads

_FOCAL_LENGTH = 0x920A


@dataclass(frozen=True, kw_only=True)
class Sorted:
    """Photographs under names of their own, a folder for each lens."""

    names: Mapping[str, str]
    """Each photograph's name by that given here, which has no space: COLMAP's lists of pairs are parted by them."""
    sizes: Mapping[str, tuple[int, int]]
    """Width and height of the stored pixels, by the name given here."""
    unreadable: Mapping[str, str]
    """Why a file is left out, by its name."""
    notes: tuple[str, ...]


def sort_by_lens(photographs: Photographs, cameras: Cameras) -> Sorted:
    """``one``: a lens for each size and focal length; ``per-folder``: the same within each folder."""
    headers = read_headers(photographs.paths)
    with heads_alone():
        facts = in_threads(_facts, photographs.paths)
    names, sizes, unreadable = {}, {}, {}
    groups: dict[tuple[object, ...], int] = {}
    for index, (name, header, (damage, focal)) in enumerate(zip(photographs.names, headers, facts, strict=True)):
        if header is None or damage is not None:
            unreadable[name] = f"cannot be read as an image{f': {damage}' if damage else ''}"
            continue
        size = (header.width, header.height)
        folder = str(PurePosixPath(name).parent) if cameras == "per-folder" else ""
        group = groups.setdefault((*size, focal, folder) if cameras != "per-image" else (), len(groups))
        given = f"{group}/{index:06}{PurePosixPath(name).suffix.lower()}"
        names[given], sizes[given] = name, size
    notes = ()
    if cameras == "one" and len(groups) > 1:
        notes = (f"{len(groups)} lenses, as sizes or focal lengths differ.",)
    return Sorted(names=names, sizes=sizes, unreadable=unreadable, notes=notes)


def _facts(path: Path) -> tuple[str | None, float | None]:
    """What is visibly wrong with a file, and the focal length its EXIF names, in mm."""
    try:
        damage = find_damage(path.read_bytes())
        with Image.open(path) as image:
            focal = positive(exif_settings(image).get(_FOCAL_LENGTH))
            return damage, None if focal is None else round(focal, 2)
    except (OSError, ValueError, SyntaxError) as error:
        return str(error) or type(error).__name__, None
