"""Gaussians to screen records, and gradients back."""

import math

import numpy as np
from numba import njit, prange

from .layout import (
    ALPHA_MIN,
    CURVE,
    DEPTH,
    EIGHTH,
    FEATURES,
    LARGEST,
    LEVEL,
    MEAN_X,
    MEAN_Y,
    NEAR,
    SLANT,
    STEEP,
    SUM_DEPTH,
    SUM_FEATURES,
    SUM_ONE,
    SUM_U,
    SUM_UU,
    SUM_X,
    SUM_XU,
    SUM_XX,
    TILE,
)

# No "nnan" and "ninf" here: what is not finite has to be seen.
_OPTIONS = {
    "fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"},
    "error_model": "numpy",
    "cache": True,
    "nogil": True,
}
_ZERO, _ONE, _TWO, _HALF = np.float32(0), np.float32(1), np.float32(2), np.float32(0.5)
_EIGHTH = np.float32(EIGHTH)
_ROOT_EIGHTH = np.float32(math.sqrt(EIGHTH))
_LOG2_OF_255 = np.float32(math.log2(255.0))
_TWICE_LN2 = np.float32(2.0 * math.log(2.0))
_OCTAVE_EIGHTH = np.float32(0.125)
_FLOAT_MAX = np.float32(3e38)


