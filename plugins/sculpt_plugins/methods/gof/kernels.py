"""Gaussians met by rays: the loops, for the CPU.

``whites`` [g, 3, 3], M, bring offsets in camera coordinates to standard deviations along a Gaussian's axes, ``centers``
[g, 3] are mu. Along the ray through d = (x, y, 1) a Gaussian is one of one dimension (paper, eq. 5 to 7): its peak is
at the depth z = w . M mu / w . w, w = M d, where the squared standard deviations that are left are
|cof(M) (mu x d)|^2 / |w|^2. Both vectors are linear in x along a row of pixels, so that the pixels within so many
standard deviations are those between the roots of a quadratic: no other is looked at.
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
_FRONT = 1e-2
"""Object units in front of the camera: peaks that are nearer are not seen."""


@njit(inline="always", **_OPTIONS)
def _cofactors(m, out):
    """``out`` (a x b) is M a x M b."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, 0] = m[j, 1] * m[k, 2] - m[j, 2] * m[k, 1]
        out[i, 1] = m[j, 2] * m[k, 0] - m[j, 0] * m[k, 2]
        out[i, 2] = m[j, 0] * m[k, 1] - m[j, 1] * m[k, 0]


@njit(inline="always", **_OPTIONS)
def _row_of(m, cofactors, c, center, y, line, form):
    """Along the row of pixels with this y: w = ``line[0]`` + x ``line[1]`` and M^T w = ``line[2]`` + x ``line[3]``; and
    the coefficients of powers of x in |cof(M) (mu x d)|^2, ``form[0]``, in |w|^2, ``form[1]``, and in w . M mu,
    ``form[2]``."""
    a0, a1, a2 = c[1] - c[2] * y, -c[0] + 0.0, c[0] * y
    form[:] = 0
    for i in range(3):
        w, by_x = m[i, 1] * y + m[i, 2], m[i, 0]
        k = cofactors[i, 0] * a0 + cofactors[i, 1] * a1 + cofactors[i, 2] * a2
        k_by_x = cofactors[i, 1] * c[2] - cofactors[i, 2] * c[1]
        line[0, i], line[1, i] = w, by_x
        form[0, 0] += k * k
        form[0, 1] += 2 * k * k_by_x
        form[0, 2] += k_by_x * k_by_x
        form[1, 0] += w * w
        form[1, 1] += 2 * w * by_x
        form[1, 2] += by_x * by_x
        form[2, 0] += w * center[i]
        form[2, 1] += by_x * center[i]
    for i in range(3):
        line[2, i] = m[0, i] * line[0, 0] + m[1, i] * line[0, 1] + m[2, i] * line[0, 2]
        line[3, i] = m[0, i] * line[1, 0] + m[1, i] * line[1, 1] + m[2, i] * line[1, 2]


@njit(inline="always", **_OPTIONS)
def _columns_of(form, limit, fx, cx, first, last):
    """The columns, from and to (exclusive), of those from ``first`` to ``last`` that are within the limit."""
    a = form[0, 2] - limit * form[1, 2]
    b = 0.5 * (form[0, 1] - limit * form[1, 1])
    c = form[0, 0] - limit * form[1, 0]
    if not a > 0:
        # The limit reaches behind the camera.
        return first, last
    root = b * b - a * c
    if not root >= 0:
        return first, first
    root = math.sqrt(root)
    low, high = (-b - root) / a * fx + cx, (-b + root) / a * fx + cx
    # A hair more, for rounding: what is beyond the limit is told apart again.
    left = first if low < first else min(int(low - 0.51), last)
    right = last if high > last else max(int(high + 1.51), first)
    return max(left, first), min(right, last)


@njit(inline="always", **_OPTIONS)
def _meet(form, x):
    """(squared standard deviations left at the peak, its depth, |w|^2). A depth of 0 is none."""
    square = form[1, 0] + x * (form[1, 1] + x * form[1, 2])
    if not square > 0:
        return math.inf, 0.0, 0.0
    left = form[0, 0] + x * (form[0, 1] + x * form[0, 2])
    return max(left, 0.0) / square, (form[2, 0] + x * form[2, 1]) / square, square


@njit(inline="always", **_OPTIONS)
def _times(m, vector, out):
    for i in range(3):
        out[i] = m[i, 0] * vector[0] + m[i, 1] * vector[1] + m[i, 2] * vector[2]


