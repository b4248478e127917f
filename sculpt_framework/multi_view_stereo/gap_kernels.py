"""Depths across the gaps of depth maps: the loop, for the CPU."""

import numpy as np
from numba import njit

# No "nnan" and "ninf": rays along a plane meet it nowhere.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_HALF, _ZERO = np.float32(0.5), np.float32(0)
_GRAZING = np.float32(-0.1)
"""Cosine between a normal and a line of sight above which a plane is seen at too flat an angle to go on."""


@njit(**_OPTIONS)
def bridge(depths, normals, confidence, inside, lens, reach, least, near, alike, found, turned, sureness):
    """Fill ``found`` [h, w], ``turned`` [h, w, 3] and ``sureness`` [h, w] with the depth, normal and confidence of the
    pixels that are ``inside`` and have no depth; 0 elsewhere, and where the planes around do not tell.

    Asked are the planes of the pixels within ``reach``: at least this share of those inside must have one, and it must
    be met at a depth within ``near`` of the median in this share (``alike``) of them. The confidence is their mean,
    times the latter share.
    """
    height, width = depths.shape
    most = (2 * reach + 1) ** 2
    guesses, places = np.empty(most, np.float32), np.empty(most, np.int32)
    for row in range(height):
        y = (np.float32(row) + _HALF - lens[3]) / lens[1]
        for column in range(width):
            found[row, column], sureness[row, column] = _ZERO, _ZERO
            if depths[row, column] > 0 or not inside[row, column]:
                continue
            x = (np.float32(column) + _HALF - lens[2]) / lens[0]
            asked, told, total = 0, 0, _ZERO
            for i in range(max(0, row - reach), min(height, row + reach + 1)):
                for j in range(max(0, column - reach), min(width, column + reach + 1)):
                    if not inside[i, j]:
                        continue
                    asked += 1
                    depth = depths[i, j]
                    if not depth > 0:
                        continue
                    a, b, c = normals[i, j, 0], normals[i, j, 1], normals[i, j, 2]
                    there_x = (np.float32(j) + _HALF - lens[2]) / lens[0]
                    there_y = (np.float32(i) + _HALF - lens[3]) / lens[1]
                    here, there = a * x + b * y + c, a * there_x + b * there_y + c
                    if here < _GRAZING and there < _GRAZING:
                        guesses[told], places[told] = depth * there / here, i * width + j
                        total += confidence[i, j]
                        told += 1
            if told == 0 or told < least * asked:
                continue
            median = np.median(guesses[:told])
            agreeing, nearest, at = 0, np.float32(np.inf), 0
            for n in range(told):
                away = abs(guesses[n] - median)
                agreeing += away < near
                if away < nearest:
                    nearest, at = away, places[n]
            if agreeing < alike * told:
                continue
            found[row, column] = median
            turned[row, column] = normals[at // width, at % width]
            sureness[row, column] = total * np.float32(agreeing) / np.float32(told * told)
