"""Gaussians met by rays: the loops, for the CPU.

``whites`` [g, 3, 3], M, bring offsets in camera coordinates to standard deviations along a Gaussian's axes, ``centers``
[g, 3] are mu. Along the ray through d = (x, y, 1) a Gaussian is one of one dimension (paper, eq. 5 to 7): its peak is
at the depth z = w . M mu / w . w, w = M d, where the squared standard deviations that are left are
|cof(M) (mu x d)|^2 / |w|^2. Both vectors are linear in x along a row of pixels, so that the pixels within so many
standard deviations are those between the roots of a quadratic: rows without any are passed over. A row of a tile is
worked on as a whole: loops over its ``TILE`` pixels, or lanes, have no branches, so that they become vector
instructions, and what they add up is kept lane by lane until the tile is done with a Gaussian.
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

_FRONT = 1e-2
"""Object units in front of the camera: peaks that are nearer are not seen."""
_LIGHT, _GONE, _LAST, _DISTORTED, _W0, _W1, _W2, _DEPTHS, _NORMALS, _COLORS = *range(9), 11
"""Planes of a tile's pixels: light left, slope of the loss by it times it, how much of the list counts, slope by the
distortion, moments, depth, normal and colours."""
_ALPHA, _VALUE, _X, _DEPTH, _SQUARE, _LENGTH, _NORMAL, _WEIGHT, _Q, _FACING = *range(7), 9, 10, 11
_TO_DEPTH, _TO_AWAY, _TO_M, _TO_WHITE, _TO_CENTER, _TO_OPACITY, _TO_COLORS = 12, 13, 14, 17, 26, 29, 30
"""Rows of lanes: of where a ray peaks (``_SQUARE`` and ``_LENGTH`` are one over |w|^2 and |M^T w|), weights, slopes,
and from ``_TO_WHITE`` on what is added up for the Gaussian."""


@njit(forceinline=True, **OPTIONS)
def _cofactors(m, out):
    """``out`` (a x b) is M a x M b."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, 0] = m[j, 1] * m[k, 2] - m[j, 2] * m[k, 1]
        out[i, 1] = m[j, 2] * m[k, 0] - m[j, 0] * m[k, 2]
        out[i, 2] = m[j, 0] * m[k, 1] - m[j, 1] * m[k, 0]


@njit(forceinline=True, **OPTIONS)
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


@njit(forceinline=True, **OPTIONS)
def _misses(form, limit, fx, cx, first, last):
    """Whether none of the row's pixels from column ``first`` to ``last`` (exclusive) is within the limit."""
    a = form[0, 2] - limit * form[1, 2]
    b = 0.5 * (form[0, 1] - limit * form[1, 1])
    c = form[0, 0] - limit * form[1, 0]
    if not a > 0:
        # The limit reaches behind the camera.
        return False
    root = b * b - a * c
    if not root >= 0:
        return True
    root = math.sqrt(root)
    low, high = (-b - root) / a * fx + cx, (-b + root) / a * fx + cx
    # A hair more, for rounding: what is beyond the limit is told apart again.
    return not (low <= last + 0.01 and high >= first - 0.01)


@njit(forceinline=True, **OPTIONS)
def _meet(form, line, limit, opacity, side, fx, cx, lanes):
    """Where the rays of a row peak. The normal is that of the plane of equal density there, towards the camera: -M^T w,
    made unit."""
    p00, p01, p02 = form[0, 0], form[0, 1], form[0, 2]
    p10, p11, p12 = form[1, 0], form[1, 1], form[1, 2]
    p20, p21 = form[2, 0], form[2, 1]
    s0, s1, s2 = line[2, 0], line[2, 1], line[2, 2]
    t0, t1, t2 = line[3, 0], line[3, 1], line[3, 2]
    for lane in range(TILE):
        x = (side + lane + 0.5 - cx) / fx
        square = p10 + x * (p11 + x * p12)
        inverse = 1 / square
        away, depth = max(p00 + x * (p01 + x * p02), 0.0) * inverse, (p20 + x * p21) * inverse
        n0, n1, n2 = s0 + x * t0, s1 + x * t1, s2 + x * t2
        shorter = 1 / math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        counts = (square > 0) & (away <= limit) & (depth > _FRONT)
        value = exponential(max(-0.5 * away, -6.0))
        lanes[_ALPHA, lane] = min(opacity * value, ALPHA_MAX) if counts else 0.0
        lanes[_VALUE, lane] = value if counts else 0.0
        lanes[_X, lane] = x
        lanes[_DEPTH, lane] = depth if counts else 1.0
        lanes[_SQUARE, lane] = inverse if counts else 0.0
        lanes[_LENGTH, lane] = shorter if counts else 0.0
        lanes[_NORMAL, lane] = -n0 * shorter if counts else 0.0
        lanes[_NORMAL + 1, lane] = -n1 * shorter if counts else 0.0
        lanes[_NORMAL + 2, lane] = -n2 * shorter if counts else 0.0