@njit(inline="always", **_OPTIONS)
def _normal_of(line, x, normal):
    """Of the plane of equal density where the ray peaks, towards the camera: -M^T w, made unit; returns |M^T w|."""
    n0, n1, n2 = line[2, 0] + x * line[3, 0], line[2, 1] + x * line[3, 1], line[2, 2] + x * line[3, 2]
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    normal[0], normal[1], normal[2] = -n0 / length, -n1 / length, -n2 / length
    return length


@njit(parallel=True, **_OPTIONS)
def composite(whites, centers, opacities, limits, colors, lens, lists, starts, columns, out, moments, left, last):
    """Fill ``out`` [h, w, c + 4] with what colours, normals in camera coordinates and depth add up to, ``moments``
    [h, w, 3] with the sums of weight times 1, m and m^2, ``left`` [h, w] with the light that is left, and ``last`` with
    how much of the list counts.

    ``limits`` [g] are the squared distances beyond which a Gaussian's opacity is below ``ALPHA_MIN``.
    """
    height, width, channels = out.shape[0], out.shape[1], colors.shape[1]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for tile in prange(len(starts) - 1):
        top, side = tile // columns * TILE, tile % columns * TILE
        bottom, end = min(top + TILE, height), min(side + TILE, width)
        out[top:bottom, side:end] = 0
        moments[top:bottom, side:end] = 0
        left[top:bottom, side:end] = 1
        last[top:bottom, side:end] = 0
        cofactors, line, form = np.empty((3, 3)), np.empty((4, 3)), np.empty((3, 3))
        center, normal = np.empty(3), np.empty(3)
        lit = (bottom - top) * (end - side)
        for at in range(starts[tile], starts[tile + 1]):
            if lit == 0:
                break
            g = lists[at]
            m, limit = whites[g], limits[g]
            _cofactors(m, cofactors)
            _times(m, centers[g], center)
            for row in range(top, bottom):
                _row_of(m, cofactors, centers[g], center, (row + 0.5 - cy) / fy, line, form)
                first, beyond = _columns_of(form, limit, fx, cx, side, end)
                for column in range(first, beyond):
                    light = left[row, column]
                    if light < LEFT_MIN:
                        continue
                    x = (column + 0.5 - cx) / fx
                    away, depth, _ = _meet(form, x)
                    if not away <= limit or depth <= _FRONT:
                        continue
                    alpha = min(opacities[g] * math.exp(-0.5 * away), ALPHA_MAX)
                    weight = light * alpha
                    _normal_of(line, x, normal)
                    for c in range(channels):
                        out[row, column, c] += weight * colors[g, c]
                    for i in range(3):
                        out[row, column, channels + i] += weight * normal[i]
                    out[row, column, channels + 3] += weight * depth
                    mapped = _MAP * (1 - NEAR / depth)
                    moments[row, column, 0] += weight
                    moments[row, column, 1] += weight * mapped
                    moments[row, column, 2] += weight * mapped * mapped
                    light *= 1 - alpha
                    left[row, column] = light
                    last[row, column] = at + 1 - starts[tile]
                    lit -= light < LEFT_MIN


