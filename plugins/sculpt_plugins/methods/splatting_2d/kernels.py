"""Flat Gaussians met by rays: the loops, for the CPU.

A disk's rows in ``frames`` [g, 3, 3] are H of the paper, in camera coordinates: H (u, v, 1) is the point at (u, v), in
standard deviations along its two axes. The ray through (x, y, 1) meets it where the planes a = x H_2 - H_0 and
b = y H_2 - H_1 of (u, v, 1) meet, at k = a x b (paper, eq. 8 to 10). Along a row of pixels k is linear in x, so that
the pixels within so many standard deviations are those between the roots of a quadratic: no other is looked at.
"""

import math

import numpy as np
from numba import njit, prange

from sculpt_framework.free_gaussians.row_kernels import (
    ALPHA_MAX,
    BANDS,
    LEFT_MIN,
    MAP,
    NEAR,
    OPTIONS,
    TILE,
    exponential,
)

_SHARPEST = 0.5
"""Variance, square pixels, of what a disk is at least in the image (paper, eq. 11)."""
_FLAT = 1e-9
_LIGHT, _GONE, _LAST, _DISTORTED, _W0, _W1, _W2, _SUMS = range(8)
_MEDIAN = _DISTORTED
"""Planes of a tile's pixels: light left, slope of the loss by it times it, how much of the list counts, slope by the
distortion or, where there is no loss yet, the median depth, moments; then depth and features."""
_ALPHA, _VALUE, _X, _DEPTH, _U, _V, _INVERSE, _WEIGHT, _Q, _TO_FRAME, _TO_OPACITY, _TO_FEATURES = *range(10), 18, 19
"""Rows of lanes: of where a ray meets a disk, weights, and what is added up for the disk."""


@njit(forceinline=True, **OPTIONS)
def _row_of(h, y, start, slope):
    """k = ``start`` + x ``slope`` [3] along the row of pixels with this y."""
    b0, b1, b2 = y * h[2, 0] - h[1, 0], y * h[2, 1] - h[1, 1], y * h[2, 2] - h[1, 2]
    start[0] = h[0, 2] * b1 - h[0, 1] * b2
    start[1] = h[0, 0] * b2 - h[0, 2] * b0
    start[2] = h[0, 1] * b0 - h[0, 0] * b1
    slope[0] = h[2, 1] * b2 - h[2, 2] * b1
    slope[1] = h[2, 2] * b0 - h[2, 0] * b2
    slope[2] = h[2, 0] * b1 - h[2, 1] * b0