@njit(forceinline=True, **OPTIONS)
def _times(m, vector, out):
    for i in range(3):
        out[i] = m[i, 0] * vector[0] + m[i, 1] * vector[1] + m[i, 2] * vector[2]


@njit(parallel=True, **OPTIONS)
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
        cofactors, line, form, center = np.empty((3, 3)), np.empty((4, 3)), np.empty((3, 3)), np.empty(3)
        lanes, planes = np.empty((_Q, TILE)), np.zeros((_COLORS + channels, TILE, TILE))
        # Beyond the image there is no light, so that nothing is seen there.
        planes[_LIGHT, : bottom - top, : end - side] = 1
        lit = (bottom - top) * (end - side)
        for at in range(starts[tile], starts[tile + 1]):
            if lit == 0:
                break
            g = lists[at]
            m, limit, opacity = whites[g], limits[g], opacities[g]
            _cofactors(m, cofactors)
            _times(m, centers[g], center)
            number = 1.0 * (at + 1 - starts[tile])
            for row in range(bottom - top):
                _row_of(m, cofactors, centers[g], center, (top + row + 0.5 - cy) / fy, line, form)
                if _misses(form, limit, fx, cx, side, end):
                    continue
                _meet(form, line, limit, opacity, side, fx, cx, lanes)
                dark = 0
                for lane in range(TILE):
                    light, depth = planes[_LIGHT, row, lane], lanes[_DEPTH, lane]
                    alpha = lanes[_ALPHA, lane] if light >= LEFT_MIN else 0.0
                    weight = light * alpha
                    after = light - weight
                    mapped = MAP * (1 - NEAR / depth)
                    lanes[_WEIGHT, lane] = weight
                    planes[_W0, row, lane] += weight
                    planes[_W1, row, lane] += weight * mapped
                    planes[_W2, row, lane] += weight * mapped * mapped
                    planes[_DEPTHS, row, lane] += weight * depth
                    planes[_LIGHT, row, lane] = after
                    planes[_LAST, row, lane] = number if alpha > 0 else planes[_LAST, row, lane]
                    dark += (light >= LEFT_MIN) & (after < LEFT_MIN)
                lit -= dark
                for i in range(3):
                    for lane in range(TILE):
                        planes[_NORMALS + i, row, lane] += lanes[_WEIGHT, lane] * lanes[_NORMAL + i, lane]
                for c in range(channels):
                    color = 1.0 * colors[g, c]
                    for lane in range(TILE):
                        planes[_COLORS + c, row, lane] += lanes[_WEIGHT, lane] * color
        for row in range(bottom - top):
            for lane in range(end - side):
                for c in range(channels):
                    out[top + row, side + lane, c] = planes[_COLORS + c, row, lane]
                for i in range(3):
                    out[top + row, side + lane, channels + i] = planes[_NORMALS + i, row, lane]
                    moments[top + row, side + lane, i] = planes[_W0 + i, row, lane]
                out[top + row, side + lane, channels + 3] = planes[_DEPTHS, row, lane]
                left[top + row, side + lane] = planes[_LIGHT, row, lane]
                last[top + row, side + lane] = int(planes[_LAST, row, lane])


@njit(parallel=True, **OPTIONS)
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
        cofactors, line, form, center = np.empty((3, 3)), np.empty((4, 3)), np.empty((3, 3)), np.empty(3)
        lanes, planes = np.empty((_TO_COLORS + channels, TILE)), np.empty((_COLORS + channels, TILE, TILE))
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
                        planes[_NORMALS + i, row, lane] = to_out[y, x, channels + i]
                    planes[_DEPTHS, row, lane] = to_out[y, x, channels + 3]
                    for c in range(channels):
                        planes[_COLORS + c, row, lane] = to_out[y, x, c]
                    most = max(most, last[y, x])
            for place in range(most - 1, -1, -1):
                g = lists[starts[tile] + place]
                m, limit, opacity = whites[g], limits[g], opacities[g]
                _cofactors(m, cofactors)
                _times(m, centers[g], center)
                lanes[_TO_WHITE:] = 0
                for row in range(bottom - top):
                    y = (top + row + 0.5 - cy) / fy
                    _row_of(m, cofactors, centers[g], center, y, line, form)
                    if _misses(form, limit, fx, cx, side, end):
                        continue
                    _meet(form, line, limit, opacity, side, fx, cx, lanes)
                    for lane in range(TILE):
                        alpha = lanes[_ALPHA, lane] if place < planes[_LAST, row, lane] else 0.0
                        light = planes[_LIGHT, row, lane] / (1 - alpha)
                        lanes[_ALPHA, lane] = alpha
                        lanes[_WEIGHT, lane] = light * alpha
                        lanes[_Q, lane] = planes[_DEPTHS, row, lane] * lanes[_DEPTH, lane]
                        lanes[_FACING, lane] = 0.0
                        planes[_LIGHT, row, lane] = light
                    for c in range(channels):
                        color = 1.0 * colors[g, c]
                        for lane in range(TILE):
                            to = planes[_COLORS + c, row, lane]
                            lanes[_Q, lane] += to * color
                            lanes[_TO_COLORS + c, lane] += lanes[_WEIGHT, lane] * to
                    for i in range(3):
                        for lane in range(TILE):
                            lanes[_FACING, lane] += planes[_NORMALS + i, row, lane] * lanes[_NORMAL + i, lane]
                    _slopes_of_row(opacity, row, lanes, planes)
                    _slopes_of_axis(0, m, centers[g], center, line, y, lanes)
                    _slopes_of_axis(1, m, centers[g], center, line, y, lanes)
                    _slopes_of_axis(2, m, centers[g], center, line, y, lanes)
                for lane in range(TILE):
                    to_opacities[band, g] += lanes[_TO_OPACITY, lane]
                    for i in range(3):
                        to_centers[band, g, i] += lanes[_TO_CENTER + i, lane]
                        for j in range(3):
                            to_whites[band, g, i, j] += lanes[_TO_WHITE + 3 * i + j, lane]
                    for c in range(channels):
                        to_colors[band, g, c] += lanes[_TO_COLORS + c, lane]


