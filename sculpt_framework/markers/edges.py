"""Corners of markers as crossings of lines fitted to their edges.

OpenCV's refinement of a corner alone moves it a quarter of a pixel into the marker, which makes a marker of 60 pixels
half a per cent too small. An edge stays where it is in a blurred photograph.
"""

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

_ALONG, _ROUNDS = 24, 2
"""Places along an edge at which it is looked for, and how often."""
_ENDS = 0.12
"""Part of an edge that is left out at each end, where the corners' blur bends it."""
_REACH, _STEP = (1.5, 6.0), 0.25
"""How far to each side of the edge is looked, in pixels: at least and at most; and in which steps."""
_OF_MODULE = 0.6
"""The same in modules of the marker: the black border is one module wide."""
_WEAK = 0.4
"""Of the steepest change across an edge; what is below is noise."""
_TRUST = 1.5
"""A corner that would move farther than this, in reaches, is left where it was."""


def corners_from_edges(
    grey: UInt8[np.ndarray, "h w"], corners: Float32[np.ndarray, "m 4 2"], modules: int
) -> Float64[np.ndarray, "m 4 2"]:
    """The corners of black markers on white, moved to where their edges cross.

    ``corners`` are within a pixel or two, clockwise, pixel centres at whole numbers; ``modules`` along a marker's side.
    """
    moved = corners.astype(np.float64)
    if not len(moved):
        return moved
    for _ in range(_ROUNDS):
        moved = _crossings(grey, moved, modules)
    return moved


def _crossings(
    grey: UInt8[np.ndarray, "h w"], corners: Float64[np.ndarray, "m 4 2"], modules: int
) -> Float64[np.ndarray, "m 4 2"]:
    after = np.roll(corners, -1, axis=1)
    along = after - corners
    lengths = np.linalg.norm(along, axis=2)
    # Clockwise as seen, with rows downwards: the outside is to the left of the way.
    outward = np.stack([along[..., 1], -along[..., 0]], axis=2) / lengths[..., None]
    reach = np.clip(_OF_MODULE * lengths.min(axis=1) / modules, *_REACH)
    across = np.arange(-1, 1 + 1e-9, _STEP / _REACH[1])[None] * reach[:, None]
    share = np.linspace(_ENDS, 1 - _ENDS, _ALONG)
    middle = corners[:, :, None] + share[:, None] * along[:, :, None]
    places = middle[..., None, :] + across[:, None, None, :, None] * outward[:, :, None, None]
    m, _, n, k, _ = places.shape
    flat = places.reshape(m * 4 * n, k, 2).astype(np.float32)
    border = cv2.BORDER_REPLICATE
    values = cv2.remap(grey.astype(np.float32), flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=border)
    rise = np.diff(values.reshape(m, 4, n, k), axis=3)
    strongest = rise.max(axis=3, keepdims=True)
    weight = np.where(rise > _WEAK * strongest, rise, 0.0)
    total = weight.sum(axis=3)
    between = 0.5 * (across[:, 1:] + across[:, :-1])[:, None, None]
    offset = np.where(total > 0, (weight * between).sum(axis=3) / np.maximum(total, 1e-9), 0.0)
    clear = (strongest[..., 0] > 0.5 * np.median(strongest[..., 0], axis=2, keepdims=True)) & (total > 0)
    lines = _lines(share, offset, clear)
    return _meet(corners, along, outward, lines, _TRUST * reach)


def _lines(
    share: Float64[np.ndarray, " n"], offset: Float64[np.ndarray, "m 4 n"], clear: np.ndarray
) -> Float64[np.ndarray, "m 4 2"]:
    """How far outward each edge lies at its start and at its end, fitted without what is far from most."""
    weight = clear.astype(np.float64)
    fitted = np.zeros((*offset.shape[:2], 2))
    design = np.stack([1 - share, share], axis=1)
    for _ in range(3):
        normal = np.einsum("mek,ka,kb->meab", weight, design, design) + 1e-9 * np.eye(2)
        fitted = np.linalg.solve(normal, np.einsum("mek,ka,mek->mea", weight, design, offset)[..., None])[..., 0]
        away = np.abs(offset - fitted @ design.T)
        usual = np.median(away, axis=2, keepdims=True)
        weight = clear * (away <= np.maximum(3 * usual, 0.1))
    return fitted


def _meet(
    corners: Float64[np.ndarray, "m 4 2"],
    along: Float64[np.ndarray, "m 4 2"],
    outward: Float64[np.ndarray, "m 4 2"],
    lines: Float64[np.ndarray, "m 4 2"],
    farthest: Float64[np.ndarray, " m"],
) -> Float64[np.ndarray, "m 4 2"]:
    """Where each edge crosses the one before it."""
    start = corners + lines[..., :1] * outward
    way = along + (lines[..., 1:] - lines[..., :1]) * outward
    before, way_before = np.roll(start, 1, axis=1), np.roll(way, 1, axis=1)
    gap = start - before
    cross = way_before[..., 0] * way[..., 1] - way_before[..., 1] * way[..., 0]
    steps = (gap[..., 0] * way[..., 1] - gap[..., 1] * way[..., 0]) / np.where(np.abs(cross) > 1e-9, cross, np.inf)
    met = before + steps[..., None] * way_before
    near = np.linalg.norm(met - corners, axis=2) <= farthest[:, None]
    return np.where((near & (np.abs(cross) > 1e-9))[..., None], met, corners)
