"""Loads posed images into views: decoding in parallel, alpha where there is none, one note per oddity."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from sculpt_framework.errors import DataError
from sculpt_framework.memory import available_bytes, in_words
from sculpt_framework.posed_images.decoding import DecodedImage, read_image
from sculpt_framework.posed_images.distortion import Distortion, rectify, resample
from sculpt_framework.posed_images.headers import ImageHeader, read_headers
from sculpt_framework.posed_images.keying import Background, common_background, given_background, key_out
from sculpt_framework.posed_images.lens import ASPECT_TOLERANCE, Pinhole
from sculpt_framework.posed_images.masks import read_mask
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Camera, View

BackgroundOption = Literal["auto", "white", "black", "none"]
_COLORS = {"white": np.ones(3), "black": np.zeros(3)}
_BYTES_PER_PIXEL = 16
"""Four channels of four bytes."""
IMAGE_BYTES = 2 * 2**30
"""What the images of a scene may take in memory together when the size is chosen here; training needs as much again."""


@dataclass(frozen=True, kw_only=True)
class PosedImage:
    """What a layout knows about an image before it is decoded."""

    name: str
    path: Path
    camera: Callable[[int, int], Camera]
    """The camera of the image, given its width and height in pixels; world frame. Of a distorted lens, the pinhole."""
    size: tuple[int, int] | None = None
    """Width and height that the layout says the image has, if it does: whether to turn it as its EXIF data say."""
    distortion: Distortion | None = None
    mask: Path | None = None
    mask_inverted: bool = False
    """Black where the object is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedViews:
    train: tuple[View, ...]
    test: tuple[View, ...]
    notes: tuple[str, ...]


def load_views(
    train: Sequence[PosedImage],
    test: Sequence[PosedImage],
    background: BackgroundOption,
    *,
    downscale: int = 1,
    all_round: bool = False,
) -> LoadedViews:
    """Decode, undistort, give an alpha to images without one, leave out train images that show nothing.

    ``background`` says what is behind images without alpha: ``auto`` looks for a constant colour in their borders,
    ``none`` leaves them without alpha; with ``all_round`` one that leaves gaps in most borders does not count.

    Images are read at 1/``downscale`` of their width and height; 0 takes the smallest whole number with which all of
    them take at most ``IMAGE_BYTES``. No more images than there are threads are ever in memory at their full size.

    Raises DataError for a damaged image, for images that do not fit their camera or do not fit into memory, and if all
    images are transparent.
    """
    posed = [*train, *test]
    headers = read_headers([item.path for item in posed])
    divide = downscale or _dividing(headers)
    _require_memory(headers, divide)
    turns = [_orientation(item, header) for item, header in zip(posed, headers, strict=True)]
    images, cameras = _read_all(posed, turns, divide)
    notes = _describe(images) + _describe_reading(posed, turns, divide, chosen=downscale == 0)
    split = len(train)
    if all(_opaque(image) for image in images[:split]):
        if any(image.alpha is not None for image in images[:split]):
            notes.append("every alpha channel is opaque everywhere and says nothing; it is ignored.")
        images = [replace(image, alpha=None) if _opaque(image) else image for image in images]
    if any(image.alpha is None for image in images):
        images, note = _key(images, split, background, all_round=all_round)
        notes.append(note)
    views = [_view(item, camera, image) for item, camera, image in zip(posed, cameras, images, strict=True)]
    seen = [view for view in views[:split] if view.shows_object]
    if not seen:
        raise DataError(
            f"all {split} train images are transparent (such as {posed[0].path}, alpha nowhere above a half); "
            "expected an object in them."
        )
    if len(seen) < split:
        empty = split - len(seen)
        notes.append(f"{empty} of {split} train images are transparent, alpha nowhere above a half: left out.")
    return LoadedViews(train=tuple(seen), test=tuple(views[split:]), notes=tuple(notes))


def _dividing(headers: Sequence[ImageHeader | None]) -> int:
    pixels = sum(header.width * header.height for header in headers if header is not None)
    return max(1, math.ceil(math.sqrt(pixels * _BYTES_PER_PIXEL / IMAGE_BYTES)))


def _require_memory(headers: Sequence[ImageHeader | None], divide: int) -> None:
    """Before anything is decoded: what does not fit would be swapped, or this process killed without a word."""
    pixels = sum(header.width * header.height for header in headers if header is not None)
    needed, left = pixels * _BYTES_PER_PIXEL / divide**2, available_bytes()
    if left is not None and needed > left:
        least = math.ceil(math.sqrt(pixels * _BYTES_PER_PIXEL / max(1, left / 2)))
        raise DataError(
            f"{len(headers)} images take {in_words(needed)} of memory as they are read and {in_words(left)} are left: "
            f"read them smaller, with --dataset.downscale {least} or more (now {divide}), or give fewer."
        )


