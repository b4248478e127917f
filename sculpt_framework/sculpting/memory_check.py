"""Whether there is memory for a stage's images and steps, before they are made.

What the system does about a process that takes too much is to swap for hours or to kill it without a word.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from sculpt_framework.errors import TrainingFailed
from sculpt_framework.memory import available_bytes, in_words
from sculpt_framework.posed_images.training_images import object_window
from sculpt_framework.sculpting.config import StageConfig
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.types import Box, View

_PIXEL, _CELL, _GAUSSIAN = 300, 4100, 1500
"""Bytes that a step takes for each pixel of an image, cell of the band and Gaussian (docs/measure_memory.py)."""
_CERTAIN = 0.5
"""Share of what is foreseen for a step that it takes at least, whatever the method."""
_FACES_PER_CELL = 2.0
"""Of a dual surface, while there is none yet."""
_FLOAT = 4


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """What the memory of a step goes with."""

    pixels: int
    """Of the largest image."""
    cells: int
    """That the surface passes through."""
    gaussians: int


def sizes(trainer: BiLevelTrainer, pixels: int) -> Sizes:
    """Of the next step on images of so many pixels, by the latest surface, or by the cells it will be in."""
    assert trainer.seeds is not None  # noqa: S101 - a stage begins with them
    last, cells, per_cell = trainer.extraction, trainer.seeds.shape[0], _FACES_PER_CELL
    if last is not None:
        # Of cells half as wide a surface has four times as many; of the seeds' children it passes through about half.
        cells = last.cells.shape[0] * 4 ** (trainer.extractor.grid.level - last.grid.level)
        per_cell = last.surface.faces.shape[0] / last.cells.shape[0]
    each = trainer.scene.binder.gaussians_per_face
    return Sizes(pixels=pixels, cells=round(cells), gaussians=round(cells * per_cell * each))


def step_bytes(of: Sizes) -> int:
    """The most that an outer step has in use at once beside what lasts, as measured on a CPU."""
    return _PIXEL * of.pixels + _CELL * of.cells + _GAUSSIAN * of.gaussians


def check_memory(
    trainer: BiLevelTrainer,
    views: Sequence[View],
    box: Box,
    stage: StageConfig,
    number: int,
    warn: Callable[[str], None],
) -> None:
    """Of a stage, whose number names its options; its level is set and the surface's cells are known.

    Warns where a step may take more than there is. Raises TrainingFailed, with the setting to lower, where the images
    do not fit or a step cannot.
    """
    assert trainer.seeds is not None  # noqa: S101 - a stage begins with them
    left = memory_left(trainer.seeds.device)
    if left is None:
        return
    images = step = 0
    of = sizes(trainer, 0)
    background = trainer.background
    around, more = (0.0, 0) if background is None else (background.around, 3)
    # Whole images are more than their windows, and cost no look at the pixels.
    for window in (_whole, object_window):
        windows = [window(view, box.camera_to_object(view.camera), box, around) for view in views]
        areas = [_area(each) * stage.image_scale**2 for each in windows]
        channels = [more + (3 if view.alpha is None else 4) for view in views]
        images = round(sum(area * count * _FLOAT for area, count in zip(areas, channels, strict=True)))
        of = sizes(trainer, round(max(areas)))
        step = step_bytes(of)
        if images + step <= left:
            return
    by_pixels = images + _PIXEL * of.pixels > step - _PIXEL * of.pixels
    lower = f"image-scale (now {stage.image_scale:g})" if by_pixels else f"level (now {stage.level})"
    message = (
        f"stage {number} needs about {in_words(images)} for its images and {in_words(step)} for a step on "
        f"{of.gaussians} Gaussians; {in_words(left)} are left: lower --trainer.stages.{number}.{lower}"
    )
    if images + _CERTAIN * step > left:
        raise TrainingFailed(message)
    warn(message)


def memory_left(device: torch.device) -> int | None:
    """Bytes that tensors on the device may still take; None where nobody says."""
    if device.type != "cuda":
        return available_bytes()
    # What torch keeps for itself is free as well.
    kept = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + kept


def _whole(view: View, camera: object, box: Box, around: float) -> tuple[int, int, int, int]:
    return 0, 0, view.camera.width, view.camera.height


def _area(window: tuple[int, int, int, int]) -> int:
    x0, y0, x1, y1 = window
    return (x1 - x0) * (y1 - y0)
