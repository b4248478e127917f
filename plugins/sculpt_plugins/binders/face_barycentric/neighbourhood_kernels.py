"""``outline.Neighbourhood`` in compiled kernels: a surface as seen from each of its faces. For the CPU."""

import math

import numpy as np
from numba import njit, prange

from .limits import FLAT, OPPOSITE, PLACE_BITS, TINY, UNDECIDED
from .vectors import CHUNK, HALF, OPTIONS, THIRD, ZERO, cross, dot, minus, plus, reference, row, scaled, unit

_FLAT, _TINY = np.float32(FLAT), np.float32(TINY)
_OPPOSITE, _UNDECIDED, _FAR = np.float32(OPPOSITE), np.float32(UNDECIDED), np.float32(np.inf)
_PLACE_BITS = np.int64(PLACE_BITS)
_LAST_PLACE = np.float32(2**PLACE_BITS - 1)
NOT_WANTED = np.int64(-1)


@njit(forceinline=True, **OPTIONS)
def _column(array, index):
    return array[0, index], array[1, index], array[2, index]


@njit(forceinline=True, **OPTIONS)
def _put(array, index, values):
    array[0, index], array[1, index], array[2, index] = values


@njit(**OPTIONS)
def list_edges(faces, starts, entries):
    """Numbers 3 face + edge of all edges in ``entries``, by the lower of their two vertices.

    Those of vertex v lie from starts[v] to starts[v + 1]; ``starts``, two longer than there are vertices, comes zeroed.
    """
    for i in range(faces.shape[0]):
        for j in range(3):
            starts[min(faces[i, j], faces[i, (j + 1) % 3]) + 2] += 1
    for v in range(2, starts.shape[0]):
        starts[v] += starts[v - 1]
    for i in range(faces.shape[0]):
        for j in range(3):
            lower = min(faces[i, j], faces[i, (j + 1) % 3])
            entries[starts[lower + 1]] = 3 * i + j
            starts[lower + 1] += 1


@njit(parallel=True, **OPTIONS)
def pair_edges(faces, starts, entries, across):
    """The face across each edge, by number of the edge; the face itself where it does not have exactly two faces."""
    for v in prange(starts.shape[0] - 2):
        for first in range(starts[v], starts[v + 1]):
            edge = entries[first]
            far = max(faces[edge // 3, edge % 3], faces[edge // 3, (edge % 3 + 1) % 3])
            others, other_face = 0, edge // 3
            for second in range(starts[v], starts[v + 1]):
                other = entries[second]
                face, j = other // 3, other % 3
                if second != first and max(faces[face, j], faces[face, (j + 1) % 3]) == far:
                    others += 1
                    other_face = face
            across[edge] = other_face if others == 1 else edge // 3


@njit(parallel=True, **OPTIONS)
def look_along(vertices, faces, normals, centroids):
    """Unit normals and centroids, as columns."""
    for i in prange(faces.shape[0]):
        a, b, c = row(vertices, faces[i, 0]), row(vertices, faces[i, 1]), row(vertices, faces[i, 2])
        normal, _ = unit(cross(minus(b, a), minus(c, a)))
        _put(normals, i, normal)
        _put(centroids, i, scaled(plus(plus(a, b), c), THIRD))


@njit(parallel=True, **OPTIONS)
def look_across(vertices, faces, steiner, across, normals, outward, heights, cosine, sine, reach, areas):
    """What ``Neighbourhood`` has of each edge; ``areas`` are sums over chunks of faces."""
    count = faces.shape[0]
    for chunk in prange(areas.shape[0]):
        area = 0.0
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count)):
            normal = _column(normals, i)
            first, second = row(vertices, faces[i, 0]), row(vertices, faces[i, 1])
            third = row(vertices, faces[i, 2])
            along, other = reference(minus(second, first), minus(third, first), normal, steiner)
            for j in range(3):
                corner, opposite = row(vertices, faces[i, j]), row(vertices, faces[i, (j + 2) % 3])
                edge = minus(row(vertices, faces[i, (j + 1) % 3]), corner)
                size = math.sqrt(dot(edge, edge)) + _TINY
                out = cross(edge, normal)
                out = out[0] / size, out[1] / size, out[2] / size
                theirs = _column(normals, across[3 * i + j])
                bend = dot(theirs, out)
                _put(outward[j], i, out)
                heights[j, i] = dot(minus(corner, opposite), out)
                cosine[j, i] = dot(theirs, normal)
                # A bend that is not a number is one: it has to show.
                sine[j, i] = ZERO if bend <= _FLAT else bend
                reach[j, 0, i], reach[j, 1, i] = dot(out, along), dot(out, other)
                if j == 0:
                    area += HALF * heights[0, i] * size
        areas[chunk] = area


@njit(forceinline=True, **OPTIONS)
def _name(axis, ahead, cells, place, count):
    side = np.int64(2 * axis + (1 if ahead else 0))
    name = (side * count + cells[(axis + 1) % 3]) * count + cells[(axis + 2) % 3]
    return name << _PLACE_BITS | place


@njit(parallel=True, **OPTIONS)
def name_sides(centroids, normals, low, extent, column, names, wanted):
    """Names of the faces, and names that their partners would have, as in thickness.py.

    ``low`` has the least coordinates, ``extent`` is the largest one. ``wanted`` has two rows; the second is
    ``NOT_WANTED`` unless the normal is undecided between two axes.
    """
    count = np.int64(extent / column) + 1
    per_place = _LAST_PLACE / max(extent, _TINY)
    for i in prange(centroids.shape[1]):
        normal = _column(normals, i)
        x, y, z = centroids[0, i] - low[0], centroids[1, i] - low[1], centroids[2, i] - low[2]
        cells = np.int64(x / column), np.int64(y / column), np.int64(z / column)
        places = np.int64(x * per_place), np.int64(y * per_place), np.int64(z * per_place)
        sizes = abs(normal[0]), abs(normal[1]), abs(normal[2])
        longest = 0 if sizes[0] >= sizes[1] else 1
        longest = 2 if sizes[2] > sizes[longest] else longest
        second, third = (longest + 1) % 3, (longest + 2) % 3
        second = third if sizes[third] > sizes[second] else second
        names[i] = _name(longest, normal[longest] > ZERO, cells, places[longest], count)
        wanted[0, i] = _name(longest, normal[longest] <= ZERO, cells, places[longest], count)
        wanted[1, i] = NOT_WANTED
        if sizes[second] > _UNDECIDED * sizes[longest]:
            wanted[1, i] = _name(second, normal[second] <= ZERO, cells, places[second], count)


@njit(parallel=True, **OPTIONS)
def find_gaps(centroids, normals, ordered, order, wanted, thickness):
    """The least distance down to a face next to one of the wanted names that is another side of a sheet.

    ``ordered`` are the names, ascending, and ``order`` the faces that have them.
    """
    for i in prange(centroids.shape[1]):
        center, normal, nearest = _column(centroids, i), _column(normals, i), _FAR
        for choice in range(2):
            name = wanted[choice, i]
            if name == NOT_WANTED:
                continue
            slot = np.searchsorted(ordered, name)
            for candidate in range(max(slot - 1, 0), min(slot + 1, ordered.shape[0])):
                if ordered[candidate] >> _PLACE_BITS != name >> _PLACE_BITS:
                    continue
                other = order[candidate]
                gap = dot(minus(center, _column(centroids, other)), normal)
                if gap > ZERO and gap < nearest and dot(normal, _column(normals, other)) < _OPPOSITE:
                    nearest = gap
        thickness[i] = nearest
