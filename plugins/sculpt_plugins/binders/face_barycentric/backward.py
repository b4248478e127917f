"""Gradients of Gaussians back to rows and faces, for the CPU.

Depth, shift and trim are constants of the step (see ``outline.py``). An array without entries stands for a gradient
that there is none of, or that nobody asked for.
"""

from numba import njit, prange

from .vectors import (
    CHUNK,
    HALF,
    ONE,
    OPTIONS,
    ROOT_THIRD,
    THIRD,
    TWO,
    TWO_THIRDS,
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
    through_unit,
    unit,
)


@njit(**OPTIONS)
def _place_backward(
    begin, end,
    vertices, faces, least, steiner, mixing, trims, depth_below, barycentrics, scales, rotations,
    to_means, to_scales, to_rotations, to_barycentrics, to_covariance, to_flat_corners,
    to_logits, to_log_ratios, to_rotation, to_corners,
):  # fmt: skip
    per_face = mixing.shape[1]
    by_corners = to_corners.shape[0] > 0
    for i in range(begin, end):
        first, second, third = row(vertices, faces[i, 0]), row(vertices, faces[i, 1]), row(vertices, faces[i, 2])
        edge, other = minus(second, first), minus(third, first)
        normal, _ = unit(cross(edge, other))
        along, across = reference(edge, other, normal, steiner)
        r1, _ = unit(edge)
        r2 = cross(normal, r1)
        f00, f01, f11 = flat_reference(dot(edge, r1), dot(other, r1), dot(other, r2), other, steiner)
        none = (ZERO, ZERO, ZERO)
        to_first, to_second, to_third, to_normal, to_along, to_across = none, none, none, none, none, none
        to_f00 = to_f01 = to_f11 = ZERO
        for k in range(per_face):
            w0, w1, w2 = barycentrics[i, k, 0], barycentrics[i, k, 1], barycentrics[i, k, 2]
            g0 = g1 = g2 = ZERO
            if to_means.shape[0] > 0:
                to_mean = (to_means[i, k, 0], to_means[i, k, 1], to_means[i, k, 2])
                g0, g1, g2 = dot(to_mean, first), dot(to_mean, second), dot(to_mean, third)
                if by_corners:
                    to_first = plus(to_first, scaled(to_mean, w0))
                    to_second = plus(to_second, scaled(to_mean, w1))
                    to_third = plus(to_third, scaled(to_mean, w2))
                    if depth_below.shape[0] > 0:
                        to_normal = minus(to_normal, scaled(to_mean, depth_below[i]))
            if to_barycentrics.shape[0] > 0:
                g0 += to_barycentrics[i, k, 0]
                g1 += to_barycentrics[i, k, 1]
                g2 += to_barycentrics[i, k, 2]
            common = w0 * g0 + w1 * g1 + w2 * g2
            to_logits[i, k, 0] = w0 * (g0 - common)
            to_logits[i, k, 1] = w1 * (g1 - common)
            to_logits[i, k, 2] = w2 * (g2 - common)

            a00, a01, a10, a11 = mixing[i, k, 0], mixing[i, k, 1], mixing[i, k, 2], mixing[i, k, 3]
            c00, c01, c11 = ONE, ZERO, ONE
            if trims.shape[0] > 0:
                c00, c01, c11 = trims[i, k, 0], trims[i, k, 1], trims[i, k, 2]
            m00, m01, m10, m11 = a00 * c00, a00 * c01 + a01 * c11, a10 * c00, a10 * c01 + a11 * c11
            # Of a factor's columns the scales are the lengths and the axes the directions.
            first_axis = (rotations[i, k, 0, 1], rotations[i, k, 1, 1], rotations[i, k, 2, 1])
            second_axis = (rotations[i, k, 0, 2], rotations[i, k, 1, 2], rotations[i, k, 2, 2])
            one, two = none, none
            if to_rotations.shape[0] > 0:
                to_axis = (to_rotations[i, k, 0, 1], to_rotations[i, k, 1, 1], to_rotations[i, k, 2, 1])
                one = through_unit(to_axis, first_axis, scales[i, k, 1])
                to_axis = (to_rotations[i, k, 0, 2], to_rotations[i, k, 1, 2], to_rotations[i, k, 2, 2])
                two = through_unit(to_axis, second_axis, scales[i, k, 2])
                if by_corners:
                    to_axis = (to_rotations[i, k, 0, 0], to_rotations[i, k, 1, 0], to_rotations[i, k, 2, 0])
                    to_normal = plus(to_normal, to_axis)
            if to_scales.shape[0] > 0:
                one = plus(one, scaled(first_axis, to_scales[i, k, 1]))
                two = plus(two, scaled(second_axis, to_scales[i, k, 2]))
            to_m00, to_m10, to_m01, to_m11 = dot(along, one), dot(across, one), dot(along, two), dot(across, two)
            if by_corners:
                to_along = plus(to_along, plus(scaled(one, m00), scaled(two, m01)))
                to_across = plus(to_across, plus(scaled(one, m10), scaled(two, m11)))
            if to_covariance.shape[0] > 0:
                # T T^T with T = F M: the gradient by T is (G + G^T) T.
                t00, t01, t10, t11 = f00 * m00 + f01 * m10, f00 * m01 + f01 * m11, f11 * m10, f11 * m11
                h00, h11 = TWO * to_covariance[i, k, 0, 0], TWO * to_covariance[i, k, 1, 1]
                h01 = to_covariance[i, k, 0, 1] + to_covariance[i, k, 1, 0]
                to_t00, to_t01 = h00 * t00 + h01 * t10, h00 * t01 + h01 * t11
                to_t10, to_t11 = h01 * t00 + h11 * t10, h01 * t01 + h11 * t11
                to_m00 += f00 * to_t00
                to_m01 += f00 * to_t01
                to_m10 += f01 * to_t00 + f11 * to_t10
                to_m11 += f01 * to_t01 + f11 * to_t11
                to_f00 += to_t00 * m00 + to_t01 * m01
                to_f01 += to_t00 * m10 + to_t01 * m11
                to_f11 += to_t10 * m10 + to_t11 * m11
            to_a00, to_a01 = to_m00 * c00 + to_m01 * c01, to_m01 * c11
            to_a10, to_a11 = to_m10 * c00 + to_m11 * c01, to_m11 * c11
            to_log_ratios[i, k, 0] = to_a00 * a00 + to_a10 * a10
            to_log_ratios[i, k, 1] = to_a01 * a01 + to_a11 * a11
            if to_rotation.shape[0] > 0:
                to_rotation[i, k] = to_a10 * a00 - to_a00 * a10 + to_a11 * a01 - to_a01 * a11
        if by_corners:
            g00 = g01 = g10 = g11 = g20 = g21 = ZERO
            if to_flat_corners.shape[0] > 0:
                g00, g01 = to_flat_corners[i, 0, 0], to_flat_corners[i, 0, 1]
                g10, g11 = to_flat_corners[i, 1, 0], to_flat_corners[i, 1, 1]
                g20, g21 = to_flat_corners[i, 2, 0], to_flat_corners[i, 2, 1]
            to_x, to_p = (TWO * g10 - g00 - g20) * THIRD, (TWO * g20 - g00 - g10) * THIRD
            to_q = (TWO * g21 - g01 - g11) * THIRD
            to_edge, to_other = _through_reference(edge, other, normal, steiner, to_along, to_across)
            if steiner:
                to_x += ROOT_THIRD * to_f00 - THIRD * to_f01
                to_p += TWO_THIRDS * to_f01
                to_q += TWO_THIRDS * to_f11
            else:
                to_x += HALF * to_f00
                to_other = plus(to_other, scaled(other, HALF * to_f11 / length(other)))
                to_normal = plus(to_normal, _edges_to_normal(edge, other, to_across))
            in_face, in_normal, more = _through_flat(edge, other, normal, to_x, to_p, to_q)
            to_edge, to_other, to_normal = plus(to_edge, in_face), plus(to_other, more), plus(to_normal, in_normal)
            upward = cross(edge, other)
            direction, size = unit(upward)
            to_area = through_unit(to_normal, direction, max(size, least))
            to_edge = plus(to_edge, cross(other, to_area))
            to_other = plus(to_other, cross(to_area, edge))
            to_first = minus(to_first, plus(to_edge, to_other))
            to_second, to_third = plus(to_second, to_edge), plus(to_third, to_other)
            to_corners[i, 0, 0], to_corners[i, 0, 1], to_corners[i, 0, 2] = to_first
            to_corners[i, 1, 0], to_corners[i, 1, 1], to_corners[i, 1, 2] = to_second
            to_corners[i, 2, 0], to_corners[i, 2, 1], to_corners[i, 2, 2] = to_third