@njit(parallel=True, **_OPTIONS)
def project(
    means, scales, rotations, opacities, features, pose, lens, width, height, low_pass, records, bits, tiles, keys
):
    """Fill ``records``, the tile rectangle ``tiles`` (first and last column, first and last row) and ``keys``.

    ``pose`` is the upper 3x4 of world-to-camera, ``lens`` fx, fy, cx, cy and the bounds of x/z and y/z inside the
    Jacobian. ``bits`` is ``records`` as int32. A key is the bits of camera z, which sort like the number; 0: not drawn.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    v00, v01, v02, v03 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    v10, v11, v12, v13 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    v20, v21, v22, v23 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    right, bottom = np.float32(width), np.float32(height)
    for i in prange(means.shape[0]):
        keys[i] = 0
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        depth = v20 * x + v21 * y + v22 * z + v23
        opacity = opacities[i]
        if not (depth >= NEAR and opacity >= ALPHA_MIN):
            continue
        inverse = _ONE / depth
        along_x = (v00 * x + v01 * y + v02 * z + v03) * inverse
        along_y = (v10 * x + v11 * y + v12 * z + v13) * inverse
        mean_x = fx * along_x + cx
        mean_y = fy * along_y + cy
        at_x = min(lens[5], max(lens[4], along_x))
        at_y = min(lens[7], max(lens[6], along_y))
        jx, jy = fx * inverse, fy * inverse
        p0, p1, p2 = jx * (v00 - at_x * v20), jx * (v01 - at_x * v21), jx * (v02 - at_x * v22)
        q0, q1, q2 = jy * (v10 - at_y * v20), jy * (v11 - at_y * v21), jy * (v12 - at_y * v22)
        a0 = scales[i, 0] * (p0 * rotations[i, 0, 0] + p1 * rotations[i, 1, 0] + p2 * rotations[i, 2, 0])
        a1 = scales[i, 1] * (p0 * rotations[i, 0, 1] + p1 * rotations[i, 1, 1] + p2 * rotations[i, 2, 1])
        a2 = scales[i, 2] * (p0 * rotations[i, 0, 2] + p1 * rotations[i, 1, 2] + p2 * rotations[i, 2, 2])
        b0 = scales[i, 0] * (q0 * rotations[i, 0, 0] + q1 * rotations[i, 1, 0] + q2 * rotations[i, 2, 0])
        b1 = scales[i, 1] * (q0 * rotations[i, 0, 1] + q1 * rotations[i, 1, 1] + q2 * rotations[i, 2, 1])
        b2 = scales[i, 2] * (q0 * rotations[i, 0, 2] + q1 * rotations[i, 1, 2] + q2 * rotations[i, 2, 2])
        aa = a0 * a0 + a1 * a1 + a2 * a2
        bb = b0 * b0 + b1 * b1 + b2 * b2
        ab = a0 * b0 + a1 * b1 + a2 * b2
        # det(A A^T + h I) by Cauchy-Binet: a sum of squares, where aa bb - ab^2 would cancel for slivers.
        m0, m1, m2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
        determinant = m0 * m0 + m1 * m1 + m2 * m2 + low_pass * (aa + bb) + low_pass * low_pass
        xx, yy = aa + low_pass, bb + low_pass
        inverse_xx = _ONE / xx
        steep = _ROOT_EIGHTH * math.sqrt(xx / determinant)
        slant = -steep * ab * inverse_xx
        curve = -_EIGHTH * inverse_xx
        exponent = math.log2(opacity)
        reach = _TWICE_LN2 * (exponent + _LOG2_OF_255)
        reach_x, reach_y = math.sqrt(reach * xx), math.sqrt(reach * yy)
        size = abs(mean_x) + abs(mean_y) + steep + abs(slant) - curve + abs(exponent) + depth + reach_x + reach_y
        for c in range(features.shape[1]):
            size += abs(features[i, c])
        if not (size < LARGEST and determinant < _FLOAT_MAX):
            continue
        # Pixel centres within reach. Still floats: what is far outside the image does not fit an integer.
        left_reach = max(np.ceil(mean_x - reach_x - _HALF), _ZERO)
        right_reach = min(np.floor(mean_x + reach_x - _HALF), right - _ONE)
        top_reach = max(np.ceil(mean_y - reach_y - _HALF), _ZERO)
        bottom_reach = min(np.floor(mean_y + reach_y - _HALF), bottom - _ONE)
        if right_reach < left_reach or bottom_reach < top_reach:
            continue
        tiles[i, 0] = np.int32(left_reach) // TILE
        tiles[i, 1] = np.int32(right_reach) // TILE
        tiles[i, 2] = np.int32(top_reach) // TILE
        tiles[i, 3] = np.int32(bottom_reach) // TILE
        records[i, MEAN_X] = mean_x
        records[i, MEAN_Y] = mean_y
        records[i, CURVE] = curve
        records[i, SLANT] = slant
        records[i, STEEP] = steep
        records[i, LEVEL] = exponent * _OCTAVE_EIGHTH
        records[i, DEPTH] = depth
        for c in range(features.shape[1]):
            records[i, FEATURES + c] = features[i, c]
        keys[i] = bits[i, DEPTH]


@njit(**_OPTIONS)
def _no_gradient(i, to_means, to_scales, to_rotations, to_opacities, to_features):
    to_opacities[i] = _ZERO
    for c in range(3):
        to_means[i, c] = _ZERO
        to_scales[i, c] = _ZERO
        for d in range(3):
            to_rotations[i, c, d] = _ZERO
    for c in range(to_features.shape[1]):
        to_features[i, c] = _ZERO


@njit(parallel=True, **_OPTIONS)
def features_backward(first_slot, sums, to_features):
    """Of ``project_backward`` only the features' gradients."""
    for i in prange(to_features.shape[0]):
        for c in range(to_features.shape[1]):
            to_features[i, c] = _ZERO
        for slot in range(first_slot[i], first_slot[i + 1]):
            for c in range(to_features.shape[1]):
                to_features[i, c] += sums[slot, SUM_FEATURES + c]


