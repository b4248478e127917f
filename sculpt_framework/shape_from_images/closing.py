"""The far side: what no view shows, closed by a membrane where the hull has a cone, by planes where it has no end."""

import logging
from collections.abc import Sequence

import igl
import numpy as np
from jaxtyping import Bool, Float, Float32, Int64
from scipy import ndimage, sparse

from sculpt_framework.shape_from_images.enclosing import enclosed, reaches_walls
from sculpt_framework.shape_from_images.volume import Volume, signed_distance
from sculpt_framework.shape_from_images.windows import camera_arrays
from sculpt_framework.types import Camera

_FACING = 0.1
"""Cosine to the line of sight from which on a view sees a surface: below, it sees an edge."""
_BLUR = 20
"""Rounds of averaging over neighbours that make patches of what single vertices say."""
_RINGS = 3
"""Vertices around a patch, ring by ring, that stay where they are: with two of them tangents go on across its edge."""
_SIDES = (3, 7)
"""Rings from the edge of a patch, the first and the last, whose normals tell whether there is a crease. Nearer ones are
rounded off by the cells."""
_SPREAD = 10
"""Rounds of averaging over neighbours that bring these normals to the edge."""
_CREASE = (15.0, 30.0)
"""Degrees between the normals on both sides of an edge: up to the first the surface goes on as it is, from the second
on it ends there."""
_THIN = 1.5
"""Cells that are left below what is seen, at least."""
_SOUND = 0.05
"""Cells that a centre is away from the surface at least when triangles are made: none of them is a needle."""
_FEWEST = 5
"""Views: fewer leave too much to guess at."""
_MOST = 0.6
"""Share of the surface above which the rest says too little about the unseen; of a plate it is about half."""
_WORTH = 0.5
"""Cells that something has to move for it to be worth doing."""


def close_unseen(solid: Volume, cameras: Sequence[Camera]) -> Volume:
    """The shape with what no camera can see closed: ``close_cones``, or ``enclosed`` where it reaches the walls of its
    volume and so has no cone. Returns ``solid`` itself if there are fewer than five views."""
    if len(cameras) < _FEWEST:
        return solid
    return enclosed(solid, cameras) if reaches_walls(solid) else close_cones(solid, cameras)


def close_cones(solid: Volume, cameras: Sequence[Camera]) -> Volume:
    """The shape with the parts of its surface that face away from all cameras drawn in to where they bend least.

    ``solid`` is a signed distance, negative inside, in the frame of the cameras. The lines of sight that touch an
    object's outline go on behind it and meet in a cone. There each patch of the surface that no camera can see becomes
    a membrane of least bending (bi-Laplacian, Botsch and Kobbelt 2004). On a round object the cone touches the surface,
    and the membrane leaves it in the direction that it has. A cone that starts at a crease starts at an edge of the
    object: there the direction is free, and where it is all around the membrane is a soap film, flat under a flat rim.
    Nothing is added, as the silhouettes bound the object, and of what lies nearer to what is seen than to the cone a
    cell and a half are left. Parts that only others hide stay as they are.

    Returns ``solid`` itself if less than half a cell would change, if it reaches the walls of its volume, if there are
    fewer than five views, or if more than three fifths of the surface are not seen.
    """
    if len(cameras) < _FEWEST or reaches_walls(solid):
        return solid
    _, _, positions = camera_arrays(cameras)
    vertices, faces = _triangles(solid)
    if not len(faces):
        return solid
    adjacency = igl.adjacency_matrix(faces)
    unseen = _unseen(vertices, faces, adjacency, positions)
    if not 0 < unseen.sum() <= _MOST * len(unseen):
        return solid
    closed = _least_bending(vertices, faces, adjacency, unseen)
    if not np.isfinite(closed).all():
        # Triangles are sound, but the library's factorisation may still fail.
        logging.getLogger("sculpt").warning("the far side cannot be rounded off; it stays what the outlines leave")
        return solid
    reach = float(np.linalg.norm(closed - vertices, axis=1).max())
    if reach < _WORTH * solid.cell:
        return solid
    values = solid.values.copy()
    window = _window(vertices[unseen], 2 * (reach + 2 * solid.cell), solid)
    # The membrane is not drawn through what is seen.
    to_unseen, to_seen = (_distance_to(vertices[part], solid, window) for part in (unseen, ~unseen))
    behind = (to_unseen < to_seen) | (to_seen > _THIN * solid.cell)
    near = (values[window] < 0) & behind & (to_unseen < reach + 2 * solid.cell)
    centers = solid.points.reshape(*solid.shape, 3)[window][near].astype(np.float64)
    kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    distances = np.asarray(igl.signed_distance(centers, closed, faces, sign_type=kind)[0])
    values[window][near] = np.maximum(values[window][near], distances.astype(np.float32))
    return solid.holding(signed_distance(values < 0, values, solid.cell))