@njit(forceinline=True, **OPTIONS)
def _slopes_of_row(opacity, row, lanes, planes):
    """Slopes by the squared distance, by the depth (over |w|^2) and by -M^T w; those by the opacity are added up."""
    for lane in range(TILE):
        alpha, value, weight, depth = (
            lanes[_ALPHA, lane],
            lanes[_VALUE, lane],
            lanes[_WEIGHT, lane],
            lanes[_DEPTH, lane],
        )
        facing, gone = lanes[_FACING, lane], planes[_GONE, row, lane]
        q = lanes[_Q, lane] + facing
        to_alpha = planes[_LIGHT, row, lane] * q - gone / (1 - alpha)
        planes[_GONE, row, lane] = gone + weight * q
        # Those that do not count, and those that are as opaque as can be, have no slope.
        to_alpha = to_alpha if (alpha > 0) & (opacity * value < ALPHA_MAX) else 0.0
        lanes[_TO_OPACITY, lane] += to_alpha * value
        lanes[_TO_AWAY, lane] = -0.5 * to_alpha * opacity * value
        mapped = MAP * (1 - NEAR / depth)
        pulled = mapped * planes[_W0, row, lane] - planes[_W1, row, lane]
        to_depth = weight * planes[_DEPTHS, row, lane]
        to_depth += planes[_DISTORTED, row, lane] * 2 * weight * pulled * MAP * NEAR / (depth * depth)
        lanes[_TO_DEPTH, lane] = to_depth * lanes[_SQUARE, lane]
        shorter = weight * lanes[_LENGTH, lane]
        n0, n1, n2 = lanes[_NORMAL, lane], lanes[_NORMAL + 1, lane], lanes[_NORMAL + 2, lane]
        lanes[_TO_M, lane] = (facing * n0 - planes[_NORMALS, row, lane]) * shorter
        lanes[_TO_M + 1, lane] = (facing * n1 - planes[_NORMALS + 1, row, lane]) * shorter
        lanes[_TO_M + 2, lane] = (facing * n2 - planes[_NORMALS + 2, row, lane]) * shorter


@njit(forceinline=True, **OPTIONS)
def _slopes_of_axis(i, m, place, center, line, y, lanes):
    """Add a row's slopes by row ``i`` of M, and what comes through it by the centre, lane by lane."""
    m0, m1, m2, middle = 1.0 * m[i, 0], 1.0 * m[i, 1], 1.0 * m[i, 2], center[i]
    c0, c1, c2 = 1.0 * place[0], 1.0 * place[1], 1.0 * place[2]
    w0, w1 = line[0, i], line[1, i]
    for lane in range(TILE):
        x, depth, to_depth = lanes[_X, lane], lanes[_DEPTH, lane], lanes[_TO_DEPTH, lane]
        to_m0, to_m1, to_m2 = lanes[_TO_M, lane], lanes[_TO_M + 1, lane], lanes[_TO_M + 2, lane]
        off0, off1, off2 = c0 - depth * x, c1 - depth * y, c2 - depth
        w = w0 + x * w1
        # By the squared distance, by the depth, and by the normal -M^T M d.
        by_off = 2 * lanes[_TO_AWAY, lane] * (m0 * off0 + m1 * off1 + m2 * off2)
        by_d = to_depth * (middle - 2 * depth * w) + m0 * to_m0 + m1 * to_m1 + m2 * to_m2
        by_center = to_depth * w
        lanes[_TO_WHITE + 3 * i, lane] += by_off * off0 + by_d * x + by_center * c0 + w * to_m0
        lanes[_TO_WHITE + 3 * i + 1, lane] += by_off * off1 + by_d * y + by_center * c1 + w * to_m1
        lanes[_TO_WHITE + 3 * i + 2, lane] += by_off * off2 + by_d + by_center * c2 + w * to_m2
        lanes[_TO_CENTER, lane] += m0 * (by_off + by_center)
        lanes[_TO_CENTER + 1, lane] += m1 * (by_off + by_center)
        lanes[_TO_CENTER + 2, lane] += m2 * (by_off + by_center)


@njit(parallel=True, **OPTIONS)
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
