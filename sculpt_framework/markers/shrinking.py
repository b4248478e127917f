"""Black that has shrunk in photographs, told by a ring of markers: their sizes do not fit the distances between them.

Light is blurred before a camera encodes it, and white is over-exposed; either moves all edges of black inward by a
fraction of a pixel, and changes the focal length and the distance that are found by half a per cent.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float64

from sculpt_framework.markers.boards import Board
from sculpt_framework.markers.detection import Sighting

_MARKERS, _PHOTOGRAPHS = 4, 3
"""In so many photographs so many markers at least tell by how much."""
_STRAY = 6.0
"""Corners that are so many pixels off a plane are not asked."""
_MOST = 1.0
"""Pixels: by more than that black does not shrink, and something else is wrong."""

Corners = Float64[np.ndarray, "m 4 2"]
"""Of markers, clockwise as seen."""


def without_shrinking(board: Board, sightings: Sequence[Sighting]) -> list[Sighting]:
    """Sightings of a ring with the edges of markers moved outward by what they have shrunk, where that can be told.

    It is the median over the photographs: one alone tells it to a few hundredths of a pixel, which sways a calibration.
    """
    places, told = board.points()[:, :2], []
    for sighting in sightings:
        shift = shrinkage(places[sighting.points].reshape(-1, 4, 2), sighting.pixels.reshape(-1, 4, 2))
        told += [] if shift is None else [shift]
    shift = float(np.median(told)) if len(told) >= _PHOTOGRAPHS else 0.0
    if not 0 < abs(shift) <= _MOST:
        return list(sightings)
    return [replace(one, pixels=grown(one.pixels.reshape(-1, 4, 2), shift).reshape(-1, 2)) for one in sightings]


def shrinkage(places: Corners, corners: Corners) -> float | None:
    """By how many pixels all edges have moved inward; None where that cannot be told.

    ``places`` are the corners on the board, which is flat. A lens may bend it: that is smooth over the board, and is
    fitted by a polynomial of degree three beside the plane's projection, while edges that shrink change their way from
    corner to corner.
    """
    if len(corners) < _MARKERS:
        return None
    flat, pixels = places.reshape(-1, 2), corners.reshape(-1, 2)
    plane, fits = cv2.findHomography(flat, pixels, cv2.RANSAC, _STRAY)
    if plane is None or fits.sum() < 4 * _MARKERS:
        return None
    near = fits[:, 0] > 0
    off_plane = cv2.perspectiveTransform(flat[near, None], plane)[:, 0] - pixels[near]
    x, y = ((flat[near] - flat[near].mean(axis=0)) / np.abs(flat).max()).T
    smooth = np.stack([x**a * y**b for a in range(4) for b in range(4 - a)], axis=1)
    none = np.zeros_like(smooth)
    design = np.block([[smooth, none], [none, smooth]])
    both = np.stack([_outward(corners).reshape(-1, 2)[near].T.reshape(-1), off_plane.T.reshape(-1)], axis=1)
    # Of what is not smooth, the part that is along the edges' way.
    outward, off = (both - design @ np.linalg.lstsq(design, both, rcond=None)[0]).T
    told = float(outward @ outward)
    return float(outward @ off) / told if told > 1e-6 else None


def grown(corners: Corners, shift: float) -> Corners:
    """With each edge moved outward by ``shift`` pixels."""
    return corners + shift * _outward(corners)


def _outward(corners: Corners) -> Corners:
    """How each corner moves if the two edges that meet there move outward by one pixel; finite for any corners."""
    along = np.roll(corners, -1, axis=1) - corners
    lengths = np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
    after = np.stack([along[..., 1], -along[..., 0]], axis=2) / lengths
    before = np.roll(after, 1, axis=1)
    return (after + before) / np.maximum(1 + (after * before).sum(axis=2, keepdims=True), 1e-3)
