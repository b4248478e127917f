"""Other cameras for photographs whose own contradict their matches."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sculpt_framework.posing import colmap
from sculpt_framework.posing.explained import Explained, explained
from sculpt_framework.posing.options import PosingOptions

if TYPE_CHECKING:
    import pycolmap

_DOUBTFUL = 0.5
"""Of the matches of a photograph: a camera that explains a smaller share is not believed without a second opinion."""
_ROUNDS = 3


@dataclass(frozen=True, kw_only=True)
class _Mapping:
    """What mapping needs besides a model."""

    database: Path
    images: Path
    work: Path
    options: PosingOptions
    tell: colmap.Tell


def best_explained(
    pieces: "Sequence[pycolmap.Reconstruction]",
    database: Path,
    images: Path,
    work: Path,
    options: PosingOptions,
    tell: colmap.Tell,
) -> "list[pycolmap.Reconstruction]":
    """The pieces, or in place of the first a model of as many photographs that explains more of their matches.

    It is looked for where some photograph's camera is doubtful: where parts of the object repeat, incremental mapping
    may go on from a wrong camera. Tried are the piece and a model of all cameras at once, both with the doubtful
    photographs placed again, by the others, for as long as that explains more. ``work`` is a folder for intermediate
    files.
    """
    first = pieces[0]
    known = explained(first, database)
    if not known.below(_DOUBTFUL):
        return list(pieces)
    mapping = _Mapping(database=database, images=images, work=work, options=options, tell=tell)
    tried = [_settled(first, known, mapping, "own")]
    together = _all_at_once(first, mapping)
    if together is not None:
        tried.append(_settled(together, explained(together, database), mapping, "together"))
    tried = [each for each in tried if each[0].num_reg_images() >= first.num_reg_images()]
    best, count = max(tried, key=lambda each: each[1].total)
    if count.total <= known.total or colmap.diverged(best):
        return list(pieces)
    placed = colmap.world_to_cameras(best).keys()
    return [best, *(piece for piece in pieces[1:] if colmap.world_to_cameras(piece).keys() - placed)]


def _settled(
    model: "pycolmap.Reconstruction", count: Explained, mapping: _Mapping, name: str
) -> "tuple[pycolmap.Reconstruction, Explained]":
    """The model with its doubtful photographs placed again, as long as that explains more, and what it explains."""
    for number in range(_ROUNDS):
        rest = colmap.without(model, count.below(_DOUBTFUL))
        if not colmap.SMALLEST_MODEL <= rest.num_reg_images() < model.num_reg_images():
            break
        folder = mapping.work / f"{name} {number}"
        again = colmap.grown(rest, mapping.database, mapping.images, folder, mapping.options, mapping.tell)
        if again is None or again.num_reg_images() < model.num_reg_images():
            break
        counted = explained(again, mapping.database)
        if counted.total <= count.total:
            break
        model, count = again, counted
    return model, count


def _all_at_once(lenses: "pycolmap.Reconstruction", mapping: _Mapping) -> "pycolmap.Reconstruction | None":
    """Mapping from the relative poses of all pairs together (Pan et al. 2024), with the lenses of a model; None:
    nothing could be placed.

    One wrong pair is outvoted by the others, but relative poses are wrong without known lenses. The model is finished
    as incremental mapping does, which also adds what was left out.
    """
    import pycolmap

    folder = mapping.work / "all at once"
    folder.mkdir(parents=True)
    copied = folder / "database.db"
    shutil.copyfile(mapping.database, copied)
    opened = pycolmap.Database.open(copied)
    for lens in lenses.cameras.values():
        known = pycolmap.Camera(lens.todict())
        known.has_prior_focal_length = True
        opened.update_camera(known)
    opened.close()
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = mapping.options.seed
    models = pycolmap.global_mapping(copied, mapping.images, folder / "global", options)
    copied.unlink()
    if not models:
        return None
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    return colmap.grown(largest, mapping.database, mapping.images, folder / "finished", mapping.options, mapping.tell)