@njit(parallel=True, **_OPTIONS)
def differentiate(
    whites, centers, opacities, limits, colors, lens, lists, starts, columns, moments, left, last, to_out, to_left,
    to_distortion, to_whites, to_centers, to_opacities, to_colors,
):  # fmt: skip
    """Add slopes to those of each band, [bands, g, ...].

    The distortion is the sum over pairs of w_i w_j (m_i - m_j)^2, whose weights are held: its slopes by the depths
    follow from the moments of all. That by a peak's depth has none by the squared distance left at it, which is
    smallest there.
    """
    height, width, channels = to_out.shape[0], to_out.shape[1], colors.shape[1]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    rows = (len(starts) - 1) // columns
    deep = -(-rows // BANDS)
    for band in prange(BANDS):
        cofactors, line, form = np.empty((3, 3)), np.empty((4, 3)), np.empty((3, 3))
        center, normal = np.empty(3), np.empty(3)
        lights, gone = np.empty((TILE, TILE)), np.empty((TILE, TILE))
        to_white, to_center = np.empty((3, 3)), np.empty(3)
        w, d, off, white, to_m, back = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
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
                m, limit, opacity = whites[g], limits[g], opacities[g]
                _cofactors(m, cofactors)
                _times(m, centers[g], center)
                to_white[:] = 0
                to_center[:] = 0
                to_opacity = 0.0
                for row in range(top, bottom):
                    y = (row + 0.5 - cy) / fy
                    _row_of(m, cofactors, centers[g], center, y, line, form)
                    first, beyond = _columns_of(form, limit, fx, cx, side, end)
                    for column in range(first, beyond):
                        if place >= last[row, column]:
                            continue
                        x = (column + 0.5 - cx) / fx
                        away, depth, square = _meet(form, x)
                        if not away <= limit or depth <= _FRONT:
                            continue
                        value = math.exp(-0.5 * away)
                        alpha = min(opacity * value, ALPHA_MAX)
                        light = lights[row - top, column - side] / (1 - alpha)
                        lights[row - top, column - side] = light
                        weight = light * alpha
                        length = _normal_of(line, x, normal)
                        by_depth, facing = to_out[row, column, channels + 3], 0.0
                        q = by_depth * depth
                        for c in range(channels):
                            q += to_out[row, column, c] * colors[g, c]
                            to_colors[band, g, c] += weight * to_out[row, column, c]
                        for i in range(3):
                            facing += to_out[row, column, channels + i] * normal[i]
                        q += facing
                        to_alpha = light * q - gone[row - top, column - side] / (1 - alpha)
                        gone[row - top, column - side] += weight * q
                        mapped = _MAP * (1 - NEAR / depth)
                        pulled = mapped * moments[row, column, 0] - moments[row, column, 1]
                        to_depth = weight * by_depth
                        to_depth += to_distortion[row, column] * 2 * weight * pulled * _MAP * NEAR / (depth * depth)
                        to_away = 0.0
                        if opacity * value < ALPHA_MAX:
                            to_opacity += to_alpha * value
                            to_away = -0.5 * to_alpha * opacity * value
                        d[0], d[1], d[2] = x, y, 1.0
                        for i in range(3):
                            w[i] = line[0, i] + x * line[1, i]
                            off[i] = centers[g, i] - depth * d[i]
                            to_n = weight * to_out[row, column, channels + i]
                            to_m[i] = -(to_n - weight * facing * normal[i]) / length
                        _times(m, off, white)
                        _times(m, to_m, back)
                        for i in range(3):
                            # By the squared distance, by the depth, and by the normal -M^T M d.
                            by_off = 2 * to_away * white[i]
                            by_d = to_depth * (center[i] - 2 * depth * w[i]) / square + back[i]
                            by_center = to_depth * w[i] / square
                            for j in range(3):
                                to_white[i, j] += by_off * off[j] + by_d * d[j]
                                to_white[i, j] += by_center * centers[g, j] + w[i] * to_m[j]
                                to_center[j] += m[i, j] * (by_off + by_center)
                to_opacities[band, g] += to_opacity
                for i in range(3):
                    to_centers[band, g, i] += to_center[i]
                    for j in range(3):
                        to_whites[band, g, i, j] += to_white[i, j]


@njit(parallel=True, **_OPTIONS)
def lower(points, enough, forms, opacities, limits, lens, size, lists, starts, columns, least, seen):
    """Lower ``least`` [n], the smallest opacity accumulated to each point in any view, to that in this one, and note in
    ``seen`` which points are in its image (paper, eq. 8 to 10); ``points`` in camera coordinates.

    ``forms`` [g, 10] are M^T M (xx, xy, xz, yy, yz, zz), M^T M mu and mu . M^T M mu. The opacity to a point does not
    depend on the order of Gaussians. Those that peak behind the point count with what they have at it. A point below
    ``enough`` is not looked at again, and one that has reached it no further.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for n in prange(len(points)):
        z = points[n, 2]
        if least[n] < enough or not z > _FRONT:
            continue
        x, y = points[n, 0] / z, points[n, 1] / z
        column, row = x * fx + cx, y * fy + cy
        if not (0 <= column < size[0] and 0 <= row < size[1]):
            continue
        seen[n] = True
        tile = int(row) // TILE * columns + int(column) // TILE
        left = 1.0
        for at in range(starts[tile], starts[tile + 1]):
            g = lists[at]
            q = forms[g]
            along = q[6] * x + q[7] * y + q[8]
            square = x * (q[0] * x + 2 * (q[1] * y + q[2])) + y * (q[3] * y + 2 * q[4]) + q[5]
            if not square > 0 or along <= _FRONT * square:
                continue
            reached = min(along / square, z)
            here = q[9] + reached * (reached * square - 2 * along)
            if here <= limits[g]:
                left *= 1 - min(opacities[g] * math.exp(-0.5 * max(here, 0.0)), ALPHA_MAX)
                if 1 - left >= enough:
                    break
        least[n] = min(least[n], 1 - left)
