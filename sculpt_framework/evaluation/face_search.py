"""Which triangle of a mesh is nearest to a point, and which one a ray meets."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import igl
import numpy as np
from jaxtyping import Float64, Int64

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.evaluation.mesh import Mesh

with kernel_cache("face-grid", Path(__file__).with_name("face_grid_kernels.py")):
    from sculpt_framework.evaluation import face_grid_kernels

_RINGS = 6
"""Shells of cells round a point that are looked at at first."""
_FEW = 0.02
"""Points that are further away, per triangle, up to which all shells are looked at and no tree is built: building one
takes about 2 microseconds a triangle, all shells 100 and more a point."""
_CELLS_PER_FACE, _FACES_PER_CELL = 16, 100
"""Cells that triangles may lie in on the average, and triangles beside one in its cell: more, and they are not of
one size, or far apart."""
_MOST_CELLS = 1 << 22


class FaceSearch:
    """Answers by a tree of boxes (libigl), or, where that is sooner, by a grid: a tree of 230 000 triangles takes 0.4 s
    to build, which is four times what asking it costs. Both are built when they are first needed."""

    def __init__(self, mesh: Mesh):
        """Every face must have an area."""
        self._mesh = mesh

    def squared_distances(
        self, points: Float64[np.ndarray, "n 3"]
    ) -> tuple[Float64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
        """Exact squared distance of each point to the surface, and the nearest face."""
        if self._grid is None:
            return self._by_tree(points)
        squared, face = self._grid.nearest(points, _RINGS)
        far = np.flatnonzero(face < 0)
        if len(far) > _FEW * len(self._mesh.faces):
            squared[far], face[far] = self._by_tree(points[far])
        elif len(far) > 0:
            squared[far], face[far] = self._grid.nearest(points[far], int(self._grid.shape.max()))
        return squared, face

    def first_hits(
        self, origins: Float64[np.ndarray, "n 3"], ways: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, " n"]:
        """Where each ray first meets the surface, in lengths of its ``ways``; infinite where it never does."""
        if len(origins) == 0:
            return np.zeros(0)
        vertices, faces = self._mesh.vertices, self._mesh.faces
        face, place, _ = self._tree.intersect_ray_first(vertices, faces, np.ascontiguousarray(origins), ways)
        return np.where(np.asarray(face) >= 0, np.asarray(place), np.inf)

    def _by_tree(self, points: Float64[np.ndarray, "n 3"]) -> tuple[Float64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
        squared, face, _ = self._tree.squared_distance(self._mesh.vertices, self._mesh.faces, points)
        return np.asarray(squared), np.asarray(face).astype(np.int64)

    @cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(self._mesh.vertices, self._mesh.faces)
        return tree

    @cached_property
    def _grid(self) -> "FaceGrid | None":
        return face_grid(self._mesh)


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceGrid:
    """The triangles that meet each cell of a grid."""

    vertices: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    origin: Float64[np.ndarray, " 3"]
    side: float
    shape: Int64[np.ndarray, " 3"]
    starts: Int64[np.ndarray, " c"]
    """Where the entries of each cell begin, and the end."""
    entries: Int64[np.ndarray, " e"]

    def nearest(
        self, points: Float64[np.ndarray, "n 3"], rings: int
    ) -> tuple[Float64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
        """Squared distance and face; where the face is -1 the surface is not within so many shells of cells."""
        squared, face = np.empty(len(points)), np.empty(len(points), np.int64)
        share_threads()
        face_grid_kernels.find_nearest(
            np.ascontiguousarray(points), self.vertices, self.faces, self.origin, self.side, self.shape,
            self.starts, self.entries, rings, squared, face,
        )  # fmt: skip
        return squared, face


def face_grid(mesh: Mesh) -> FaceGrid | None:
    """Cells about two edges wide. None where triangles are so unlike that some would lie in too many of them, or too
    many in some of them."""
    used = mesh.vertices[mesh.faces].reshape(-1, 3)
    low, high = used.min(axis=0), used.max(axis=0)
    side = 2.0 * float(np.sqrt(2.0 * np.median(mesh.areas)))
    extent = high - low
    side = max(side, float(np.cbrt(np.prod(np.maximum(extent, side)) / _MOST_CELLS)))
    shape = (extent / side).astype(np.int64) + 1
    first, second, third = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    spans = np.maximum(np.maximum(first, second), third) - np.minimum(np.minimum(first, second), third)
    if np.prod(spans / side + 1.0, axis=1).mean() > _CELLS_PER_FACE:
        return None
    vertices, faces = np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces)
    starts = np.zeros(int(np.prod(shape)) + 1, np.int64)
    face_grid_kernels.list_faces(vertices, faces, low, side, shape, starts[1:], np.zeros(0, np.int64))
    counts = starts[1:].astype(np.float64)
    if (counts**2).sum() > _FACES_PER_CELL * counts.sum():
        return None
    np.cumsum(starts, out=starts)
    entries = np.empty(int(starts[-1]), np.int64)
    face_grid_kernels.list_faces(vertices, faces, low, side, shape, starts[:-1].copy(), entries)
    return FaceGrid(vertices=vertices, faces=faces, origin=low, side=side, shape=shape, starts=starts, entries=entries)
