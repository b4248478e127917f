"""Flat Gaussians met by rays: the loops, for the CPU.

A disk's rows in ``frames`` [g, 3, 3] are H of the paper, in camera coordinates: H (u, v, 1) is the point at (u, v), in
standard deviations along its two axes. The ray through (x, y, 1) meets it where (x H_2 - H_0) and (y H_2 - H_1), planes
in (u, v, 1), meet (paper, eq. 8 to 10).
"""

import math

import numpy as np
from numba import njit, prange

_OPTIONS = {"fastmath": {"nsz", "contract"}, "error_model": "numpy", "cache": True, "nogil": True}
TILE = 16
BANDS = 8
"""Of tile rows, whose sums are kept apart: they do not depend on the number of threads."""
ALPHA_MIN, ALPHA_MAX, LEFT_MIN = 1.0 / 255.0, 0.99, 1e-4
NEAR, FAR = 0.2, 1000.0
"""Of what depths are mapped to for the distortion (paper, program): m = far / (far - near) (1 - near / z)."""
_MAP = FAR / (FAR - NEAR)
_SHARPEST = 0.5
"""Variance, square pixels, of what a disk is at least in the image (paper, eq. 11)."""
_FLAT = 1e-9


@njit(**_OPTIONS)
def tile_lists(order, boxes, columns, rows):
    """(disks of each tile, nearest first, tile by tile; where each tile's begin, and the end).

    ``boxes`` [g, 4] are the first and last tile columns and rows, the last exclusive; ``order`` is by depth.
    """
    starts = np.zeros(columns * rows + 1, np.int64)
    for g in order:
        for row in range(boxes[g, 2], boxes[g, 3]):
            for column in range(boxes[g, 0], boxes[g, 1]):
                starts[row * columns + column + 1] += 1
    for tile in range(columns * rows):
        starts[tile + 1] += starts[tile]
    lists, at = np.empty(starts[-1], np.int32), starts[:-1].copy()
    for g in order:
        for row in range(boxes[g, 2], boxes[g, 3]):
            for column in range(boxes[g, 0], boxes[g, 1]):
                tile = row * columns + column
                lists[at[tile]] = g
                at[tile] += 1
    return lists, starts


@njit(inline="always", **_OPTIONS)
def _meet(h, x, y, px, py, fx, fy, cx, cy):
    """(squared distance in standard deviations, u, v, depth, whether the ray meets the disk): else it is that from the
    blur around its centre."""
    a0, a1, a2 = x * h[2, 0] - h[0, 0], x * h[2, 1] - h[0, 1], x * h[2, 2] - h[0, 2]
    b0, b1, b2 = y * h[2, 0] - h[1, 0], y * h[2, 1] - h[1, 1], y * h[2, 2] - h[1, 2]
    k0, k1, k2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    right = px - (fx * h[0, 2] / h[2, 2] + cx)
    down = py - (fy * h[1, 2] / h[2, 2] + cy)
    blurred = (right * right + down * down) / _SHARPEST
    if abs(k2) > _FLAT * (abs(k0) + abs(k1) + abs(k2)):
        u, v = k0 / k2, k1 / k2
        depth = h[2, 0] * u + h[2, 1] * v + h[2, 2]
        away = u * u + v * v
        if away <= blurred and depth > 0:
            return away, u, v, depth, True
    return blurred, 0.0, 0.0, h[2, 2] * 1.0, False


