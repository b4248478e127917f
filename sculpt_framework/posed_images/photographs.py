"""From photographs with cameras to a scene: masks where there are none, and the object's box."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float64

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.box import FoundBox, box_in_words, fit_box
from sculpt_framework.posed_images.clues import Clues, points_bounds
from sculpt_framework.posed_images.mask_polarity import white_on_object
from sculpt_framework.posed_images.options import PhotographsConfig
from sculpt_framework.posed_images.outvoted import without_outvoted
from sculpt_framework.posed_images.projected_box import box_outline
from sculpt_framework.posed_images.views import PosedImage, load_views
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Box, Scene, Support, View

Item = TypeVar("Item")


def hold_out(items: Sequence[Item], every: int, where: str) -> tuple[list[Item], list[Item], str]:
    """Train and test items, and the line that says how they were parted. Raises DataError if none is left to train."""
    if every == 0:
        return list(items), [], f"no test split: all {len(items)} views are learned from."
    train = [item for index, item in enumerate(items) if index % every]
    if not train:
        raise DataError(f"{where}: {len(items)} views; all of them would be test views.")
    return train, list(items[::every]), f"every {every}th of {len(items)} views is held out as a test view."


def load_photographs(
    name: str,
    train: Sequence[PosedImage],
    test: Sequence[PosedImage],
    options: PhotographsConfig,
    clues: Clues,
    *,
    notes: Sequence[str] = (),
    reference: Path | None = None,
) -> Scene:
    """Read the images, cut the object out where nothing says what it is, and find its box.

    Raises DataError where images or poses are unusable.
    """
    ignored = options.masks == "ignored"
    if ignored:
        train, test = ([replace(item, mask=None) for item in items] for items in (train, test))
    by_file = any(item.mask is not None for item in train)
    train, test, turned = white_on_object(train, test, options.invert_masks)
    keyed = options.background if (options.masks == "auto" and not by_file) or ignored else "none"
    loaded = load_views(train, test, keyed, downscale=options.downscale, all_round=True)
    said = [*notes, *turned, *loaded.notes]
    views, held_out = list(loaded.train), list(loaded.test)
    up, supports, points = None, (), clues.points
    given = None if options.box is None else Box.between(options.box[:3], options.box[3:])
    bare = sum(view.alpha is None for view in views)
    if bare and by_file and options.masks == "auto":
        how = "--dataset.masks cut-out cuts the object out of them by colours"
        said.append(f"{bare} of {len(views)} train images have no mask and are used without one ({how}).")
    elif bare and options.masks != "none":
        seed, how = (given, "the box given") if given is not None else seed_box(views, clues)
        sure = given is not None or clues.box is not None
        cut = _with_masks(views, held_out, seed, sure, clues, options)
        views, held_out, up, supports = cut.train, cut.test, cut.up, cut.supports
        points = np.concatenate([points, cut.points])
        said += [f"the object is looked for in {how}.", *cut.said]
    bounds = FoundBox(box=given, said="box as given.", cuts=True) if given is not None else _find_box(views, clues)
    agreeing, outvoted = without_outvoted(_cut_to(bounds, views), bounds.box)
    said += outvoted
    if len(agreeing) < len(views) and given is None:
        names = {view.name for view in agreeing}
        views = [view for view in views if view.name in names]
        bounds = _find_box(views, clues)
        agreeing = _cut_to(bounds, views)
    views, held_out = [view for view in agreeing if view.shows_object], _cut_to(bounds, held_out)
    if not views:
        raise DataError(f"no train image shows any of the object inside the {bounds.said}")
    return Scene(
        name=name,
        train=tuple(views),
        test=tuple(held_out),
        box=bounds.box,
        reference_mesh=reference,
        notes=(*said, bounds.said),
        up=up,
        supports=supports,
        points=points if len(points) else None,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cut:
    """Views with an alpha each."""

    train: list[View]
    test: list[View]
    said: list[str]
    up: tuple[float, float, float] | None = None
    """Where the object is found to stand on something."""
    supports: tuple[Support, ...] = ()
    points: Float64[np.ndarray, "n 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    """What depths there are, in world frame."""


def _with_masks(
    views: Sequence[View], test: Sequence[View], seed: Box, sure: bool, clues: Clues, options: PhotographsConfig
) -> _Cut:
    """The object from depths where they tell, else from colours. Raises DataError."""
    # What is compiled and only needed here is imported here.
    from sculpt_framework.posed_images.cut_out import cut_out
    from sculpt_framework.posed_images.find_object import FoundObject, find_object

    missed = ""
    if options.masks != "cut-out":
        found = find_object(views, test, seed, sure=sure, keep_support=options.keep_support)
        if isinstance(found, FoundObject):
            return _Cut(
                train=found.train,
                test=found.test,
                said=[found.said],
                up=found.up,
                supports=found.supports,
                points=found.points,
            )
        missed = f"no object is found by depth: {found}"
    train, held_out, note = cut_out(views, test, seed)
    try:
        fit_box(train, clues)
    except DataError:
        said = "what is cut out of the images by their colours contradicts itself from one to the next; put masks "
        said += "into a folder 'masks' beside the images, or say where the object is with --dataset.box."
        raise DataError(f"{missed}; {said}" if missed else said) from None
    return _Cut(train=train, test=held_out, said=[f"{missed}.", note] if missed else [note])


def seed_box(views: Sequence[View], clues: Clues) -> tuple[Box, str]:
    """Where the object is as far as cameras and points tell, and where that is from.

    The points among those in the space all cameras look at, without strays; where there are too few, a box half as
    wide as that space around the point the cameras look at.
    """
    if clues.box is not None:
        return clues.box, clues.box_name
    frusta = fit_box([replace(view, alpha=None) for view in views]).box
    low, high = frusta.minimum.numpy(), frusta.maximum.numpy()
    inside = clues.points[((clues.points > low) & (clues.points < high)).all(axis=1)]
    corners = points_bounds(inside)
    if corners is not None:
        box = Box.between(np.maximum(corners[0], low), np.minimum(corners[1], high))
        return box, f"the box of {len(inside)} of {len(clues.points)} sparse points"
    center, half = frusta.center.numpy(), 0.7 * frusta.half_sides.numpy() * frusta.scale
    return Box.between(center - half, center + half), "the middle of the space that all cameras see"


def _find_box(views: Sequence[View], clues: Clues) -> FoundBox:
    if any(view.alpha is not None for view in views):
        return fit_box(views, clues)
    box, how = seed_box(views, clues)
    said = f"{box_in_words(box)} is {how}; there are no masks to fit it to: --dataset.box says it better."
    return FoundBox(box=box, said=said, cuts=True)


def _cut_to(bounds: FoundBox, views: Sequence[View]) -> list[View]:
    """The views with masks that leave out what no surface in the box covers, where the box cuts the object: what lies
    beyond it is background."""

    def cut(view: View) -> View:
        if view.alpha is None or not bounds.cuts:
            return view
        return replace(view, alpha=view.alpha * torch.from_numpy(box_outline(view.camera, bounds.box)))

    return in_threads(cut, views)
