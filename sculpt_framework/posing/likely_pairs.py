"""Which photographs most likely show the same, by a few features of each: comparing all takes minutes."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Int64

if TYPE_CHECKING:
    import pycolmap

_FEATURES = 512
"""Of an image, the largest: they are seen from farthest away, and at any size."""
_RATIO = 0.85
"""Of the distances to the nearest and the second nearest feature, from which on a match says nothing."""
PARTNERS = 16
"""Of each image."""
_STRIDE = 5
"""Every so many images, one is compared with all others chosen so: other sides, and other passes."""


def likely_pairs(database: Path, names: Sequence[str]) -> list[tuple[str, str]]:
    """Of all pairs of these images, whose features the database has, those of an image with its likeliest partners, and
    those of every fifth with every fifth."""
    import pycolmap

    opened = pycolmap.Database.open(database)
    features = [_largest(opened, name) for name in names]
    opened.close()
    chosen = _with_best(_common(features))
    chosen[::_STRIDE, ::_STRIDE] = True
    first, second = np.nonzero(np.triu(chosen, 1))
    return [(names[i], names[j]) for i, j in zip(first.tolist(), second.tolist(), strict=True)]


def _largest(opened: "pycolmap.Database", name: str) -> Float32[np.ndarray, "n 128"]:
    """Unit descriptors."""
    image = opened.read_image_with_name(name)
    assert image is not None, "its features have been found"  # noqa: S101
    places, features = opened.read_keypoints(image.image_id), opened.read_descriptors(image.image_id)
    shapes = np.asarray(places, np.float32)
    size = np.abs(shapes[:, 2] * shapes[:, 5] - shapes[:, 3] * shapes[:, 4])
    largest = np.argsort(-size, kind="stable")[:_FEATURES]
    descriptors = np.asarray(features.data, np.float32)[largest]
    return descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True).clip(1e-9)


def _common(features: Sequence[Float32[np.ndarray, "_ 128"]]) -> Int64[np.ndarray, "v v"]:
    """How many features two images have in common: nearest to each other, and much nearer than the second nearest."""
    count = np.zeros((len(features), len(features)), np.int64)
    for i, own in enumerate(features):
        for j in range(i + 1, len(features)):
            if min(len(own), len(features[j])) < 2:
                continue
            alike = own @ features[j].T
            nearest = alike.argmax(axis=1)
            mutual = alike.argmax(axis=0)[nearest] == np.arange(len(own))
            second, first = np.sqrt((2 - 2 * np.partition(alike, -2, axis=1)[:, -2:]).clip(0)).T
            count[i, j] = count[j, i] = np.sum(mutual & (first < _RATIO * second))
    return count


def _with_best(count: Int64[np.ndarray, "v v"]) -> np.ndarray:
    chosen = np.zeros(count.shape, bool)
    best = np.argsort(-count, axis=1, kind="stable")[:, :PARTNERS]
    np.put_along_axis(chosen, best, True, axis=1)
    return chosen | chosen.T
