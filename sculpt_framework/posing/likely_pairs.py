"""Which photographs most likely show the same, by a few features of each: comparing all takes minutes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from sculpt_framework.posing.features import matches, read_features

PARTNERS = 16
"""Of each image."""
_STRIDE = 5
"""Every so many images, one is compared with all others chosen so: other sides, and other passes."""


def likely_pairs(database: Path, names: Sequence[str]) -> list[tuple[str, str]]:
    """Of all pairs of these images, whose features the database has, those of an image with its likeliest partners, and
    those of every fifth with every fifth."""
    chosen = _with_best(_common([each.largest().directions() for each in read_features(database, names)]))
    chosen[::_STRIDE, ::_STRIDE] = True
    first, second = np.nonzero(np.triu(chosen, 1))
    return [(names[i], names[j]) for i, j in zip(first.tolist(), second.tolist(), strict=True)]


def _common(features: Sequence[Float32[np.ndarray, "_ 128"]]) -> Int64[np.ndarray, "v v"]:
    """How many features two images have in common."""
    count = np.zeros((len(features), len(features)), np.int64)
    for i, own in enumerate(features):
        for j in range(i + 1, len(features)):
            count[i, j] = count[j, i] = len(matches(own, features[j]))
    return count


def _with_best(count: Int64[np.ndarray, "v v"]) -> np.ndarray:
    chosen = np.zeros(count.shape, bool)
    best = np.argsort(-count, axis=1, kind="stable")[:, :PARTNERS]
    np.put_along_axis(chosen, best, True, axis=1)
    return chosen | chosen.T
