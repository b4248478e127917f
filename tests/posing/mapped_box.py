"""Photographs of the textured box with features, matches and a model, as posing has them between its steps."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from textured_box import photographs, save

from sculpt_framework.posing import colmap
from sculpt_framework.posing.options import PosingOptions

if TYPE_CHECKING:
    import pycolmap

OPTIONS = PosingOptions(threads=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class MappedBox:
    names: list[str]
    database: Path
    images: Path
    model: "pycolmap.Reconstruction"


def ignore(done: int, total: int) -> None:
    pass


def mapped_box(folder: Path) -> MappedBox:
    """Eight views, ten degrees apart, all of which have a camera."""
    shots = photographs(tuple(range(0, 80, 10)))
    names = []
    for index, name in enumerate(save(shots, folder / "images" / "0")):
        names.append(f"0/{index}.jpg")  # A list of pairs cannot have spaces in names.
        (folder / "images" / "0" / name).rename(folder / "images" / names[-1])
    database, images = folder / "database.db", folder / "images"
    colmap.require_pycolmap()
    colmap.extract(database, images, names, None, OPTIONS, ignore)
    pairs = [(first, second) for index, first in enumerate(names) for second in names[index + 1 :]]
    colmap.match(database, pairs, OPTIONS, ignore)
    (whole,) = colmap.map_images(database, images, folder / "models", OPTIONS, ignore)
    assert whole.num_reg_images() == len(names)
    return MappedBox(names=names, database=database, images=images, model=whole)