@njit(**OPTIONS)
def _through_reference(edge, other, normal, steiner, to_along, to_across):
    """Gradients by both edges of what depends on the reference radii, but for what comes through the normal."""
    if steiner:
        half = scaled(to_across, TWO_THIRDS)
        return minus(scaled(to_along, ROOT_THIRD), scaled(half, HALF)), half
    direction, size = unit(edge)
    reach = length(other)
    # Across = reach / 2 (normal x direction).
    to_direction = scaled(cross(to_across, normal), HALF * reach)
    to_reach = HALF * dot(to_across, cross(normal, direction))
    to_edge = plus(scaled(to_along, HALF), through_unit(to_direction, direction, size))
    return to_edge, scaled(other, to_reach / reach)


@njit(**OPTIONS)
def _edges_to_normal(edge, other, to_across):
    direction, _ = unit(edge)
    return scaled(cross(direction, to_across), HALF * length(other))


@njit(**OPTIONS)
def _through_flat(edge, other, normal, to_x, to_p, to_q):
    """Gradients by the first edge, the normal and the second edge of what depends on x = edge . r1, p = other . r1 and
    q = other . (normal x r1), r1 being the direction of the first edge."""
    r1, size = unit(edge)
    to_r2 = scaled(other, to_q)
    to_r1 = plus(plus(scaled(edge, to_x), scaled(other, to_p)), cross(to_r2, normal))
    to_edge = plus(scaled(r1, to_x), through_unit(to_r1, r1, size))
    to_other = plus(scaled(r1, to_p), scaled(cross(normal, r1), to_q))
    return to_edge, cross(r1, to_r2), to_other


