"""From photographs with cameras to a scene: masks where there are none, and the object's box."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float64

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.posed_images.box import fit_box
from sculpt_framework.posed_images.options import PhotographsConfig
from sculpt_framework.posed_images.views import PosedImage, load_views
from sculpt_framework.types import Box, Scene, View

Item = TypeVar("Item")
_ENOUGH_POINTS = 30
_QUANTILE = 0.02
"""Share of points cut off at each end of each axis: triangulation leaves strays."""
_POINT_MARGIN = 0.15
"""Added at each side, as a share of the longest side: points are where there is texture, not everywhere."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Clues:
    """What a layout knows of where the object is, besides its images. World frame."""

    points: Float64[np.ndarray, "n 3"]
    """Of a sparse reconstruction; may be none, and may lie on what is around the object."""
    box: Box | None = None
    """Where the data themselves say the object is."""


def check_options(options: PhotographsConfig) -> None:
    """Raises ConfigError for options out of range."""
    if options.downscale < 0:
        raise ConfigError(
            f"--dataset.downscale is {options.downscale}; expected 0 (automatic), 1 (all pixels) or more."
        )
    if options.test_every < 0 or options.test_every == 1:
        raise ConfigError(f"--dataset.test-every is {options.test_every}; expected 0, or 2 or more.")
    if options.box is not None:
        low, high = np.array(options.box[:3]), np.array(options.box[3:])
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
            raise ConfigError(
                f"--dataset.box is {' '.join(f'{value:g}' for value in options.box)}; expected X0 Y0 Z0 X1 Y1 Z1 with "
                "each first number below the second."
            )


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
    by_file = any(item.mask is not None for item in train)
    keyed = "none" if options.masks != "auto" or by_file else options.background
    loaded = load_views(train, test, keyed, downscale=options.downscale)
    said = [*notes, *loaded.notes]
    views, held_out = list(loaded.train), list(loaded.test)
    given = None if options.box is None else _box_of(options.box)
    if options.masks != "none" and any(view.alpha is None for view in views):
        from sculpt_framework.posed_images.cut_out import cut_out

        seed, how = (given, "the box given") if given is not None else seed_box(views, clues)
        views, held_out, note = cut_out(views, held_out, seed)
        said += [f"the object is looked for in {how}.", note]
    box, note = (given, "box as given.") if given is not None else _find_box(views, clues)
    return Scene(
        name=name,
        train=tuple(views),
        test=tuple(held_out),
        box=box,
        reference_mesh=reference,
        notes=(*said, note),
    )


def seed_box(views: Sequence[View], clues: Clues) -> tuple[Box, str]:
    """Where the object is as far as cameras and points tell, and where that is from.

    The points among those in the space all cameras look at, without strays; where there are too few, a box half as
    wide as that space around the point the cameras look at.
    """
    if clues.box is not None:
        return clues.box, "the box that comes with the cameras"
    frusta, _ = fit_box([replace(view, alpha=None) for view in views])
    low, high = frusta.minimum.numpy(), frusta.maximum.numpy()
    inside = clues.points[((clues.points > low) & (clues.points < high)).all(axis=1)]
    if len(inside) >= _ENOUGH_POINTS:
        corners = np.quantile(inside, [_QUANTILE, 1 - _QUANTILE], axis=0)
        margin = _POINT_MARGIN * (corners[1] - corners[0]).max()
        box = _box(np.maximum(corners[0] - margin, low), np.minimum(corners[1] + margin, high))
        return box, f"the box of {len(inside)} of {len(clues.points)} sparse points"
    center, half = frusta.center.numpy(), 0.7 * frusta.half_sides.numpy() * frusta.scale
    return _box(center - half, center + half), "the middle of the space that all cameras see"


def _find_box(views: Sequence[View], clues: Clues) -> tuple[Box, str]:
    if any(view.alpha is not None for view in views):
        return fit_box(views)
    box, how = seed_box(views, clues)
    low, high = (" ".join(f"{value:.3g}" for value in corner.tolist()) for corner in (box.minimum, box.maximum))
    return box, f"box ({low}) to ({high}) is {how}; there are no masks to fit it to: --dataset.box says it better."


def _box_of(corners: Sequence[float]) -> Box:
    return _box(np.array(corners[:3], np.float64), np.array(corners[3:], np.float64))


def _box(low: Float64[np.ndarray, " 3"], high: Float64[np.ndarray, " 3"]) -> Box:
    return Box(minimum=torch.from_numpy(low.astype(np.float64)), maximum=torch.from_numpy(high.astype(np.float64)))
