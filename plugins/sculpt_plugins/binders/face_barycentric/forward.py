"""Gaussians from faces and rows, for the CPU.

Face by face what ``in_torch.py`` and ``outline.py`` do for all faces at a time. Matrices of two columns lie in memory
by rows; a trim is upper triangular, of which three entries are kept: (0, 0), (0, 1), (1, 1). An array without entries
stands for something there is none of.
"""

import math

import numpy as np
from numba import njit, prange

from .limits import FLAT, FLATTEST, LOG_LAYERS_FROM, LOG_LAYERS_STEP, NARROWEST, OF_A_SHEET, TINY
from .vectors import (
    CHUNK,
    HALF,
    ONE,
    OPTIONS,
    THIRD,
    TWO,
    ZERO,
    cross,
    dot,
    flat_reference,
    length,
    minus,
    plus,
    reference,
    row,
    scaled,
    unit,
)

_FLAT, _FLATTEST, _TINY, _THREE = np.float32(FLAT), np.float32(FLATTEST), np.float32(TINY), np.float32(3)
_NARROWEST_SQUARE, _OF_A_SHEET = np.float32(NARROWEST**2), np.float32(OF_A_SHEET)
_LAYERS_FROM, _LAYERS_STEP = np.float32(LOG_LAYERS_FROM), np.float32(LOG_LAYERS_STEP)


@njit(parallel=True, **OPTIONS)
def mix(log_ratios, rotation, reach, mixing, squares):
    """Fill ``mixing`` (f, k, 4), and by chunks the sums over faces, Gaussians and edges of the squared components of
    the tangential factors across the edges (``squares``, float64; 0 without ``reach``)."""
    count, per_face = log_ratios.shape[0], log_ratios.shape[1]
    for chunk in prange(squares.shape[0]):
        total = 0.0
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count)):
            for k in range(per_face):
                first, second = math.exp(log_ratios[i, k, 0]), math.exp(log_ratios[i, k, 1])
                cos, sin = ONE, ZERO
                if rotation.shape[0] > 0:
                    cos, sin = math.cos(rotation[i, k]), math.sin(rotation[i, k])
                mixing[i, k, 0] = cos * first
                mixing[i, k, 1] = -sin * second
                mixing[i, k, 2] = sin * first
                mixing[i, k, 3] = cos * second
                if reach.shape[2] > 0:
                    for j in range(3):
                        x, y = _across(i, k, j, reach, mixing)
                        total += x * x + y * y
        squares[chunk] = total


@njit(forceinline=True, **OPTIONS)
def _across(i, k, j, reach, mixing):
    """Components across edge j of both columns of the tangential factor."""
    along, other = reach[j, 0, i], reach[j, 1, i]
    return along * mixing[i, k, 0] + other * mixing[i, k, 2], along * mixing[i, k, 1] + other * mixing[i, k, 3]


@njit(**OPTIONS)
def _half_tangent(cosine, sine):
    return sine / max(ONE + cosine, _FLAT)


@njit(forceinline=True, **OPTIONS)
def _deviations(i, heights, cosine, sine, log_density, depths):
    """How many deviations below its face a Gaussian lies: ``outline._interpolated`` of ``outline._log_layers``."""
    curvature = _FLATTEST
    for j in range(3):
        curvature = max(curvature, _THREE * _half_tangent(cosine[j, i], sine[j, i]) / (heights[j, i] + _TINY))
    last = np.float32(depths.shape[0]) - np.float32(1.001)
    at = (np.float32(log_density) - HALF * math.log(curvature) - _LAYERS_FROM) / _LAYERS_STEP
    at = min(at, last) if at > ZERO else ZERO  # 0 for NaN
    low = np.int32(at)
    return depths[low] + (depths[low + 1] - depths[low]) * (at - np.float32(low))


@njit(forceinline=True, **OPTIONS)
def _shift(i, k, barycentrics, outward, heights, cosine, sine, depth):
    """Along the face, away from edges beyond which it bends."""
    shift = (ZERO, ZERO, ZERO)
    for j in range(3):
        height = heights[j, i]
        distance = barycentrics[i, k, (j + 2) % 3] * height
        away = max(depth * _half_tangent(cosine[j, i], sine[j, i]) - distance, ZERO)
        away = min(away, height - distance)
        shift = minus(shift, scaled((outward[j, 0, i], outward[j, 1, i], outward[j, 2, i]), away))
    return shift


@njit(forceinline=True, **OPTIONS)
def _trim(
    i, k, shift, barycentrics, mixing, outward, heights, cosine, sine, reach, depth, deviations, blur, normal_scale
):
    """The trim of a Gaussian: see ``outline._trims``."""
    xx = xy = yy = ZERO
    for j in range(3):
        if sine[j, i] > ZERO:
            distance = barycentrics[i, k, (j + 2) % 3] * heights[j, i]
            distance -= dot(shift, (outward[j, 0, i], outward[j, 1, i], outward[j, 2, i]))
            below = max(depth * cosine[j, i] + sine[j, i] * distance, ZERO) / max(deviations, _TINY)
            through = normal_scale * cosine[j, i]
            spread = below * below - blur * blur - through * through
            x, y = _across(i, k, j, reach, mixing)
            variance = x * x + y * y + _TINY
            bound = max(spread / (sine[j, i] * sine[j, i] + _TINY), _NARROWEST_SQUARE * variance)
            surplus = max(ONE / bound - ONE / variance, ZERO)
            xx += surplus * x * x
            xy += surplus * x * y
            yy += surplus * y * y
    first = math.sqrt(ONE + xx)
    mixed = xy / first
    second = math.sqrt(max(ONE + yy - mixed * mixed, ONE))
    return ONE / first, -mixed / (first * second), ONE / second