@njit(parallel=True, **OPTIONS)
def place_backward(
    vertices, faces, least, steiner, mixing, trims, depth_below, barycentrics, scales, rotations,
    to_means, to_scales, to_rotations, to_barycentrics, to_covariance, to_flat_corners,
    to_logits, to_log_ratios, to_rotation, to_corners,
):  # fmt: skip
    """Fill ``to_logits``, ``to_log_ratios``, ``to_rotation`` and, where there is any, ``to_corners`` (f, 3, 3).

    ``least`` is the parallelogram of the smallest face whose normal teaches (``BindOptions.least_parallelogram``).
    """
    for chunk in prange((faces.shape[0] + CHUNK - 1) // CHUNK):
        # A function of its own: the passes for parallel loops do not take the tuples in it.
        _place_backward(
            chunk * CHUNK, min((chunk + 1) * CHUNK, faces.shape[0]),
            vertices, faces, least, steiner, mixing, trims, depth_below, barycentrics, scales, rotations,
            to_means, to_scales, to_rotations, to_barycentrics, to_covariance, to_flat_corners,
            to_logits, to_log_ratios, to_rotation, to_corners,
        )  # fmt: skip


@njit(**OPTIONS)
def gather(faces, to_corners, to_vertices):
    """Add the gradients of faces' corners up by vertex, in the order of the faces. On one thread: no two collide."""
    for i in range(faces.shape[0]):
        for j in range(3):
            v = faces[i, j]
            to_vertices[v, 0] += to_corners[i, j, 0]
            to_vertices[v, 1] += to_corners[i, j, 1]
            to_vertices[v, 2] += to_corners[i, j, 2]