@njit(forceinline=True, **OPTIONS)
def _misses(start, slope, limit, across, down, fx, cx, first, last):
    """Whether none of the row's pixels from column ``first`` to ``last`` (exclusive) is within the limit.

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
    # A hair more, for rounding: what is beyond the limit is told apart again.
    return not (low <= high and low <= last + 0.01 and high >= first - 0.01)


@njit(forceinline=True, **OPTIONS)
def _meet(h, start, slope, limit, opacity, side, across, down, fx, cx, lanes):
    """Where the rays of a row meet the disk: coordinates and depth. A ray that does not, or for which the blur around
    the disk's centre is nearer, has that in place: then ``_INVERSE``, one over k's third component, is 0."""
    k0, k1, k2 = start[0], start[1], start[2]
    l0, l1, l2 = slope[0], slope[1], slope[2]
    g0, g1, g2 = h[2, 0], h[2, 1], h[2, 2]
    for lane in range(TILE):
        column = side + lane + 0.5
        x, right = (column - cx) / fx, column - across
        m0, m1, m2 = k0 + x * l0, k1 + x * l1, k2 + x * l2
        inverse = 1 / m2
        u, v = m0 * inverse, m1 * inverse
        depth, away = g0 * u + g1 * v + g2, u * u + v * v
        blurred = (right * right + down * down) / _SHARPEST
        met = (abs(m2) > _FLAT * (abs(m0) + abs(m1))) & (away <= blurred) & (depth > 0)
        away = away if met else blurred
        value = exponential(max(-0.5 * away, -6.0))
        lanes[_ALPHA, lane] = min(opacity * value, ALPHA_MAX) if away <= limit else 0.0
        lanes[_VALUE, lane] = value
        lanes[_X, lane] = x
        lanes[_DEPTH, lane] = depth if met else g2
        lanes[_U, lane] = u if met else 0.0
        lanes[_V, lane] = v if met else 0.0
        lanes[_INVERSE, lane] = inverse if met else 0.0


@njit(parallel=True, **OPTIONS)
def composite(frames, opacities, limits, features, lens, lists, starts, columns, out, moments, left, last, median):
    """Fill ``out`` [h, w, c + 1] with what features and depth add up to, ``moments`` [h, w, 3] with the sums of weight
    times 1, m and m^2, ``left`` [h, w] with the light that is left, ``last`` with how much of the list counts, and
    ``median`` [h, w] with the depth of the farthest disk that more than half of the light reaches; 0 is none.

    ``limits`` [g] are the squared distances beyond which a disk's opacity is below ``ALPHA_MIN``.
    """
    height, width, channels = out.shape[0], out.shape[1], features.shape[1]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for tile in prange(len(starts) - 1):
        top, side = tile // columns * TILE, tile % columns * TILE
        bottom, end = min(top + TILE, height), min(side + TILE, width)
        start, slope = np.empty(3), np.empty(3)
        lanes, planes = np.empty((_Q, TILE)), np.zeros((_SUMS + 1 + channels, TILE, TILE))
        # Beyond the image there is no light, so that nothing is seen there.
        planes[_LIGHT, : bottom - top, : end - side] = 1
        lit = (bottom - top) * (end - side)
        for at in range(starts[tile], starts[tile + 1]):
            if lit == 0:
                break
            g = lists[at]
            h, limit, opacity = frames[g], limits[g], opacities[g]
            across, below = fx * h[0, 2] / h[2, 2] + cx, fy * h[1, 2] / h[2, 2] + cy
            number = 1.0 * (at + 1 - starts[tile])
            for row in range(bottom - top):
                down = top + row + 0.5 - below
                _row_of(h, (top + row + 0.5 - cy) / fy, start, slope)
                if _misses(start, slope, limit, across, down, fx, cx, side, end):
                    continue
                _meet(h, start, slope, limit, opacity, side, across, down, fx, cx, lanes)
                dark = 0
                for lane in range(TILE):
                    light, depth = planes[_LIGHT, row, lane], lanes[_DEPTH, lane]
                    alpha = lanes[_ALPHA, lane] if light >= LEFT_MIN else 0.0
                    weight = light * alpha
                    after = light - weight
                    m = MAP * (1 - NEAR / depth)
                    lanes[_WEIGHT, lane] = weight
                    planes[_W0, row, lane] += weight
                    planes[_W1, row, lane] += weight * m
                    planes[_W2, row, lane] += weight * m * m
                    planes[_SUMS, row, lane] += weight * depth
                    planes[_LIGHT, row, lane] = after
                    planes[_LAST, row, lane] = number if alpha > 0 else planes[_LAST, row, lane]
                    middle = (alpha > 0) & (light > 0.5)
                    planes[_MEDIAN, row, lane] = depth if middle else planes[_MEDIAN, row, lane]
                    dark += (light >= LEFT_MIN) & (after < LEFT_MIN)
                lit -= dark
                for c in range(channels):
                    feature = 1.0 * features[g, c]
                    for lane in range(TILE):
                        planes[_SUMS + 1 + c, row, lane] += lanes[_WEIGHT, lane] * feature
        for row in range(bottom - top):
            for lane in range(end - side):
                for c in range(channels):
                    out[top + row, side + lane, c] = planes[_SUMS + 1 + c, row, lane]
                out[top + row, side + lane, channels] = planes[_SUMS, row, lane]
                for i in range(3):
                    moments[top + row, side + lane, i] = planes[_W0 + i, row, lane]
                left[top + row, side + lane] = planes[_LIGHT, row, lane]
                last[top + row, side + lane] = int(planes[_LAST, row, lane])
                median[top + row, side + lane] = planes[_MEDIAN, row, lane]


@njit(parallel=True, **OPTIONS)
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
        lanes, planes = np.empty((_TO_FEATURES + channels, TILE)), np.empty((_SUMS + 1 + channels, TILE, TILE))
        for tile in range(band * deep * columns, min((band + 1) * deep, rows) * columns):
            top, side = tile // columns * TILE, tile % columns * TILE
            bottom, end = min(top + TILE, height), min(side + TILE, width)
            planes[:] = 0
            most = 0
            for row in range(bottom - top):
                for lane in range(end - side):
                    y, x = top + row, side + lane
                    planes[_LIGHT, row, lane] = left[y, x]
                    planes[_GONE, row, lane] = to_left[y, x] * left[y, x]
                    planes[_LAST, row, lane] = last[y, x]
                    planes[_DISTORTED, row, lane] = to_distortion[y, x]
                    for i in range(3):
                        planes[_W0 + i, row, lane] = moments[y, x, i]
                    planes[_SUMS, row, lane] = to_out[y, x, channels]
                    for c in range(channels):
                        planes[_SUMS + 1 + c, row, lane] = to_out[y, x, c]
                    most = max(most, last[y, x])
            for place in range(most - 1, -1, -1):
                g = lists[starts[tile] + place]
                h, limit, opacity = frames[g], limits[g], opacities[g]
                across, below = fx * h[0, 2] / h[2, 2] + cx, fy * h[1, 2] / h[2, 2] + cy
                lanes[_TO_FRAME:] = 0
                for row in range(bottom - top):
                    down, y = top + row + 0.5 - below, (top + row + 0.5 - cy) / fy
                    _row_of(h, y, start, slope)
                    if _misses(start, slope, limit, across, down, fx, cx, side, end):
                        continue
                    _meet(h, start, slope, limit, opacity, side, across, down, fx, cx, lanes)
                    for lane in range(TILE):
                        depth = lanes[_DEPTH, lane]
                        alpha = lanes[_ALPHA, lane] if place < planes[_LAST, row, lane] else 0.0
                        light = planes[_LIGHT, row, lane] / (1 - alpha)
                        m = MAP * (1 - NEAR / depth)
                        spread = m * m * planes[_W0, row, lane] - 2 * m * planes[_W1, row, lane]
                        spread += planes[_W2, row, lane]
                        lanes[_ALPHA, lane] = alpha
                        lanes[_WEIGHT, lane] = light * alpha
                        lanes[_Q, lane] = planes[_SUMS, row, lane] * depth + planes[_DISTORTED, row, lane] * spread
                        planes[_LIGHT, row, lane] = light
                    for c in range(channels):
                        feature = 1.0 * features[g, c]
                        for lane in range(TILE):
                            to = planes[_SUMS + 1 + c, row, lane]
                            lanes[_Q, lane] += to * feature
                            lanes[_TO_FEATURES + c, lane] += lanes[_WEIGHT, lane] * to
                    _slopes_of_row(h, opacity, row, side, y, across, down, fx, fy, lanes, planes)
                for lane in range(TILE):
                    to_opacities[band, g] += lanes[_TO_OPACITY, lane]
                    for i in range(3):
                        for j in range(3):
                            to_frames[band, g, i, j] += lanes[_TO_FRAME + 3 * i + j, lane]
                    for c in range(channels):
                        to_features[band, g, c] += lanes[_TO_FEATURES + c, lane]


@njit(forceinline=True, **OPTIONS)
def _slopes_of_row(h, opacity, row, side, y, across, down, fx, fy, lanes, planes):
    """Add a row's slopes by the disk's frame and opacity, lane by lane."""
    h00, h01, h02 = h[0, 0], h[0, 1], h[0, 2]
    h10, h11, h12 = h[1, 0], h[1, 1], h[1, 2]
    h20, h21, h22 = h[2, 0], h[2, 1], h[2, 2]
    b0, b1, b2 = y * h20 - h10, y * h21 - h11, y * h22 - h12
    for lane in range(TILE):
        alpha, value, weight, q = lanes[_ALPHA, lane], lanes[_VALUE, lane], lanes[_WEIGHT, lane], lanes[_Q, lane]
        u, v, inverse = lanes[_U, lane], lanes[_V, lane], lanes[_INVERSE, lane]
        x, depth = lanes[_X, lane], lanes[_DEPTH, lane]
        gone = planes[_GONE, row, lane]
        to_alpha = planes[_LIGHT, row, lane] * q - gone / (1 - alpha)
        planes[_GONE, row, lane] = gone + weight * q
        # Those that do not count, and those that are as opaque as can be, have no slope.
        to_alpha = to_alpha if (alpha > 0) & (opacity * value < ALPHA_MAX) else 0.0
        m = MAP * (1 - NEAR / depth)
        pulled = m * planes[_W0, row, lane] - planes[_W1, row, lane]
        to_depth = weight * planes[_SUMS, row, lane]
        to_depth += planes[_DISTORTED, row, lane] * 2 * weight * pulled * MAP * NEAR / (depth * depth)
        to_exponent = to_alpha * opacity * value
        met = inverse != 0
        # Of the blur: by where the disk's centre is in the image.
        right = side + lane + 0.5 - across
        blur_x = 0.0 if met else to_exponent * right / _SHARPEST * fx / h22
        blur_y = 0.0 if met else to_exponent * down / _SHARPEST * fy / h22
        # Where the ray meets the disk: k = a x b, slopes by a are b x d, by b are d x a.
        du = to_depth * h20 - to_exponent * u
        dv = to_depth * h21 - to_exponent * v
        d0, d1, d2 = du * inverse, dv * inverse, -(u * du + v * dv) * inverse
        a0, a1, a2 = x * h20 - h00, x * h21 - h01, x * h22 - h02
        da0, da1, da2 = b1 * d2 - b2 * d1, b2 * d0 - b0 * d2, b0 * d1 - b1 * d0
        db0, db1, db2 = d1 * a2 - d2 * a1, d2 * a0 - d0 * a2, d0 * a1 - d1 * a0
        lanes[_TO_OPACITY, lane] += to_alpha * value
        lanes[_TO_FRAME, lane] -= da0
        lanes[_TO_FRAME + 1, lane] -= da1
        lanes[_TO_FRAME + 2, lane] += blur_x - da2
        lanes[_TO_FRAME + 3, lane] -= db0
        lanes[_TO_FRAME + 4, lane] -= db1
        lanes[_TO_FRAME + 5, lane] += blur_y - db2
        lanes[_TO_FRAME + 6, lane] += to_depth * u + x * da0 + y * db0
        lanes[_TO_FRAME + 7, lane] += to_depth * v + x * da1 + y * db1
        lanes[_TO_FRAME + 8, lane] += to_depth + x * da2 + y * db2 - (blur_x * h02 + blur_y * h12) / h22