@njit(**OPTIONS)
def _place(
    begin, end,
    vertices, faces, logits, mixing, steiner, normal_scale, blur,
    outward, heights, cosine, sine, reach, thickness, depths, log_density,
    means, scales, rotations, barycentrics, covariance, flat_corners, depth_below, trims,
):  # fmt: skip
    per_face = logits.shape[1]
    width = math.sqrt(blur * blur + normal_scale * normal_scale)
    for i in range(begin, end):
        first, second, third = row(vertices, faces[i, 0]), row(vertices, faces[i, 1]), row(vertices, faces[i, 2])
        edge, other = minus(second, first), minus(third, first)
        normal, _ = unit(cross(edge, other))
        along, across = reference(edge, other, normal, steiner)
        r1, _ = unit(edge)
        x, p, q = dot(edge, r1), dot(other, r1), dot(other, cross(normal, r1))
        flat_corners[i, 0, 0], flat_corners[i, 0, 1] = (-x - p) * THIRD, -q * THIRD
        flat_corners[i, 1, 0], flat_corners[i, 1, 1] = (TWO * x - p) * THIRD, -q * THIRD
        flat_corners[i, 2, 0], flat_corners[i, 2, 1] = (TWO * p - x) * THIRD, TWO * q * THIRD
        f00, f01, f11 = flat_reference(x, p, q, other, steiner)
        deviations = depth = ZERO
        if heights.shape[1] > 0:
            deviations = _deviations(i, heights, cosine, sine, log_density, depths)
            depth = width * deviations
            depth_below[i] = min(depth, _OF_A_SHEET * thickness[i])
        for k in range(per_face):
            largest = max(logits[i, k, 0], logits[i, k, 1], logits[i, k, 2])
            w0 = math.exp(logits[i, k, 0] - largest)
            w1 = math.exp(logits[i, k, 1] - largest)
            w2 = math.exp(logits[i, k, 2] - largest)
            whole = ONE / (w0 + w1 + w2)
            w0, w1, w2 = w0 * whole, w1 * whole, w2 * whole
            barycentrics[i, k, 0], barycentrics[i, k, 1], barycentrics[i, k, 2] = w0, w1, w2
            mean = plus(plus(scaled(first, w0), scaled(second, w1)), scaled(third, w2))
            m00, m01, m10, m11 = mixing[i, k, 0], mixing[i, k, 1], mixing[i, k, 2], mixing[i, k, 3]
            if heights.shape[1] > 0:
                shift = _shift(i, k, barycentrics, outward, heights, cosine, sine, depth)
                c00, c01, c11 = _trim(
                    i, k, shift, barycentrics, mixing, outward, heights, cosine, sine, reach,
                    depth, deviations, blur, normal_scale,
                )  # fmt: skip
                trims[i, k, 0], trims[i, k, 1], trims[i, k, 2] = c00, c01, c11
                mean = plus(minus(mean, scaled(normal, depth_below[i])), shift)
                m00, m01 = m00 * c00, m00 * c01 + m01 * c11
                m10, m11 = m10 * c00, m10 * c01 + m11 * c11
            means[i, k, 0], means[i, k, 1], means[i, k, 2] = mean
            one = plus(scaled(along, m00), scaled(across, m10))
            two = plus(scaled(along, m01), scaled(across, m11))
            length_one, length_two = length(one), length(two)
            scales[i, k, 0], scales[i, k, 1], scales[i, k, 2] = normal_scale, length_one, length_two
            one, two = scaled(one, ONE / length_one), scaled(two, ONE / length_two)
            rotations[i, k, 0, 0], rotations[i, k, 0, 1], rotations[i, k, 0, 2] = normal[0], one[0], two[0]
            rotations[i, k, 1, 0], rotations[i, k, 1, 1], rotations[i, k, 1, 2] = normal[1], one[1], two[1]
            rotations[i, k, 2, 0], rotations[i, k, 2, 1], rotations[i, k, 2, 2] = normal[2], one[2], two[2]
            t00, t01, t10, t11 = f00 * m00 + f01 * m10, f00 * m01 + f01 * m11, f11 * m10, f11 * m11
            covariance[i, k, 0, 0] = t00 * t00 + t01 * t01
            covariance[i, k, 0, 1] = t00 * t10 + t01 * t11
            covariance[i, k, 1, 0] = t00 * t10 + t01 * t11
            covariance[i, k, 1, 1] = t10 * t10 + t11 * t11


@njit(parallel=True, **OPTIONS)
def place(
    vertices, faces, logits, mixing, steiner, normal_scale, blur,
    outward, heights, cosine, sine, reach, thickness, depths, log_density,
    means, scales, rotations, barycentrics, covariance, flat_corners, depth_below, trims,
):  # fmt: skip
    """Fill everything from ``means`` on. Without ``heights`` Gaussians stay on their faces, untrimmed."""
    for chunk in prange((faces.shape[0] + CHUNK - 1) // CHUNK):
        # A function of its own: the passes for parallel loops do not take the tuples in it.
        _place(
            chunk * CHUNK, min((chunk + 1) * CHUNK, faces.shape[0]),
            vertices, faces, logits, mixing, steiner, normal_scale, blur,
            outward, heights, cosine, sine, reach, thickness, depths, log_density,
            means, scales, rotations, barycentrics, covariance, flat_corners, depth_below, trims,
        )  # fmt: skip
