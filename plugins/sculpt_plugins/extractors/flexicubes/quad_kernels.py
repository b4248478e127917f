"""The quads of a dual surface, and along which diagonal each is split, in compiled kernels. For the CPU."""

import math

import numpy as np
from numba import njit, prange

_OPTIONS = {"error_model": "numpy", "cache": True, "nogil": True}
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


@njit(**_OPTIONS)
def count_edges(cases, axes):
    """Number of edges with a sign change along each axis: each belongs to the lowest of its four cells."""
    count = np.zeros(3, np.int64)
    for axis in range(3):
        near = 1 << axes[axis, 1] | 1 << axes[axis, 2]
        far = near | 1 << axis
        for cell in range(cases.shape[0]):
            count[axis] += (cases[cell] >> near ^ cases[cell] >> far) & 1
    return count


@njit(parallel=True, **_OPTIONS)
def list_edges(
    axes, first, cases, corners, cell_corners, cell_at_corner, cell_vertices,
    ends, cells, cell_ends, cell_edge, vertices, keys, axis_of, descending,
):  # fmt: skip
    """Fill the rows of ``topology.DualTopology``: the edges along each axis from row first[axis], by cell."""
    for axis in prange(3):
        b, c = axes[axis, 1], axes[axis, 2]
        near = 1 << b | 1 << c
        far = near | 1 << axis
        e = first[axis]
        for owner in range(cases.shape[0]):
            down = cases[owner] >> far & 1
            if cases[owner] >> near & 1 == down:
                continue
            lower, upper = cell_corners[owner, near], cell_corners[owner, far]
            ends[e, 0], ends[e, 1] = (upper, lower) if down else (lower, upper)
            keys[e], axis_of[e], descending[e] = corners[lower], axis, down
            for place in range(4):
                # The cells lie at these corners of the lowest one, counter-clockwise seen from the outer end.
                turn = 4 - place if down and place > 0 else place
                around = (1 << b if turn == 1 or turn == 2 else 0) | (1 << c if turn >= 2 else 0)
                at = near ^ around
                number = 4 * axis + (at >> b & 1) + 2 * (at >> c & 1)
                cell = cell_at_corner[cell_corners[owner, around]]
                cells[e, place], cell_edge[e, place] = cell, number
                cell_ends[e, place, 0], cell_ends[e, place, 1] = at | down << axis, at | (1 - down) << axis
                vertices[e, place] = cell_vertices[cell, number]
            e += 1


@njit(forceinline=True, **_OPTIONS)
def _smallest_angle(ax, ay, az, bx, by, bz):
    """Its tangent, of the triangle with these two sides, one after the other; and the area's vector, twice as long."""
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    a, b = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
    c = (ax + bx) * (ax + bx) + (ay + by) * (ay + by) + (az + bz) * (az + bz)
    shortest = min(min(a, b), c)
    tangent = math.sqrt(x * x + y * y + z * z) / (_HALF * (a + b + c) - shortest)
    return (tangent if shortest > _ZERO else _ZERO), x, y, z


@njit(parallel=True, **_OPTIONS)
def choose_diagonals(vertices, quads, tangent_preferred, second):
    """Whether the second diagonal of each quad is better than the first (``geometry.diagonal_split``)."""
    for q in prange(quads.shape[0]):
        a, b, c, d = quads[q, 0], quads[q, 1], quads[q, 2], quads[q, 3]
        ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        bx, by, bz = vertices[b, 0], vertices[b, 1], vertices[b, 2]
        cx, cy, cz = vertices[c, 0], vertices[c, 1], vertices[c, 2]
        dx, dy, dz = vertices[d, 0], vertices[d, 1], vertices[d, 2]
        abc, x0, y0, z0 = _smallest_angle(bx - ax, by - ay, bz - az, cx - bx, cy - by, cz - bz)
        bcd, x1, y1, z1 = _smallest_angle(cx - bx, cy - by, cz - bz, dx - cx, dy - cy, dz - cz)
        cda, x2, y2, z2 = _smallest_angle(dx - cx, dy - cy, dz - cz, ax - dx, ay - dy, az - dz)
        dab, x3, y3, z3 = _smallest_angle(ax - dx, ay - dy, az - dz, bx - ax, by - ay, bz - az)
        first_folds = x0 * x2 + y0 * y2 + z0 * z2 < _ZERO
        second_folds = x1 * x3 + y1 * y3 + z1 * z3 < _ZERO
        # Smallest angles are 60 degrees at most, where tangents grow with them: is tan(other) > tan(one + preferred)?
        one, other = min(abc, cda), min(bcd, dab)
        better = other * (_ONE - one * tangent_preferred) > one + tangent_preferred
        second[q] = better if first_folds == second_folds else first_folds