@njit(parallel=True, **_OPTIONS)
def project_backward(
    means, scales, rotations, opacities, pose, lens, low_pass, first_slot, sums,
    to_means, to_scales, to_rotations, to_opacities, to_features, to_pose,
):  # fmt: skip
    """Gradients from the pixel sums of each Gaussian, which lie in rows first_slot[i] ... first_slot[i + 1] - 1.

    ``to_pose`` is (parts, 3, 4) in float64, one part per stretch of Gaussians, to be added up; no parts: not wanted.
    """
    count = means.shape[0]
    channels = to_features.shape[1]
    fx, fy = lens[0], lens[1]
    v00, v01, v02, v03 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    v10, v11, v12, v13 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    v20, v21, v22, v23 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    wants_pose = to_pose.shape[0] > 0
    stretches = max(to_pose.shape[0], 64)
    for stretch in prange(stretches):
        r00 = r01 = r02 = r03 = r10 = r11 = r12 = r13 = r20 = r21 = r22 = r23 = 0.0
        for i in range(count * stretch // stretches, count * (stretch + 1) // stretches):
            first, end = first_slot[i], first_slot[i + 1]
            if first == end:
                _no_gradient(i, to_means, to_scales, to_rotations, to_opacities, to_features)
                continue
            # Nearly always there is one row: what is in loops here only slows it down.
            row = sums[first]
            s_x, s_u, s_one, to_depth = row[SUM_X], row[SUM_U], row[SUM_ONE], row[SUM_DEPTH]
            s_xx, s_xu, s_uu = row[SUM_XX], row[SUM_XU], row[SUM_UU]
            for c in range(channels):
                to_features[i, c] = row[SUM_FEATURES + c]
            if end > first + 1:
                for slot in range(first + 1, end):
                    row = sums[slot]
                    s_x += row[SUM_X]
                    s_u += row[SUM_U]
                    s_xx += row[SUM_XX]
                    s_xu += row[SUM_XU]
                    s_uu += row[SUM_UU]
                    s_one += row[SUM_ONE]
                    to_depth += row[SUM_DEPTH]
                    for c in range(channels):
                        to_features[i, c] += row[SUM_FEATURES + c]
            to_opacities[i] = s_one / opacities[i]

            # The projection again: cheaper than to keep it.
            x, y, z = means[i, 0], means[i, 1], means[i, 2]
            inverse = _ONE / (v20 * x + v21 * y + v22 * z + v23)
            along_x = (v00 * x + v01 * y + v02 * z + v03) * inverse
            along_y = (v10 * x + v11 * y + v12 * z + v13) * inverse
            at_x = min(lens[5], max(lens[4], along_x))
            at_y = min(lens[7], max(lens[6], along_y))
            jx, jy = fx * inverse, fy * inverse
            w00, w01, w02 = v00 - at_x * v20, v01 - at_x * v21, v02 - at_x * v22
            w10, w11, w12 = v10 - at_y * v20, v11 - at_y * v21, v12 - at_y * v22
            s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
            o00, o01, o02 = rotations[i, 0, 0], rotations[i, 0, 1], rotations[i, 0, 2]
            o10, o11, o12 = rotations[i, 1, 0], rotations[i, 1, 1], rotations[i, 1, 2]
            o20, o21, o22 = rotations[i, 2, 0], rotations[i, 2, 1], rotations[i, 2, 2]
            p0 = jx * (w00 * o00 + w01 * o10 + w02 * o20)
            p1 = jx * (w00 * o01 + w01 * o11 + w02 * o21)
            p2 = jx * (w00 * o02 + w01 * o12 + w02 * o22)
            q0 = jy * (w10 * o00 + w11 * o10 + w12 * o20)
            q1 = jy * (w10 * o01 + w11 * o11 + w12 * o21)
            q2 = jy * (w10 * o02 + w11 * o12 + w12 * o22)
            a0, a1, a2, b0, b1, b2 = s0 * p0, s1 * p1, s2 * p2, s0 * q0, s1 * q1, s2 * q2
            aa, bb, ab = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2, a0 * b0 + a1 * b1 + a2 * b2
            m0, m1, m2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
            determinant = m0 * m0 + m1 * m1 + m2 * m2 + low_pass * (aa + bb) + low_pass * low_pass
            inverse_xx = _ONE / (aa + low_pass)
            ratio = ab * inverse_xx
            root = math.sqrt((aa + low_pass) / determinant)

            # q = d^T K d = dx^2 / xx + v^2 with v = root (dy - ratio dx) = u / sqrt(EIGHTH), so that
            # K d = (dx / xx - ratio root v, root v): sums of products of the two terms, no cancellation.
            n_x = s_x * inverse_xx
            n_v = s_u * root / _ROOT_EIGHTH
            n_xx = s_xx * inverse_xx * inverse_xx
            n_xv = s_xu * inverse_xx * root / _ROOT_EIGHTH
            n_vv = s_uu * root * root / _EIGHTH
            to_x = fx * (n_x - ratio * n_v)
            to_y = fy * n_v
            # Twice the gradient by the covariance: sum of s (K d) (K d)^T.
            g_xx = n_xx - ratio * (_TWO * n_xv - ratio * n_vv)
            g_xy = n_xv - ratio * n_vv
            g_yy = n_vv
            a_0, a_1, a_2 = g_xx * a0 + g_xy * b0, g_xx * a1 + g_xy * b1, g_xx * a2 + g_xy * b2
            b_0, b_1, b_2 = g_xy * a0 + g_yy * b0, g_xy * a1 + g_yy * b1, g_xy * a2 + g_yy * b2
            to_scales[i, 0] = a_0 * p0 + b_0 * q0
            to_scales[i, 1] = a_1 * p1 + b_1 * q1
            to_scales[i, 2] = a_2 * p2 + b_2 * q2
            a_0, a_1, a_2 = jx * s0 * a_0, jx * s1 * a_1, jx * s2 * a_2
            b_0, b_1, b_2 = jy * s0 * b_0, jy * s1 * b_1, jy * s2 * b_2
            to_rotations[i, 0, 0] = a_0 * w00 + b_0 * w10
            to_rotations[i, 0, 1] = a_1 * w00 + b_1 * w10
            to_rotations[i, 0, 2] = a_2 * w00 + b_2 * w10
            to_rotations[i, 1, 0] = a_0 * w01 + b_0 * w11
            to_rotations[i, 1, 1] = a_1 * w01 + b_1 * w11
            to_rotations[i, 1, 2] = a_2 * w01 + b_2 * w11
            to_rotations[i, 2, 0] = a_0 * w02 + b_0 * w12
            to_rotations[i, 2, 1] = a_1 * w02 + b_1 * w12
            to_rotations[i, 2, 2] = a_2 * w02 + b_2 * w12
            # By the rows of J W (times depth / focal length).
            c0, c1, c2 = (
                a_0 * o00 + a_1 * o01 + a_2 * o02,
                a_0 * o10 + a_1 * o11 + a_2 * o12,
                a_0 * o20 + a_1 * o21 + a_2 * o22,
            )
            d0, d1, d2 = (
                b_0 * o00 + b_1 * o01 + b_2 * o02,
                b_0 * o10 + b_1 * o11 + b_2 * o12,
                b_0 * o20 + b_1 * o21 + b_2 * o22,
            )
            if at_x == along_x:
                to_x -= c0 * v20 + c1 * v21 + c2 * v22
            if at_y == along_y:
                to_y -= d0 * v20 + d1 * v21 + d2 * v22
            stretching = c0 * w00 + c1 * w01 + c2 * w02 + d0 * w10 + d1 * w11 + d2 * w12
            to_z = to_depth - inverse * (to_x * along_x + to_y * along_y + stretching)
            to_x *= inverse
            to_y *= inverse
            to_means[i, 0] = v00 * to_x + v10 * to_y + v20 * to_z
            to_means[i, 1] = v01 * to_x + v11 * to_y + v21 * to_z
            to_means[i, 2] = v02 * to_x + v12 * to_y + v22 * to_z
            if wants_pose:
                r00 += to_x * x + c0
                r01 += to_x * y + c1
                r02 += to_x * z + c2
                r03 += to_x
                r10 += to_y * x + d0
                r11 += to_y * y + d1
                r12 += to_y * z + d2
                r13 += to_y
                r20 += to_z * x - at_x * c0 - at_y * d0
                r21 += to_z * y - at_x * c1 - at_y * d1
                r22 += to_z * z - at_x * c2 - at_y * d2
                r23 += to_z
        if wants_pose:
            part = to_pose[stretch]
            part[0, 0], part[0, 1], part[0, 2], part[0, 3] = r00, r01, r02, r03
            part[1, 0], part[1, 1], part[1, 2], part[1, 3] = r10, r11, r12, r13
            part[2, 0], part[2, 1], part[2, 2], part[2, 3] = r20, r21, r22, r23
