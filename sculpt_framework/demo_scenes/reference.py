"""A fine mesh of an analytic object, its vertices on the surface to rounding.

Marching tetrahedra on the cells near the surface (found through the Lipschitz bound), then Newton steps along the
gradient. Tetrahedra and not cubes, because their cases need no tables and the result is always a manifold.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int64

from sculpt_framework.demo_scenes.distance import Points, Values
from sculpt_framework.demo_scenes.tracing import BOUND

Vertices = Float[np.ndarray, "v 3"]
Faces = Int64[np.ndarray, "f 3"]

_COARSE = 8  # Fine cells along the side of a coarse one.
# A cube is cut into six tetrahedra around its diagonal, one per order of the axes; the same in each cube, so that
# neighbours agree. Corners are numbered by bits: x is 1, y is 2, z is 4. Orders of odd sign are turned round.
_TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
_CORNERS = np.array([[n & 1, n >> 1 & 1, n >> 2] for n in range(8)])


def reference_mesh(distance: Callable[[Points], Values], cells: int) -> tuple[Vertices, Faces]:
    """Mesh of the zero set inside the unit ball, with ``cells`` cells along the diameter; outward faces.

    Vertices are within 1e-6 of the surface unless it has an edge or a corner there.
    """
    side = 2 * BOUND / cells
    # An offset without meaning to the objects, so that no grid corner lies exactly on a plane of theirs.
    origin = np.full(3, -BOUND) - side * np.array([0.377, 0.519, 0.243])
    cubes = _cubes_near_surface(distance, origin, side, cells + 1)
    stride = np.array([(cells + _COARSE + 2) ** 2, cells + _COARSE + 2, 1])
    corner_ids = (cubes[:, None, :] + _CORNERS) @ stride
    ids, rows = np.unique(corner_ids, return_inverse=True)
    ijk = np.stack([ids // stride[0], ids // stride[1] % stride[1], ids % stride[1]])
    points = origin[:, None] + side * ijk
    values = distance(points)
    # A corner on the surface counts as outside; moved by nothing one could see, so that no edge is cut at its end.
    values = np.where(np.abs(values) < 1e-9 * side, 1e-9 * side, values)
    tetrahedra = rows.reshape(-1, 8)[:, _TETRAHEDRA].reshape(-1, 4)
    edges = _cut(tetrahedra, values < 0)
    pairs, faces = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    a, b = values[pairs[:, 0]], values[pairs[:, 1]]
    vertices = points[:, pairs[:, 0]] + (points[:, pairs[:, 1]] - points[:, pairs[:, 0]]) * (a / (a - b))
    return _project(distance, vertices, 0.5 * side).T.copy(), faces.reshape(-1, 3).astype(np.int64)


def _cubes_near_surface(
    distance: Callable[[Points], Values], origin: Float[np.ndarray, " 3"], side: float, cells: int
) -> Int64[np.ndarray, "c 3"]:
    """Cells that the surface may pass through: at the middle the distance is at most half the diagonal."""
    count = -(-cells // _COARSE)
    cubes = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * _COARSE
    size = _COARSE
    while True:
        middle = origin[:, None] + side * (cubes.T + 0.5 * size)
        cubes = cubes[np.abs(distance(middle)) <= 0.5 * np.sqrt(3) * side * size * 1.001]
        if size == 1:
            return cubes
        size //= 2
        cubes = (cubes[:, None, :] + size * _CORNERS).reshape(-1, 3)


def _cut(tetrahedra: Int64[np.ndarray, "t 4"], inside: np.ndarray) -> Int64[np.ndarray, "f 3 2"]:
    """Triangles of the cut tetrahedra, each vertex given as the (lower, higher) pair of corners whose edge it is on.

    Corners are sorted so that the inside ones come first; an odd permutation turns the tetrahedron inside out.
    """
    within = inside[tetrahedra]
    count = within.sum(axis=1)
    cut = (count > 0) & (count < 4)
    tetrahedra, within, count = tetrahedra[cut], within[cut], count[cut]
    order = np.argsort(~within, axis=1, kind="stable")
    corners = np.take_along_axis(tetrahedra, order, axis=1)
    exchanged = np.stack([order[:, i] > order[:, j] for i in range(4) for j in range(i + 1, 4)])
    odd = exchanged.sum(axis=0) % 2 == 1
    triangles = []
    for amount, pattern in (
        (1, [[(0, 1), (0, 2), (0, 3)]]),
        (2, [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]]),
        (3, [[(3, 0), (3, 1), (3, 2)]]),
    ):
        chosen, flip = corners[count == amount], odd[count == amount]
        for triangle in pattern:
            ends = np.stack([np.stack([chosen[:, a], chosen[:, b]], axis=1) for a, b in triangle], axis=1)
            ends[flip] = ends[flip][:, ::-1]
            triangles.append(ends)
    return np.sort(np.concatenate(triangles), axis=2)


def _project(distance: Callable[[Points], Values], points: Points, limit: float) -> Points:
    """Newton steps onto the surface, none longer than ``limit``."""
    step = 1e-6
    for _ in range(12):
        values = distance(points)
        if np.abs(values).max() < 1e-9:
            break
        offsets = step * np.eye(3)[:, :, None]
        gradient = np.stack([(distance(points + e) - distance(points - e)) / (2 * step) for e in offsets])
        square = np.maximum((gradient * gradient).sum(axis=0), 0.1)
        points = points - np.clip(values, -limit, limit) / square * gradient
    return points