def _triangles(solid: Volume) -> tuple[Float[np.ndarray, "n 3"], Int64[np.ndarray, "f 3"]]:
    """The surface in the object frame, closed along the outermost cells; faces counterclockwise seen from outside."""
    values = np.full(solid.shape, 0.5 * solid.cell)
    values[1:-1, 1:-1, 1:-1] = solid.values[1:-1, 1:-1, 1:-1]
    values = np.where(values < 0, np.minimum(values, -_SOUND * solid.cell), np.maximum(values, _SOUND * solid.cell))
    # The library counts x fastest.
    centers = solid.points.reshape(*solid.shape, 3).transpose(2, 1, 0, 3).reshape(-1, 3).astype(np.float64)
    vertices, faces, _ = igl.marching_cubes(values.ravel(order="F"), centers, *solid.shape, 0.0)
    return np.asarray(vertices), np.asarray(faces, dtype=np.int64)


def _unseen(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int64[np.ndarray, "f 3"],
    adjacency: sparse.csc_matrix,
    positions: Float32[np.ndarray, "v 3"],
) -> Bool[np.ndarray, " n"]:
    """Whether a vertex lies in a patch of the surface that faces away from all positions."""
    normals = np.asarray(igl.per_vertex_normals(vertices, faces))
    best = np.full(len(vertices), -1.0)
    for position in positions.astype(np.float64):
        sight = position - vertices
        best = np.maximum(best, np.einsum("ij,ij->i", sight, normals) / np.linalg.norm(sight, axis=1))
    neighbours = np.maximum(np.asarray(adjacency.sum(axis=1)).reshape(-1), 1)
    share = (best < _FACING).astype(np.float64)
    for _ in range(_BLUR):
        share = 0.5 * (share + (adjacency @ share) / neighbours)
    unseen = share > 0.5
    # A piece without an edge to be held at is left alone.
    count, piece = sparse.csgraph.connected_components(adjacency, directed=False)
    return unseen & (np.bincount(piece, ~unseen, minlength=count) > 0)[piece]


def _least_bending(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int64[np.ndarray, "f 3"],
    adjacency: sparse.csc_matrix,
    free: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """Vertices, those that are free where the surface bends least. Solves for these and some rings around only.

    Minimises the squared Laplacian over the free vertices and, as far as the surface goes on into the patch without a
    crease, over those at its edge, which is what ties the direction in which the patch begins.
    """
    part = _ring_numbers(adjacency, free, _RINGS) <= _RINGS
    own, numbers = np.unique(faces[part[faces].all(axis=1)], return_inverse=True)
    corners, triangles = vertices[own], numbers.reshape(-1, 3)
    laplacian, mass = igl.cotmatrix(corners, triangles), igl.massmatrix(corners, triangles).diagonal()
    counted = np.where(free, 1.0, _going_on(vertices, faces, adjacency, free))[own]
    energy = sparse.csc_matrix(laplacian.T @ sparse.diags(counted / mass) @ laplacian)
    held = np.flatnonzero(~free[own])
    moved = vertices.copy()
    moved[own] = igl.min_quad_with_fixed(energy, np.zeros(corners.shape), held, corners[held])
    return moved


def _going_on(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int64[np.ndarray, "f 3"],
    adjacency: sparse.csc_matrix,
    free: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """From 0, where the surface has a crease between the free part and the rest, to 1; 0 far from the edge between."""
    normals = np.nan_to_num(igl.per_vertex_normals(vertices, faces))
    counts = np.maximum(np.asarray(adjacency.sum(axis=1)), 1)
    first, last = _SIDES
    sides = []
    for part in (free, ~free):
        ring = _ring_numbers(adjacency, ~part, last)
        direction = np.where((part & (ring >= first) & (ring <= last))[:, None], normals, 0.0)
        for _ in range(_SPREAD):
            direction = 0.5 * (direction + (adjacency @ direction) / counts)
        sides.append(direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12))
    angle = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", *sides), -1, 1)))
    smooth, creased = _CREASE
    return np.clip((creased - angle) / (creased - smooth), 0, 1)


def _ring_numbers(adjacency: sparse.csc_matrix, start: Bool[np.ndarray, " n"], last: int) -> Int64[np.ndarray, " n"]:
    """Edges from a vertex to the nearest of the start, ``last + 1`` for those that are further away."""
    ring = np.where(start, 0, last + 1)
    for number in range(1, last + 1):
        touched = adjacency @ (ring < number).astype(np.float64) > 0
        ring = np.where(touched, np.minimum(ring, number), ring)
    return ring


def _cells_of(points: Float[np.ndarray, "n 3"], solid: Volume) -> Int64[np.ndarray, "n 3"]:
    cells = np.floor((points - np.array(solid.origin)) / solid.cell).astype(np.int64)
    return np.clip(cells, 0, np.array(solid.shape) - 1)


def _window(points: Float[np.ndarray, "n 3"], margin: float, solid: Volume) -> tuple[slice, slice, slice]:
    """The cells around all points."""
    cells, more = _cells_of(points, solid), int(np.ceil(margin / solid.cell))
    x, y, z = (slice(max(0, int(axis.min()) - more), int(axis.max()) + more + 1) for axis in cells.T)
    return x, y, z


def _distance_to(
    points: Float[np.ndarray, "n 3"], solid: Volume, window: tuple[slice, slice, slice]
) -> Float[np.ndarray, "x y z"]:
    """From each cell of the window to the nearest there that holds a point, in object units."""
    away = np.ones(solid.shape, bool)
    away[tuple(_cells_of(points, solid).T)] = False
    return np.asarray(ndimage.distance_transform_edt(away[window])) * solid.cell
