"""The surface in tetrahedra whose corners are inside or outside (marching tetrahedra, Doi and Koide 1991)."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float64, Int64

RIGHT_HANDED = (0, 1, 2, 4)
"""Corners of a unit cube, by their bits along x, y and z, that make a tetrahedron whose edges from the first corner are
right-handed."""

Edge = tuple[int, int]


def _position(edge: Edge) -> np.ndarray:
    """Middle of an edge given by its two cell corners."""
    return np.mean([[n & 1, n >> 1 & 1, n >> 2] for n in edge], axis=0)


def triangles_of(tetrahedron: tuple[int, ...], case: int) -> list[tuple[Edge, ...]]:
    """Outward triangles of a tetrahedron whose corner m is inside where bit m of ``case`` is set.

    Each triangle corner is the cell edge, as a pair of cell corners in ascending order, that it lies on.
    """
    inner = [corner for m, corner in enumerate(tetrahedron) if case >> m & 1]
    outer = [corner for m, corner in enumerate(tetrahedron) if not case >> m & 1]
    if not inner or not outer:
        return []
    if len(inner) == 2:
        (i, j), (k, m) = inner, outer
        ring = [(i, k), (i, m), (j, m), (j, k)]
    else:
        ring = [(i, k) for i in inner for k in outer]
    first, second, third = (_position(edge) for edge in ring[:3])
    outward = np.mean([_position((n, n)) for n in outer], axis=0) - np.mean([_position((n, n)) for n in inner], axis=0)
    if np.dot(np.cross(second - first, third - first), outward) < 0:
        ring = ring[::-1]
    ring = [(min(edge), max(edge)) for edge in ring]
    return [(ring[0], ring[n], ring[n + 1]) for n in range(1, len(ring) - 1)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Crossings:
    """A vertex on each edge between an inner and an outer corner, and the triangles between these."""

    ends: Int64[np.ndarray, "v 2"]
    """Corners at the inner and the outer end of the edge that each vertex lies on."""
    faces: Int64[np.ndarray, "f 3"]
    """Outward."""


def march_tetrahedra(
    corners: Float64[np.ndarray, "p 3"], tetrahedra: Int64[np.ndarray, "t 4"], inside: Bool[np.ndarray, " p"]
) -> Crossings:
    """Of tetrahedra that share whole faces, in any order of their corners. Where no corner of the outermost faces is
    inside the surface is closed, and each of its edges has two triangles."""
    found = inside[tetrahedra]
    cut = tetrahedra[found.any(axis=1) & ~found.all(axis=1)]
    edges = corners[cut[:, 1:]] - corners[cut[:, :1]]
    left = np.linalg.det(edges) < 0
    cut = np.where(left[:, None], cut[:, [0, 1, 3, 2]], cut)
    cases = (inside[cut] << np.arange(4)).sum(axis=1)
    count, table = _cases()
    owner = np.repeat(np.arange(len(cut)), count[cases])
    which = np.arange(len(owner)) - (np.cumsum(count[cases]) - count[cases])[owner]
    ends = np.take_along_axis(cut[owner], table[cases[owner], which].reshape(-1, 6), axis=1).reshape(-1, 2)
    names, vertex = np.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True)
    return Crossings(
        ends=np.stack([names >> 32, names & 0xFFFFFFFF], axis=1), faces=vertex.reshape(-1, 3).astype(np.int64)
    )


@cache
def _cases() -> tuple[Int64[np.ndarray, "16"], Int64[np.ndarray, "16 2 3 2"]]:
    """(triangles, and for each of their corners the inner and the outer end) by the inside corners as bits."""
    count, table = np.zeros(16, np.int64), np.zeros((16, 2, 3, 2), np.int64)
    for case in range(16):
        triangles = triangles_of(RIGHT_HANDED, case)
        count[case] = len(triangles)
        for number, triangle in enumerate(triangles):
            ends = [(RIGHT_HANDED.index(low), RIGHT_HANDED.index(high)) for low, high in triangle]
            table[case, number] = [(low, high) if case >> low & 1 else (high, low) for low, high in ends]
    return count, table
