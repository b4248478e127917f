"""Loads posed images into views: decoding in parallel, alpha where there is none, one note per oddity."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.decoding import DecodedImage, read_image
from sculpt_framework.posed_images.keying import Background, common_background, given_background, key_out
from sculpt_framework.types import Camera, View

BackgroundOption = Literal["auto", "white", "black", "none"]
_COLORS = {"white": np.ones(3), "black": np.zeros(3)}


@dataclass(frozen=True, kw_only=True)
class PosedImage:
    """What a layout knows about an image before it is decoded."""

    name: str
    path: Path
    camera: Callable[[int, int], Camera]
    """The camera of the image, given its width and height in pixels; world frame."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedViews:
    train: tuple[View, ...]
    test: tuple[View, ...]
    notes: tuple[str, ...]


def load_views(train: Sequence[PosedImage], test: Sequence[PosedImage], background: BackgroundOption) -> LoadedViews:
    """Decode, give an alpha to images without one, leave out train images that show nothing.

    ``background`` says what is behind images without alpha: ``auto`` looks for a constant colour in their borders,
    ``none`` leaves them without alpha.

    Raises DataError for a damaged image, for images that do not fit their camera, and if all images are transparent.
    """
    posed = [*train, *test]
    images = _decode([item.path for item in posed])
    notes = _describe(images)
    split = len(train)
    if all(_opaque(image) for image in images[:split]):
        if any(image.alpha is not None for image in images[:split]):
            notes.append("every alpha channel is opaque everywhere and says nothing; it is ignored.")
        images = [replace(image, alpha=None) if _opaque(image) else image for image in images]
    cameras = [item.camera(image.rgb.shape[1], image.rgb.shape[0]) for item, image in zip(posed, images, strict=True)]
    if any(image.alpha is None for image in images):
        images, note = _key(images, split, background)
        notes.append(note)
    views = [_view(item, camera, image) for item, camera, image in zip(posed, cameras, images, strict=True)]
    seen = [view for view in views[:split] if view.alpha is None or bool((view.alpha > 0.5).any())]
    if not seen:
        raise DataError(
            f"all {split} train images are transparent (such as {posed[0].path}, alpha nowhere above a half); "
            "expected an object in them."
        )
    if len(seen) < split:
        empty = split - len(seen)
        notes.append(f"{empty} of {split} train images are transparent, alpha nowhere above a half: left out.")
    return LoadedViews(train=tuple(seen), test=tuple(views[split:]), notes=tuple(notes))


def _decode(paths: Sequence[Path]) -> list[DecodedImage]:
    with ThreadPoolExecutor(max_workers=torch.get_num_threads()) as pool:
        pending = [pool.submit(read_image, path) for path in paths]
        try:
            return [job.result() for job in pending]
        except DataError:
            pool.shutdown(cancel_futures=True)
            raise


def _opaque(image: DecodedImage) -> bool:
    return image.alpha is None or bool((image.alpha == 1).all())


def _describe(images: Sequence[DecodedImage]) -> list[str]:
    notes = []
    total = len(images)
    grey = sum(image.grey for image in images)
    if grey:
        notes.append(f"{grey} of {total} images are grey: read as colour with three equal channels.")
    deep = sum(image.bits == 16 for image in images)
    if deep:
        notes.append(f"{deep} of {total} images have 16 bits per channel: read at full depth.")
    sizes = {image.rgb.shape[1::-1] for image in images}
    if len(sizes) > 1:
        (w0, h0), (w1, h1) = min(sizes), max(sizes)
        notes.append(f"images come in {len(sizes)} sizes, {w0}x{h0} to {w1}x{h1}: each keeps its own.")
    return notes


def _key(images: list[DecodedImage], split: int, background: BackgroundOption) -> tuple[list[DecodedImage], str]:
    """Alpha for the images that have none, and the line that says so."""
    bare = [image for image in images if image.alpha is None]
    some = f"{len(bare)} of {len(images)} images have no alpha"
    if background == "none":
        return images, f"{some}: used without masks, as asked."
    learned = [image for image in images[:split] if image.alpha is None] or bare
    colors, lossless = [image.rgb for image in learned], all(image.lossless for image in learned)
    behind: Background | None
    if background == "auto":
        behind = common_background(colors, lossless)
        if behind is None:
            return images, f"{some} and their borders show no constant background: used without masks."
        found = "constant background found at the borders"
    else:
        behind = given_background(_COLORS[background], colors, lossless)
        found = "background as given"
    keyed = [_with_alpha(image, behind) if image.alpha is None else image for image in images]
    r, g, b = behind.color
    return keyed, f"{some}: {found}, sRGB ({r:.2f}, {g:.2f}, {b:.2f}), is keyed out to make one."


def _with_alpha(image: DecodedImage, background: Background) -> DecodedImage:
    rgb, alpha = key_out(image.rgb, background)
    return replace(image, rgb=rgb, alpha=alpha)


def _view(item: PosedImage, camera: Camera, image: DecodedImage) -> View:
    alpha = None if image.alpha is None else torch.from_numpy(image.alpha)
    return View(name=item.name, camera=camera, rgb=torch.from_numpy(image.rgb), alpha=alpha, source=item.path)