def _orientation(item: PosedImage, header: ImageHeader | None) -> int:
    """The turn an image needs to fit its camera. Cameras fitted to the stored pixels, as COLMAP does, need none."""
    if header is None or header.orientation == 1 or item.size is None:
        return 1
    shape = item.size[0] / item.size[1]
    if abs(header.width / header.height / shape - 1) <= ASPECT_TOLERANCE:
        return 1
    width, height = header.upright_size
    return header.orientation if abs(width / height / shape - 1) <= ASPECT_TOLERANCE else 1


def _read_all(
    posed: Sequence[PosedImage], turns: Sequence[int], divide: int
) -> tuple[list[DecodedImage], list[Camera]]:
    with ThreadPoolExecutor(max_workers=torch.get_num_threads()) as pool:
        pending = [pool.submit(_read, item, turn, divide) for item, turn in zip(posed, turns, strict=True)]
        try:
            done = [job.result() for job in pending]
        except BaseException:
            # Ctrl-C, too, does not wait for the others.
            pool.shutdown(cancel_futures=True)
            raise
    return [image for image, _ in done], [camera for _, camera in done]


def _read(item: PosedImage, orientation: int, divide: int) -> tuple[DecodedImage, Camera]:
    """One image at its final size, seen through a pinhole, with the mask that belongs to it as alpha."""
    image = read_image(item.path, orientation=orientation, divide=divide)
    height, width = image.rgb.shape[:2]
    camera = item.camera(*image.full_size).resized(width, height)
    if item.mask is not None:
        mask = read_mask(item.mask, image.full_size, width, height)
        mask = 1 - mask if item.mask_inverted else mask
        image = replace(image, alpha=mask if image.alpha is None else np.minimum(mask, image.alpha))
    if item.distortion is None or item.distortion.is_none:
        return image, camera
    lens = Pinhole(fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)
    straight = rectify(lens, item.distortion, width, height, str(item.path))
    rgb, alpha = resample(image.rgb, straight), image.alpha
    if alpha is not None:
        alpha = resample(alpha, straight)
    camera = straight.pinhole.camera(camera.world_to_camera, straight.width, straight.height)
    return replace(image, rgb=rgb, alpha=alpha), camera


def _describe_reading(posed: Sequence[PosedImage], turns: Sequence[int], divide: int, *, chosen: bool) -> list[str]:
    notes, total = [], len(posed)
    if divide > 1:
        why = f", so that {total} images take at most {IMAGE_BYTES / 2**30:g} GiB" if chosen else ""
        notes.append(f"images are read at 1/{divide} of their width and height{why}.")
    turned = sum(turn != 1 for turn in turns)
    if turned:
        notes.append(f"{turned} of {total} images are turned upright as their EXIF data say, to fit their cameras.")
    bent = sum(item.distortion is not None and not item.distortion.is_none for item in posed)
    if bent:
        notes.append(f"{bent} of {total} images come through a distorted lens: resampled to a pinhole's.")
    masked = sum(item.mask is not None for item in posed)
    if masked:
        notes.append(f"{masked} of {total} images have a mask in a file of its own.")
    return notes


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


def _key(
    images: list[DecodedImage], split: int, background: BackgroundOption, *, all_round: bool
) -> tuple[list[DecodedImage], str]:
    """Alpha for the images that have none, and the line that says so."""
    bare = [image for image in images if image.alpha is None]
    some = f"{len(bare)} of {len(images)} images have no alpha"
    if background == "none":
        return images, f"{some}: nothing is keyed out."
    learned = [image for image in images[:split] if image.alpha is None] or bare
    colors, lossless = [image.rgb for image in learned], all(image.lossless for image in learned)
    behind: Background | None
    if background == "auto":
        behind = common_background(colors, lossless, all_round=all_round)
        if behind is None:
            return images, f"{some} and their borders show no constant background: nothing is keyed out."
        found = "constant background found at the borders"
    else:
        behind = given_background(_COLORS[background], colors, lossless)
        found = "background as given"
    keyed = in_threads(partial(_with_alpha, background=behind), images)
    r, g, b = behind.color
    return keyed, f"{some}: {found}, sRGB ({r:.2f}, {g:.2f}, {b:.2f}), is keyed out to make one."


def _with_alpha(image: DecodedImage, background: Background) -> DecodedImage:
    """An image that has an alpha stays as it is."""
    if image.alpha is not None:
        return image
    return replace(image, alpha=key_out(image.rgb, background))


def _view(item: PosedImage, camera: Camera, image: DecodedImage) -> View:
    alpha = None if image.alpha is None else torch.from_numpy(image.alpha)
    return View(name=item.name, camera=camera, rgb=torch.from_numpy(image.rgb), alpha=alpha, source=item.path)
