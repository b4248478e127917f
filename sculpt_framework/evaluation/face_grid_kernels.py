"""The nearest triangle to each of many points, by a grid over a mesh whose triangles are of about one size."""

import numpy as np
from numba import njit, prange

# No "nnan" and "ninf": a point that is not a number has no nearest triangle.
_OPTIONS = {"fastmath": {"nsz", "contract"}, "error_model": "numpy", "cache": True, "nogil": True}
_FLAT = 1e-12
"""Squared sine of the angle at a corner, below which a triangle is nothing but its sides."""
_ROUNDING = 1.0 - 1e-9
"""A triangle that ends at a wall between cells may be listed on its other side."""


@njit(forceinline=True)
def _corner(vertices, faces, face, number):
    vertex = faces[face, number]
    return vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2]


@njit(forceinline=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(forceinline=True)
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(**_OPTIONS)
def _squared_distance(p, a, b, c):
    """From a point to a triangle: to the plane if it lies above the inside, else to the nearest side."""
    ab, ac, ap = _minus(b, a), _minus(c, a), _minus(p, a)
    d00, d01, d11 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    d20, d21 = _dot(ap, ab), _dot(ap, ac)
    area = d00 * d11 - d01 * d01
    v, w = d11 * d20 - d01 * d21, d00 * d21 - d01 * d20
    if area > _FLAT * d00 * d11 and v >= 0.0 and w >= 0.0 and v + w <= area:
        v, w = v / area, w / area
        rest = ap[0] - v * ab[0] - w * ac[0], ap[1] - v * ab[1] - w * ac[1], ap[2] - v * ab[2] - w * ac[2]
        return _dot(rest, rest)
    return min(_to_segment(ap, ab), _to_segment(ap, ac), _to_segment(_minus(p, b), _minus(c, b)))


@njit(**_OPTIONS)
def _to_segment(way, along):
    length = _dot(along, along)
    share = min(1.0, max(0.0, _dot(way, along) / length)) if length > 0.0 else 0.0
    rest = way[0] - share * along[0], way[1] - share * along[1], way[2] - share * along[2]
    return _dot(rest, rest)


@njit(forceinline=True)
def _cell(coordinate, origin, side, count):
    return min(max(int((coordinate - origin) / side), 0), count - 1)


@njit(forceinline=True)
def _to_cell(coordinate, cell, origin, side):
    """Squared distance along an axis to the nearest place in a cell."""
    low = origin + cell * side
    gap = max(low - coordinate, coordinate - (low + side), 0.0)
    return gap * gap


@njit(forceinline=True)
def _cells_of(vertices, faces, face, axis, origin, side, shape):
    """First and last cell along an axis that a triangle's box meets."""
    x = vertices[faces[face, 0], axis]
    y, z = vertices[faces[face, 1], axis], vertices[faces[face, 2], axis]
    first = _cell(min(x, y, z), origin[axis], side, shape[axis])
    return first, _cell(max(x, y, z), origin[axis], side, shape[axis])


@njit(**_OPTIONS)
def list_faces(vertices, faces, origin, side, shape, cursor, entries):
    """Move ``cursor`` on by the number of triangles that meet each cell; put these in ``entries``, if it has room, from
    where it was."""
    for face in range(faces.shape[0]):
        x0, x1 = _cells_of(vertices, faces, face, 0, origin, side, shape)
        y0, y1 = _cells_of(vertices, faces, face, 1, origin, side, shape)
        z0, z1 = _cells_of(vertices, faces, face, 2, origin, side, shape)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    cell = (x * shape[1] + y) * shape[2] + z
                    if entries.shape[0] > 0:
                        entries[cursor[cell]] = face
                    cursor[cell] += 1


@njit(parallel=True, **_OPTIONS)
def find_nearest(points, vertices, faces, origin, side, shape, starts, entries, rings, squared, nearest):
    """Squared distances, and the nearest triangles; -1 where there is none within so many rings of cells.

    Cells are looked at in cubic shells round the point's own, or the one next to it, until none further out can hold
    anything nearer; in a shell those are passed over that lie further away than the nearest triangle so far.
    """
    for i in prange(points.shape[0]):
        p = points[i, 0], points[i, 1], points[i, 2]
        best, best_face, done = np.inf, -1, False
        cx = _cell(p[0], origin[0], side, shape[0])
        cy = _cell(p[1], origin[1], side, shape[1])
        cz = _cell(p[2], origin[2], side, shape[2])
        for ring in range(rings):
            for x in range(max(cx - ring, 0), min(cx + ring, shape[0] - 1) + 1):
                to_x = _to_cell(p[0], x, origin[0], side)
                if to_x * _ROUNDING > best:
                    continue
                for y in range(max(cy - ring, 0), min(cy + ring, shape[1] - 1) + 1):
                    to_column = to_x + _to_cell(p[1], y, origin[1], side)
                    if to_column * _ROUNDING > best:
                        continue
                    # Inside the shell only its two ends along z are new.
                    on_side = abs(x - cx) == ring or abs(y - cy) == ring
                    step = 1 if on_side or ring == 0 else 2 * ring
                    for z in range(cz - ring, cz + ring + 1, step):
                        if z < 0 or z >= shape[2]:
                            continue
                        if (to_column + _to_cell(p[2], z, origin[2], side)) * _ROUNDING > best:
                            continue
                        cell = (x * shape[1] + y) * shape[2] + z
                        for entry in range(starts[cell], starts[cell + 1]):
                            face = entries[entry]
                            a, b = _corner(vertices, faces, face, 0), _corner(vertices, faces, face, 1)
                            distance = _squared_distance(p, a, b, _corner(vertices, faces, face, 2))
                            if distance < best or (distance == best and face < best_face):
                                best, best_face = distance, face
            # How far it is to the nearest cell that was not looked at.
            margin = np.inf
            for axis in range(3):
                own = cx if axis == 0 else cy if axis == 1 else cz
                if own - ring > 0:
                    margin = min(margin, p[axis] - (origin[axis] + (own - ring) * side))
                if own + ring < shape[axis] - 1:
                    margin = min(margin, origin[axis] + (own + ring + 1) * side - p[axis])
            if best <= margin * margin:
                done = True
                break
        squared[i] = best
        nearest[i] = best_face if done else -1
