"""Masks that are black where the object is: noticed by what is at their borders and where the cameras look."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.carving import looked_at, outline_of
from sculpt_framework.posed_images.masks import mask_coverage
from sculpt_framework.posed_images.options import InvertMasksOption
from sculpt_framework.posed_images.views import PosedImage
from sculpt_framework.spread import spread
from sculpt_framework.types import View

_LOOKED_THROUGH = 16
"""Masks that are looked through at most, spread evenly."""
_AGREE = 0.8
"""Share of them that must be white at most of their border and black where the cameras look."""
_WINDOW = 1 / 16
"""Side of the window around the point that the cameras look at, as a share of the image's."""
_SIDE = 64


def white_on_object(
    train: Sequence[PosedImage], test: Sequence[PosedImage], option: InvertMasksOption
) -> tuple[list[PosedImage], list[PosedImage], list[str]]:
    """The images, their masks marked as inverted where they are, and a note on that."""
    masked = [item for item in (*train, *test) if item.mask is not None]
    inverted = option == "yes" or (option == "auto" and _look_inverted([i for i in train if i.mask is not None]))
    if not masked or not inverted:
        return list(train), list(test), []
    turned = [[replace(item, mask_inverted=True) for item in items] for items in (train, test)]
    why = (
        "as asked"
        if option == "yes"
        else "they are white at their borders and black where the cameras look (--dataset.invert-masks no keeps them)"
    )
    return turned[0], turned[1], [f"{len(masked)} masks are inverted, black and white exchanged: {why}."]


def _look_inverted(items: Sequence[PosedImage]) -> bool:
    views = []
    for item in spread(items, _LOOKED_THROUGH):
        try:
            mask = mask_coverage(item.mask) if item.mask is not None else np.zeros((0, 0), np.float32)
            camera = item.camera(mask.shape[1], mask.shape[0])
        except DataError:
            # What is wrong with a mask or a camera is said where it is used.
            continue
        width, height = _SIDE, max(1, round(_SIDE * mask.shape[0] / mask.shape[1]))
        small = View(name="", camera=camera.resized(width, height), rgb=torch.zeros(height, width, 3), alpha=None)
        views.append((mask, camera, outline_of(small)))
    if not views:
        return False
    point, _ = looked_at([outline for _, _, outline in views])
    counted = [_is_inverted(mask, camera.project(point[None])[0]) for mask, camera, _ in views]
    return sum(counted) >= _AGREE * len(counted)


def _is_inverted(mask: np.ndarray, middle: np.ndarray) -> bool:
    height, width = mask.shape
    if not ((middle >= 0) & (middle < (width, height))).all():
        return False
    border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    half = max(1, round(0.5 * _WINDOW * max(mask.shape)))
    column, row = middle.astype(int)
    window = mask[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]
    return bool((border > 0.5).mean() > 0.5 and window.mean() < 0.5)
