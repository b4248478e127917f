"""The far side: what no view shows, closed smoothly where the hull has a cone."""

import logging

import igl
import numpy as np
from jaxtyping import Bool, Float, Float32, Int64
from scipy import ndimage, sparse

from sculpt_framework.shape_from_images.fusion import signed_distance
from sculpt_framework.shape_from_images.volume import Volume

_FACING = 0.1
"""Cosine to the line of sight from which on a view sees a surface: below, it sees an edge."""
_BLUR = 20
"""Rounds of averaging over neighbours that make patches of what single vertices say."""
_RINGS = 3
"""Vertices around a patch, ring by ring, that stay where they are: with two of them tangents go on across its edge."""
_SOUND = 0.05
"""Cells that a centre is away from the surface at least when triangles are made: none of them is a needle."""
_MOST = 0.25
"""Share of the surface above which the rest says too little about the unseen: one to three views leave half of it."""
_WORTH = 0.5
"""Cells that something has to move for it to be worth doing."""


def close_unseen(solid: Volume, positions: Float32[np.ndarray, "v 3"]) -> Volume:
    """The shape with the parts of its surface that face away from all ``positions`` drawn in to where they bend least.

    ``solid`` is a signed distance, negative inside, and the positions those of the cameras, both in the object frame.
    The lines of sight that touch an object's outline go on behind it and meet in a cone. There each patch of the
    surface that no camera can see becomes the membrane of least bending (bi-Laplacian, Botsch and Kobbelt 2004) that
    leaves the surface around it in the direction that that has. Nothing is added, as the silhouettes bound the object,
    and nothing is cut off that lies nearer to what is seen. Parts that only others hide are left as they are. Returns
    ``solid`` itself if less than half a cell would change, or if more than a quarter of the surface is not seen.
    """
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
    # Only what is nearer to the patch, so that it is not drawn through what is seen.
    to_unseen, to_seen = (_distance_to(vertices[part], solid, window) for part in (unseen, ~unseen))
    near = (values[window] < 0) & (to_unseen < to_seen) & (to_unseen < reach + 2 * solid.cell)
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
    """Vertices, those that are free where the surface bends least. Solves for these and some rings around only."""
    part = free
    for _ in range(_RINGS):
        part = part | (adjacency @ part.astype(np.float64) > 0)
    own, numbers = np.unique(faces[part[faces].all(axis=1)], return_inverse=True)
    held = np.flatnonzero(~free[own])
    moved = vertices.copy()
    moved[own] = igl.harmonic(vertices[own], numbers.reshape(-1, 3), held, vertices[own][held], 2)
    return moved


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
