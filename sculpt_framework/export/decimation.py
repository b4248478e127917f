"""Fewer faces, still closed."""

import igl
import numpy as np
from jaxtyping import Float64, Int64

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.geometry import topology

LEAST_FACES = 4
"""Faces of a tetrahedron."""


def decimate(
    vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"], target: int
) -> tuple[Float64[np.ndarray, "w 3"], Int64[np.ndarray, "g 3"]]:
    """A mesh of at most ``target`` faces, closed and manifold as the one given is.

    Edges collapse in the order of the quadric error (Garland and Heckbert 1997), only where the mesh stays a manifold;
    a mesh that is small enough comes back as it is. Raises ConfigError for a target no closed mesh has, DataError where
    the mesh is not closed, or cannot become so small without losing a hole or a piece.
    """
    if target < LEAST_FACES:
        raise ConfigError(f"--target-faces is {target}; expected {LEAST_FACES} or more.")
    if len(faces) <= target:
        return vertices, faces
    if not _is_closed(faces):
        raise DataError("the mesh is not closed, so it cannot be made smaller and stay so; leave --target-faces out.")
    # In units of the mesh itself: quadrics are of the fourth power of lengths, and rounding follows them.
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    scale = float(np.abs(vertices - middle).max()) or 1.0
    points, triangles, _, _ = igl.qslim(
        np.asfortranarray((vertices - middle) / scale), np.asfortranarray(faces.astype(np.int32)), target
    )
    points = np.ascontiguousarray(points) * scale + middle
    triangles = np.ascontiguousarray(triangles).astype(np.int64)
    if len(triangles) > target:
        raise DataError(
            f"the mesh keeps its shape down to {len(triangles)} faces; give --target-faces {len(triangles)}."
        )
    if not _is_closed(triangles):
        raise DataError(f"at {target} faces the mesh would no longer be closed; give a larger --target-faces.")
    return points, triangles


def carry_over(
    values: Float64[np.ndarray, "v c"],
    old: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    new: Float64[np.ndarray, "w 3"],
) -> Float64[np.ndarray, "w c"]:
    """Values of vertices at points near the surface: those of the nearest point on it, interpolated over its face."""
    _, face, nearest = igl.point_mesh_squared_distance(new, old, faces.astype(np.int32))
    corners = old[faces[np.asarray(face).astype(np.int64)]]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    away = np.asarray(nearest) - corners[:, 0]
    # Least squares, which a face without area only makes arbitrary between equal corners.
    aa, ab, bb = (a * a).sum(1), (a * b).sum(1), (b * b).sum(1)
    determinant = np.maximum(aa * bb - ab * ab, 1e-300)
    u = (bb * (a * away).sum(1) - ab * (b * away).sum(1)) / determinant
    v = (aa * (b * away).sum(1) - ab * (a * away).sum(1)) / determinant
    weights = np.stack([1 - u - v, u, v], axis=1).clip(0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("nk,nkc->nc", weights, values[faces[np.asarray(face).astype(np.int64)]])


def _is_closed(faces: Int64[np.ndarray, "f 3"]) -> bool:
    closed = len(topology.boundary_edges(faces)) == 0 and topology.is_edge_manifold(faces)
    return closed and topology.is_vertex_manifold(faces) and topology.is_consistently_oriented(faces)
