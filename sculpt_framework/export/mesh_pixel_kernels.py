"""Triangles to pixels, and pixels of photographs onto texels: the loops, for the CPU."""

import numpy as np
from numba import njit

_OPTIONS = {"error_model": "numpy", "cache": True, "nogil": True}


@njit(**_OPTIONS)
def draw(places, inverse_depth, faces, closed, face, weights, nearest):
    """Fill in, for each pixel centre, the nearest triangle, its perspective-correct weights, and 1/z there.

    ``places`` (v, 2) are columns and rows, ``inverse_depth`` (v) is 1/z, 0 for what must not be drawn. ``face`` comes
    as -1 and ``nearest`` as 0 everywhere. Of a ``closed`` surface seen from outside the faces that look away, which
    others hide, are passed over: corners turn counter-clockwise seen from outside, and rows count downwards.
    """
    height, width = face.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        i0, i1, i2 = inverse_depth[a], inverse_depth[b], inverse_depth[c]
        if i0 <= 0 or i1 <= 0 or i2 <= 0:
            continue
        x0, y0 = places[a, 0], places[a, 1]
        x1, y1 = places[b, 0], places[b, 1]
        x2, y2 = places[c, 0], places[c, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0 or (closed and area > 0):
            continue
        left = max(0, int(np.ceil(max(-1.0, min(x0, x1, x2)) - 0.5)))
        right = min(width - 1, int(np.floor(min(width + 1.0, max(x0, x1, x2)) - 0.5)))
        top = max(0, int(np.ceil(max(-1.0, min(y0, y1, y2)) - 0.5)))
        bottom = min(height - 1, int(np.floor(min(height + 1.0, max(y0, y1, y2)) - 0.5)))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                b0 = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                b1 = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                b2 = 1.0 - b0 - b1
                if b0 < 0 or b1 < 0 or b2 < 0:
                    continue
                inverse = b0 * i0 + b1 * i1 + b2 * i2
                if inverse > nearest[row, column]:
                    nearest[row, column] = inverse
                    face[row, column] = f
                    weights[row, column, 0] = b0 * i0 / inverse
                    weights[row, column, 1] = b1 * i1 / inverse
                    weights[row, column, 2] = b2 * i2 / inverse


@njit(forceinline=True, **_OPTIONS)
def _project(pose, lens, point):
    x = pose[0, 0] * point[0] + pose[0, 1] * point[1] + pose[0, 2] * point[2] + pose[0, 3]
    y = pose[1, 0] * point[0] + pose[1, 1] * point[1] + pose[1, 2] * point[2] + pose[1, 3]
    z = pose[2, 0] * point[0] + pose[2, 1] * point[1] + pose[2, 2] * point[2] + pose[2, 3]
    if z <= 0:
        return -1.0, -1.0, z
    return lens[0] * x / z + lens[2], lens[1] * y / z + lens[3], z


@njit(**_OPTIONS)
def see(points, normals, pose, lens, center, farthest, slack, cosine):
    """Cosine between each point's normal and the way to the camera; 0 where the camera does not see the point.

    ``farthest`` (h, w) is the largest depth of surface in the pixels around, infinite where there is none.
    """
    height, width = farthest.shape
    for i in range(points.shape[0]):
        cosine[i] = 0.0
        column, row, z = _project(pose, lens, points[i])
        if z <= 0 or column < 0 or row < 0 or column >= width or row >= height:
            continue
        if z > farthest[int(row), int(column)] + slack:
            continue
        x, y, w = center[0] - points[i, 0], center[1] - points[i, 1], center[2] - points[i, 2]
        length = np.sqrt(x * x + y * y + w * w)
        cosine[i] = max(0.0, (x * normals[i, 0] + y * normals[i, 1] + w * normals[i, 2]) / length)


@njit(**_OPTIONS)
def gather(points, cosine, pose, lens, image, trust, first, tolerance, least, sums, weight):
    """Add what an image shows at the points to ``sums``, and how much that counts to ``weight``.

    Bilinear. ``trust`` (h, w) is 1 at pixels that certainly show the object. Counted are views that see the point at
    more than ``least`` of the cosine: with ``tolerance`` 0 all alike, else by cosine and resolution, and less the
    further a colour is from ``first``.
    """
    height, width = trust.shape
    for i in range(points.shape[0]):
        if cosine[i] <= least:
            continue
        column, row, z = _project(pose, lens, points[i])
        column -= 0.5
        row -= 0.5
        if z <= 0 or column < 0 or row < 0 or column > width - 1.001 or row > height - 1.001:
            continue
        c, r = int(column), int(row)
        u, v = column - c, row - r
        a00, a01 = (1 - u) * (1 - v), u * (1 - v)
        a10, a11 = (1 - u) * v, u * v
        sure = a00 * trust[r, c] + a01 * trust[r, c + 1] + a10 * trust[r + 1, c] + a11 * trust[r + 1, c + 1]
        if sure < 0.999:
            continue
        red = a00 * image[r, c, 0] + a01 * image[r, c + 1, 0] + a10 * image[r + 1, c, 0] + a11 * image[r + 1, c + 1, 0]
        green = (
            a00 * image[r, c, 1] + a01 * image[r, c + 1, 1] + a10 * image[r + 1, c, 1] + a11 * image[r + 1, c + 1, 1]
        )
        blue = a00 * image[r, c, 2] + a01 * image[r, c + 1, 2] + a10 * image[r + 1, c, 2] + a11 * image[r + 1, c + 1, 2]
        w = 1.0
        if tolerance > 0:
            # How many pixels a piece of surface fills: cosine times focal length over distance, squared.
            sharp = cosine[i] * lens[0] / z
            w = sharp * sharp * cosine[i] * cosine[i]
            far = (red - first[i, 0]) ** 2 + (green - first[i, 1]) ** 2 + (blue - first[i, 2]) ** 2
            w *= np.exp(-far / (2 * tolerance * tolerance)) + 1e-4
        sums[i, 0] += w * red
        sums[i, 1] += w * green
        sums[i, 2] += w * blue
        weight[i] += w