@njit(parallel=True, **_OPTIONS)
def composite(frames, opacities, limits, features, lens, lists, starts, columns, out, moments, left, last):
    """Fill ``out`` [h, w, c + 1] with what features and depth add up to, ``moments`` [h, w, 3] with the sums of weight
    times 1, m and m^2, ``left`` [h, w] with the light that is left, and ``last`` with how much of the list counts.

    ``limits`` [g] are the squared distances beyond which a disk's opacity is below ``ALPHA_MIN``.
    """
    height, width, channels = out.shape[0], out.shape[1], features.shape[1]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for tile in prange(len(starts) - 1):
        for row in range(tile // columns * TILE, min((tile // columns + 1) * TILE, height)):
            for column in range(tile % columns * TILE, min((tile % columns + 1) * TILE, width)):
                px, py = column + 0.5, row + 0.5
                x, y = (px - cx) / fx, (py - cy) / fy
                light, count = 1.0, 0
                for c in range(channels + 1):
                    out[row, column, c] = 0
                w0, w1, w2 = 0.0, 0.0, 0.0
                for at in range(starts[tile], starts[tile + 1]):
                    g = lists[at]
                    away, _, _, depth, _ = _meet(frames[g], x, y, px, py, fx, fy, cx, cy)
                    if away > limits[g]:
                        continue
                    alpha = min(opacities[g] * math.exp(-0.5 * away), ALPHA_MAX)
                    weight = light * alpha
                    for c in range(channels):
                        out[row, column, c] += weight * features[g, c]
                    out[row, column, channels] += weight * depth
                    m = _MAP * (1 - NEAR / depth)
                    w0, w1, w2 = w0 + weight, w1 + weight * m, w2 + weight * m * m
                    light *= 1 - alpha
                    count = at + 1 - starts[tile]
                    if light < LEFT_MIN:
                        break
                left[row, column], last[row, column] = light, count
                moments[row, column, 0], moments[row, column, 1], moments[row, column, 2] = w0, w1, w2


@njit(parallel=True, **_OPTIONS)
def differentiate(
    frames, opacities, limits, features, lens, lists, starts, columns, moments, left, last, to_out, to_left,
    to_distortion, to_frames, to_opacities, to_features,
):  # fmt: skip
    """Add slopes by frames, opacities and features to those of each band, [bands, g, ...].

    The distortion is the sum over pairs of w_i w_j (m_i - m_j)^2: its slopes follow from the moments of all.
    """
    height, width, channels = to_out.shape[0], to_out.shape[1], features.shape[1]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    rows = (len(starts) - 1) // columns
    deep = -(-rows // BANDS)
    for band in prange(BANDS):
        for tile in range(band * deep * columns, min((band + 1) * deep, rows) * columns):
            for row in range(tile // columns * TILE, min((tile // columns + 1) * TILE, height)):
                for column in range(tile % columns * TILE, min((tile % columns + 1) * TILE, width)):
                    px, py = column + 0.5, row + 0.5
                    x, y = (px - cx) / fx, (py - cy) / fy
                    light, gone = 1.0 * left[row, column], to_left[row, column] * left[row, column]
                    w0, w1, w2 = moments[row, column, 0], moments[row, column, 1], moments[row, column, 2]
                    distorted = to_distortion[row, column]
                    for at in range(starts[tile] + last[row, column] - 1, starts[tile] - 1, -1):
                        g = lists[at]
                        h = frames[g]
                        away, u, v, depth, met = _meet(h, x, y, px, py, fx, fy, cx, cy)
                        if away > limits[g]:
                            continue
                        value = math.exp(-0.5 * away)
                        alpha = min(opacities[g] * value, ALPHA_MAX)
                        light /= 1 - alpha
                        weight = light * alpha
                        m = _MAP * (1 - NEAR / depth)
                        q = to_out[row, column, channels] * depth + distorted * (m * m * w0 - 2 * m * w1 + w2)
                        for c in range(channels):
                            q += to_out[row, column, c] * features[g, c]
                            to_features[band, g, c] += weight * to_out[row, column, c]
                        to_alpha = light * q - gone / (1 - alpha)
                        gone += weight * q
                        to_depth = weight * to_out[row, column, channels]
                        to_depth += distorted * 2 * weight * (m * w0 - w1) * _MAP * NEAR / (depth * depth)
                        to_value = 0.0
                        if opacities[g] * value < ALPHA_MAX:
                            to_opacities[band, g] += to_alpha * value
                            to_value = to_alpha * opacities[g]
                        to = to_frames[band, g]
                        if not met:
                            far = h[2, 2]
                            right = px - (fx * h[0, 2] / far + cx)
                            down = py - (fy * h[1, 2] / far + cy)
                            slope_x, slope_y = to_value * value * right / _SHARPEST, to_value * value * down / _SHARPEST
                            to[0, 2] += slope_x * fx / far
                            to[1, 2] += slope_y * fy / far
                            to[2, 2] += to_depth - (slope_x * fx * h[0, 2] + slope_y * fy * h[1, 2]) / (far * far)
                            continue
                        to[2, 0] += to_depth * u
                        to[2, 1] += to_depth * v
                        to[2, 2] += to_depth
                        du = to_depth * h[2, 0] - to_value * value * u
                        dv = to_depth * h[2, 1] - to_value * value * v
                        a0, a1, a2 = x * h[2, 0] - h[0, 0], x * h[2, 1] - h[0, 1], x * h[2, 2] - h[0, 2]
                        b0, b1, b2 = y * h[2, 0] - h[1, 0], y * h[2, 1] - h[1, 1], y * h[2, 2] - h[1, 2]
                        k2 = a0 * b1 - a1 * b0
                        d0, d1, d2 = du / k2, dv / k2, -(u * du + v * dv) / k2
                        # k = a x b: slopes by a are b x d, by b are d x a.
                        da0, da1, da2 = b1 * d2 - b2 * d1, b2 * d0 - b0 * d2, b0 * d1 - b1 * d0
                        db0, db1, db2 = d1 * a2 - d2 * a1, d2 * a0 - d0 * a2, d0 * a1 - d1 * a0
                        to[0, 0] -= da0
                        to[0, 1] -= da1
                        to[0, 2] -= da2
                        to[1, 0] -= db0
                        to[1, 1] -= db1
                        to[1, 2] -= db2
                        to[2, 0] += x * da0 + y * db0
                        to[2, 1] += x * da1 + y * db1
                        to[2, 2] += x * da2 + y * db2
