"""Features of photographs as the database has them, and which of two photographs are the same."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64, UInt8

LARGEST = 512
"""Features of an image by which images are compared with each other: the largest are seen from farthest away, and at
any size."""
_RATIO = 0.85
"""Of the distances to the nearest and the second nearest feature, from which on a match says nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Features:
    """Of one image."""

    places: Float32[np.ndarray, "n 2"]
    """Pixels."""
    sizes: Float32[np.ndarray, " n"]
    """Pixels."""
    angles: Float32[np.ndarray, " n"]
    """Direction in the image, radians."""
    descriptors: UInt8[np.ndarray, "n 128"]

    def at(self, chosen: Int64[np.ndarray, " m"]) -> "Features":
        return Features(
            places=self.places[chosen],
            sizes=self.sizes[chosen],
            angles=self.angles[chosen],
            descriptors=self.descriptors[chosen],
        )

    def largest(self) -> "Features":
        """The largest ones, at most ``LARGEST``."""
        return self.at(np.argsort(-self.sizes, kind="stable")[:LARGEST])

    def directions(self) -> Float32[np.ndarray, "n 128"]:
        """Descriptors of length 1."""
        long = self.descriptors.astype(np.float32)
        return long / np.linalg.norm(long, axis=1, keepdims=True).clip(1e-9)


def read_features(database: Path, names: Sequence[str]) -> list[Features]:
    """Of images that the database has features of."""
    import pycolmap

    opened = pycolmap.Database.open(database)
    found = []
    for name in names:
        image = opened.read_image_with_name(name)
        assert image is not None, "its features have been found"  # noqa: S101
        shapes = np.asarray(opened.read_keypoints(image.image_id), np.float32).reshape(-1, 6)
        descriptors = np.asarray(opened.read_descriptors(image.image_id).data, np.uint8).reshape(-1, 128)
        found.append(
            Features(
                places=shapes[:, :2],
                sizes=np.sqrt(np.abs(shapes[:, 2] * shapes[:, 5] - shapes[:, 3] * shapes[:, 4])),
                angles=np.arctan2(shapes[:, 4], shapes[:, 2]),
                descriptors=descriptors,
            )
        )
    opened.close()
    return found


def matches(own: Float32[np.ndarray, "n 128"], other: Float32[np.ndarray, "m 128"]) -> Int64[np.ndarray, "k 2"]:
    """Numbers of features that are nearest to each other, and much nearer than the second nearest; by their
    ``directions``."""
    if min(len(own), len(other)) < 2:
        return np.zeros((0, 2), np.int64)
    alike = own @ other.T
    nearest = alike.argmax(axis=1)
    mutual = alike.argmax(axis=0)[nearest] == np.arange(len(own))
    second, first = np.sqrt((2 - 2 * np.partition(alike, -2, axis=1)[:, -2:]).clip(0)).T
    chosen = np.flatnonzero(mutual & (first < _RATIO * second))
    return np.stack([chosen, nearest[chosen]], axis=1)
