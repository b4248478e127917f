"""Flat Gaussians met by rays: the loops, for the CPU.

A disk's rows in ``frames`` [g, 3, 3] are H of the paper, in camera coordinates: H (u, v, 1) is the point at (u, v), in
standard deviations along its two axes. The ray through (x, y, 1) meets it where the planes a = x H_2 - H_0 and
b = y H_2 - H_1 of (u, v, 1) meet, at k = a x b (paper, eq. 8 to 10). Along a row of pixels k is linear in x, so that
the pixels within so many standard deviations are those between the roots of a quadratic: no other is looked at.
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
"""Of what depths are mapped to for the distortion: m = far / (far - near) (1 - near / z), object units."""
_MAP = FAR / (FAR - NEAR)
_SHARPEST = 0.5
"""Variance, square pixels, of what a disk is at least in the image (paper, eq. 11)."""
_FLAT = 1e-9


@njit(inline="always", **_OPTIONS)
def _row_of(h, y, start, slope):
    """k = ``start`` + x ``slope`` [3] along the row of pixels with this y."""
    b0, b1, b2 = y * h[2, 0] - h[1, 0], y * h[2, 1] - h[1, 1], y * h[2, 2] - h[1, 2]
    start[0] = h[0, 2] * b1 - h[0, 1] * b2
    start[1] = h[0, 0] * b2 - h[0, 2] * b0
    start[2] = h[0, 1] * b0 - h[0, 0] * b1
    slope[0] = h[2, 1] * b2 - h[2, 2] * b1
    slope[1] = h[2, 2] * b0 - h[2, 0] * b2
    slope[2] = h[2, 0] * b1 - h[2, 1] * b0


@njit(inline="always", **_OPTIONS)
def _columns_of(start, slope, limit, across, down, fx, cx, first, last):
    """The columns, from and to (exclusive), of those from ``first`` to ``last`` that are within the limit.

    ``across`` is the column of the disk's centre, ``down`` how far below it the row is, in pixels: its blur counts too.
    """
    a = slope[0] * slope[0] + slope[1] * slope[1] - limit * slope[2] * slope[2]
    b = start[0] * slope[0] + start[1] * slope[1] - limit * start[2] * slope[2]
    c = start[0] * start[0] + start[1] * start[1] - limit * start[2] * start[2]
    low, high = math.inf, -math.inf
    if a > 0:
        root = b * b - a * c
        if root >= 0:
            root = math.sqrt(root)
            low, high = (-b - root) / a * fx + cx, (-b + root) / a * fx + cx
    else:
        # The limit reaches to where the disk is seen edge on, or behind the camera.
        low, high = -math.inf, math.inf
    width = limit * _SHARPEST - down * down
    if width > 0:
        width = math.sqrt(width)
        low, high = min(low, across - width), max(high, across + width)
    if not low <= high:
        return first, first
    # A hair more, for rounding: what is beyond the limit is told apart again.
    left = first if low < first else min(int(low - 0.51), last)
    right = last if high > last else max(int(high + 1.51), first)
    return max(left, first), min(right, last)


@njit(inline="always", **_OPTIONS)
def _meet(h, start, slope, x, right, down):
    """(squared distance in standard deviations, u, v, depth, whether the ray meets the disk): else it is that from the
    blur around its centre, ``right`` and ``down`` pixels away."""
    k0, k1, k2 = start[0] + x * slope[0], start[1] + x * slope[1], start[2] + x * slope[2]
    blurred = (right * right + down * down) / _SHARPEST
    if abs(k2) > _FLAT * (abs(k0) + abs(k1)):
        u, v = k0 / k2, k1 / k2
        depth = h[2, 0] * u + h[2, 1] * v + h[2, 2]
        away = u * u + v * v
        if away <= blurred and depth > 0:
            return away, u, v, depth, True
    return blurred, 0.0, 0.0, 1.0 * h[2, 2], False


@njit(parallel=True, **_OPTIONS)
def composite(frames, opacities, limits, features, lens, lists, starts, columns, out, moments, left, last):
    """Fill ``out`` [h, w, c + 1] with what features and depth add up to, ``moments`` [h, w, 3] with the sums of weight
    times 1, m and m^2, ``left`` [h, w] with the light that is left, and ``last`` with how much of the list counts.

    ``limits`` [g] are the squared distances beyond which a disk's opacity is below ``ALPHA_MIN``.
    """
    height, width, channels = out.shape[0], out.shape[1], features.shape[1]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for tile in prange(len(starts) - 1):
        top, side = tile // columns * TILE, tile % columns * TILE
        bottom, end = min(top + TILE, height), min(side + TILE, width)
        out[top:bottom, side:end] = 0
        moments[top:bottom, side:end] = 0
        left[top:bottom, side:end] = 1
        last[top:bottom, side:end] = 0
        start, slope = np.empty(3), np.empty(3)
        lit = (bottom - top) * (end - side)
        for at in range(starts[tile], starts[tile + 1]):
            if lit == 0:
                break
            g = lists[at]
            h, limit = frames[g], limits[g]
            across, below = fx * h[0, 2] / h[2, 2] + cx, fy * h[1, 2] / h[2, 2] + cy
            for row in range(top, bottom):
                down = row + 0.5 - below
                _row_of(h, (row + 0.5 - cy) / fy, start, slope)
                first, beyond = _columns_of(start, slope, limit, across, down, fx, cx, side, end)
                for column in range(first, beyond):
                    light = left[row, column]
                    if light < LEFT_MIN:
                        continue
                    px = column + 0.5
                    away, _, _, depth, _ = _meet(h, start, slope, (px - cx) / fx, px - across, down)
                    if away > limit:
                        continue
                    alpha = min(opacities[g] * math.exp(-0.5 * away), ALPHA_MAX)
                    weight = light * alpha
                    for c in range(channels):
                        out[row, column, c] += weight * features[g, c]
                    out[row, column, channels] += weight * depth
                    m = _MAP * (1 - NEAR / depth)
                    moments[row, column, 0] += weight
                    moments[row, column, 1] += weight * m
                    moments[row, column, 2] += weight * m * m
                    light *= 1 - alpha
                    left[row, column] = light
                    last[row, column] = at + 1 - starts[tile]
                    lit -= light < LEFT_MIN


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
        start, slope = np.empty(3), np.empty(3)
        lights, gone = np.empty((TILE, TILE)), np.empty((TILE, TILE))
        to = np.empty((3, 3))
        for tile in range(band * deep * columns, min((band + 1) * deep, rows) * columns):
            top, side = tile // columns * TILE, tile % columns * TILE
            bottom, end = min(top + TILE, height), min(side + TILE, width)
            most = 0
            for row in range(top, bottom):
                for column in range(side, end):
                    light = left[row, column]
                    lights[row - top, column - side] = light
                    gone[row - top, column - side] = to_left[row, column] * light
                    most = max(most, last[row, column])
            for place in range(most - 1, -1, -1):
                g = lists[starts[tile] + place]
                h, limit, opacity = frames[g], limits[g], opacities[g]
                far = h[2, 2]
                across, below = fx * h[0, 2] / far + cx, fy * h[1, 2] / far + cy
                to[:] = 0
                to_opacity = 0.0
                for row in range(top, bottom):
                    down = row + 0.5 - below
                    y = (row + 0.5 - cy) / fy
                    _row_of(h, y, start, slope)
                    first, beyond = _columns_of(start, slope, limit, across, down, fx, cx, side, end)
                    for column in range(first, beyond):
                        if place >= last[row, column]:
                            continue
                        px = column + 0.5
                        x, right = (px - cx) / fx, px - across
                        away, u, v, depth, met = _meet(h, start, slope, x, right, down)
                        if away > limit:
                            continue
                        value = math.exp(-0.5 * away)
                        alpha = min(opacity * value, ALPHA_MAX)
                        light = lights[row - top, column - side] / (1 - alpha)
                        lights[row - top, column - side] = light
                        weight = light * alpha
                        m = _MAP * (1 - NEAR / depth)
                        distorted, by_depth = to_distortion[row, column], to_out[row, column, channels]
                        w0, w1, w2 = moments[row, column, 0], moments[row, column, 1], moments[row, column, 2]
                        q = by_depth * depth + distorted * (m * m * w0 - 2 * m * w1 + w2)
                        for c in range(channels):
                            q += to_out[row, column, c] * features[g, c]
                            to_features[band, g, c] += weight * to_out[row, column, c]
                        to_alpha = light * q - gone[row - top, column - side] / (1 - alpha)
                        gone[row - top, column - side] += weight * q
                        to_depth = weight * by_depth
                        to_depth += distorted * 2 * weight * (m * w0 - w1) * _MAP * NEAR / (depth * depth)
                        to_value = 0.0
                        if opacity * value < ALPHA_MAX:
                            to_opacity += to_alpha * value
                            to_value = to_alpha * opacity
                        if not met:
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
                        k2 = start[2] + x * slope[2]
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
                to_opacities[band, g] += to_opacity
                for i in range(3):
                    for j in range(3):
                        to_frames[band, g, i, j] += to[i, j]
