"""Photographs laid into each other through a mesh, and compared, with how that changes as the surface moves: the loops,
for the CPU."""

import numpy as np
from numba import njit

# Faces and masks say what there is: no number here is infinite or NaN.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_OUTSIDE = 2
"""Pixels between what is sampled and the image's border: what the four by four pixels of a sample need."""


@njit(**_OPTIONS)
def planes(local, faces, out):
    """Unit normal of each face (f) and its product with the face's points: ``out`` (f, 4). 0 for a face of no area."""
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = local[b, 0] - local[a, 0], local[b, 1] - local[a, 1], local[b, 2] - local[a, 2]
        vx, vy, vz = local[c, 0] - local[a, 0], local[c, 1] - local[a, 1], local[c, 2] - local[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / length if length > 0 else 0.0
        out[f, 0], out[f, 1], out[f, 2] = scale * nx, scale * ny, scale * nz
        out[f, 3] = scale * (nx * local[a, 0] + ny * local[a, 1] + nz * local[a, 2])


@njit(forceinline=True, **_OPTIONS)
def _cubic(t):
    """Catmull and Rom's weights of four pixels in a row, ``t`` behind the second, and their slopes by ``t``."""
    s = t * t
    c = s * t
    w0, w1 = -0.5 * c + s - 0.5 * t, 1.5 * c - 2.5 * s + 1.0
    w2, w3 = -1.5 * c + 2.0 * s + 0.5 * t, 0.5 * c - 0.5 * s
    d0, d1 = -1.5 * s + 2.0 * t - 0.5, 4.5 * s - 5.0 * t
    d2, d3 = -4.5 * s + 4.0 * t + 0.5, 1.5 * s - t
    return w0, w1, w2, w3, d0, d1, d2, d3


@njit(forceinline=True, **_OPTIONS)
def _across(image, row, column, x0, x1, x2, x3):
    return (
        x0 * image[row, column - 1]
        + x1 * image[row, column]
        + x2 * image[row, column + 1]
        + x3 * image[row, column + 2]
    )


@njit(forceinline=True, **_OPTIONS)
def _sample(image, column, row):
    """The image at a place counted from the middle of its first pixel, and its slopes along columns and rows."""
    c, r = int(column), int(row)
    x0, x1, x2, x3, dx0, dx1, dx2, dx3 = _cubic(column - c)
    y0, y1, y2, y3, dy0, dy1, dy2, dy3 = _cubic(row - r)
    a, b = _across(image, r - 1, c, x0, x1, x2, x3), _across(image, r, c, x0, x1, x2, x3)
    d, e = _across(image, r + 1, c, x0, x1, x2, x3), _across(image, r + 2, c, x0, x1, x2, x3)
    across = y0 * _across(image, r - 1, c, dx0, dx1, dx2, dx3) + y1 * _across(image, r, c, dx0, dx1, dx2, dx3)
    across += y2 * _across(image, r + 1, c, dx0, dx1, dx2, dx3) + y3 * _across(image, r + 2, c, dx0, dx1, dx2, dx3)
    return y0 * a + y1 * b + y2 * d + y3 * e, across, dy0 * a + dy1 * b + dy2 * d + dy3 * e


@njit(**_OPTIONS)
def lay(
    face, plane, lens, usable, rotation, shift, other_lens, other_image, other_usable, farthest, slack, least,
    laid, slopes, shared,
):  # fmt: skip
    """What a second image shows where the first camera sees the surface.

    ``face`` (h, w) is what the first camera sees, -1 for nothing; ``plane`` as ``planes`` has it, in its frame;
    ``rotation`` and ``shift`` lead from there to the second camera's frame. ``farthest`` is the largest depth around
    each pixel of the second. Filled in: ``laid``, the second image at the surface; ``slopes``, how it changes per unit
    by which the surface moves along its normal; ``shared``, whether both cameras see the place, at more than ``least``
    of the cosine, and may use what they see.
    """
    height, width = face.shape
    for row in range(height):
        y = (row + 0.5 - lens[3]) / lens[1]
        for column in range(width):
            laid[row, column], slopes[row, column], shared[row, column] = 0.0, 0.0, False
            f = face[row, column]
            if f < 0 or not usable[row, column]:
                continue
            x = (column + 0.5 - lens[2]) / lens[0]
            nx, ny, nz = plane[f, 0], plane[f, 1], plane[f, 2]
            facing = nx * x + ny * y + nz
            if facing >= 0 or facing * facing < least * least * (x * x + y * y + 1.0):
                continue
            z = plane[f, 3] / facing
            wx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
            wy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
            wz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
            px, py, pz = z * wx + shift[0], z * wy + shift[1], z * wz + shift[2]
            if pz <= 0:
                continue
            mx = rotation[0, 0] * nx + rotation[0, 1] * ny + rotation[0, 2] * nz
            my = rotation[1, 0] * nx + rotation[1, 1] * ny + rotation[1, 2] * nz
            mz = rotation[2, 0] * nx + rotation[2, 1] * ny + rotation[2, 2] * nz
            there = mx * px + my * py + mz * pz
            if there >= 0 or there * there < least * least * (px * px + py * py + pz * pz):
                continue
            nearness = 1.0 / pz
            u = other_lens[0] * px * nearness + other_lens[2]
            v = other_lens[1] * py * nearness + other_lens[3]
            if u < _OUTSIDE or v < _OUTSIDE or u > farthest.shape[1] - _OUTSIDE or v > farthest.shape[0] - _OUTSIDE:
                continue
            if not other_usable[int(v), int(u)] or pz > farthest[int(v), int(u)] + slack:
                continue
            value, across, down = _sample(other_image, u - 0.5, v - 0.5)
            laid[row, column], shared[row, column] = value, True
            along = across * other_lens[0] * (wx * pz - px * wz) + down * other_lens[1] * (wy * pz - py * wz)
            # A plane moved by one unit along its normal is 1 / facing deeper.
            slopes[row, column] = along * nearness * nearness / facing


@njit(**_OPTIONS)
def _enter(sums, row, sign, image, laid, shared):
    """Add a row to what is summed along each column: shared pixels, both images, their squares and product."""
    for column in range(image.shape[1]):
        if shared[row, column]:
            # About the middle of the range, so that squares keep their digits.
            a, b = image[row, column] - 0.5, laid[row, column] - 0.5
            sums[0, column] += sign
            sums[1, column] += sign * a
            sums[2, column] += sign * b
            sums[3, column] += sign * a * a
            sums[4, column] += sign * b * b
            sums[5, column] += sign * a * b


@njit(**_OPTIONS)
def correlate(image, laid, shared, half, filled, noise, worst, parts):
    """Compare windows of ``2 half + 1`` pixels around all shared pixels of two images.

    A window counts if ``filled`` pixels of it are shared, by its contrast in the first image against ``noise``, a
    variance. Returns the sum of min(1 - correlation, ``worst``) and that of what windows count; into ``parts``
    (h, w, 4) goes what ``by_laid`` needs of each.
    """
    height, width = image.shape
    sums, total, judged = np.zeros((6, width)), 0.0, 0.0
    for row in range(min(half, height)):
        _enter(sums, row, 1.0, image, laid, shared)
    for row in range(height):
        if row + half < height:
            _enter(sums, row + half, 1.0, image, laid, shared)
        if row - half - 1 >= 0:
            _enter(sums, row - half - 1, -1.0, image, laid, shared)
        n, one, two, one_one, two_two, one_two = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for column in range(-half, width):
            if column + half < width:
                k = column + half
                n, one, two = n + sums[0, k], one + sums[1, k], two + sums[2, k]
                one_one, two_two, one_two = one_one + sums[3, k], two_two + sums[4, k], one_two + sums[5, k]
            if column < 0:
                continue
            k = column - half - 1
            if k >= 0:
                n, one, two = n - sums[0, k], one - sums[1, k], two - sums[2, k]
                one_one, two_two, one_two = one_one - sums[3, k], two_two - sums[4, k], one_two - sums[5, k]
            for part in range(4):
                parts[row, column, part] = 0.0
            if not shared[row, column] or n < filled:
                continue
            share = 1.0 / n
            mean_one, mean_two = share * one, share * two
            contrast = max(share * one_one - mean_one * mean_one, 0.0)
            square_one = contrast + noise
            square_two = max(share * two_two - mean_two * mean_two, 0.0) + noise
            scale = 1.0 / np.sqrt(square_one * square_two)
            alike = (share * one_two - mean_one * mean_two) * scale
            # Half of what it says counts where contrast is twice the noise.
            weight = contrast / (contrast + 4.0 * noise)
            judged += weight
            total += weight * min(1.0 - alike, worst)
            if 1.0 - alike < worst:
                # By a pixel of the second image: (one - mean) / (n s1 s2) - alike (two - mean) / (n s2 s2).
                a, b = weight * share * scale, weight * share * alike / square_two
                parts[row, column, 0], parts[row, column, 1] = a, a * mean_one
                parts[row, column, 2], parts[row, column, 3] = b, b * mean_two
    return total, judged


@njit(**_OPTIONS)
def by_laid(image, laid, shared, half, parts, slope):
    """How the sum that ``correlate`` returned first changes with each pixel of ``laid``: ``slope`` (h, w)."""
    height, width = image.shape
    sums = np.zeros((width, 4))
    for row in range(-half, height):
        if row + half < height:
            for column in range(width):
                for part in range(4):
                    sums[column, part] += parts[row + half, column, part]
        if row < 0:
            continue
        if row - half - 1 >= 0:
            for column in range(width):
                for part in range(4):
                    sums[column, part] -= parts[row - half - 1, column, part]
        a, a_mean, b, b_mean = 0.0, 0.0, 0.0, 0.0
        for column in range(-half, width):
            k = column + half
            if k < width:
                a, a_mean, b, b_mean = a + sums[k, 0], a_mean + sums[k, 1], b + sums[k, 2], b_mean + sums[k, 3]
            if column < 0:
                continue
            k = column - half - 1
            if k >= 0:
                a, a_mean, b, b_mean = a - sums[k, 0], a_mean - sums[k, 1], b - sums[k, 2], b_mean - sums[k, 3]
            slope[row, column] = 0.0
            if shared[row, column]:
                one, two = image[row, column] - 0.5, laid[row, column] - 0.5
                slope[row, column] = (two * b - b_mean) - (one * a - a_mean)


@njit(**_OPTIONS)
def to_corners(slope, by_normal, face, weights, plane, faces, gradient):
    """Add to ``gradient`` (v, 3), camera frame, what moving the corners of the faces does to a sum over pixels.

    The sum changes by ``slope`` times ``by_normal`` as the surface at a pixel moves along its normal by one unit, and a
    corner moves it by its weight.
    """
    height, width = face.shape
    for row in range(height):
        for column in range(width):
            along = slope[row, column] * by_normal[row, column]
            if along == 0.0:
                continue
            f = face[row, column]
            nx, ny, nz = along * plane[f, 0], along * plane[f, 1], along * plane[f, 2]
            for k in range(3):
                part, corner = weights[row, column, k], faces[f, k]
                gradient[corner, 0] += part * nx
                gradient[corner, 1] += part * ny
                gradient[corner, 2] += part * nz
