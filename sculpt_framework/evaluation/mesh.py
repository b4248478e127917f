"""A triangle mesh to be measured: plain arrays, whoever made it."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from sculpt_framework.errors import DataError


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Vertices in the units of the scene, and the corners of each triangle as rows of ``vertices``.

    Raises ValueError where a coordinate is not finite or a face names a vertex that is not there.
    """

    vertices: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]

    def __post_init__(self) -> None:
        if not np.isfinite(self.vertices).all():
            raise ValueError(f"{int((~np.isfinite(self.vertices)).any(1).sum())} vertices are not finite")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise ValueError(f"faces name vertices outside 0..{len(self.vertices) - 1}")

    @property
    def corners(self) -> Float64[np.ndarray, "f 3 3"]:
        """Positions of each face's three vertices."""
        return self.vertices[self.faces]

    @cached_property
    def area_vectors(self) -> Float64[np.ndarray, "f 3"]:
        """Half the cross product of two edges: along the outward normal, as long as the face's area."""
        corners = self.corners
        return 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    @cached_property
    def areas(self) -> Float64[np.ndarray, " f"]:
        return np.linalg.norm(self.area_vectors, axis=1)

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal over the vertices that faces use; 0 without faces."""
        if len(self.faces) == 0:
            return 0.0
        named = np.zeros(len(self.vertices), bool)
        named[self.faces] = True
        used = self.vertices[named]
        return float(np.linalg.norm(used.max(0) - used.min(0)))


def load_mesh(path: Path) -> Mesh:
    """Read any triangle mesh file trimesh knows (PLY, OBJ, GLB, STL, OFF), exactly as it is: nothing is merged.

    A scene of several meshes is joined into one. Raises DataError where there is no such file or no mesh in it.
    """
    import trimesh

    if not path.is_file():
        raise DataError(f"no mesh file at {path}; give the path of a PLY, OBJ, GLB, STL or OFF file")
    try:
        loaded = trimesh.load_scene(path, process=False).to_mesh()
        vertices = np.ascontiguousarray(loaded.vertices, dtype=np.float64)
        faces = np.ascontiguousarray(loaded.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # trimesh's readers raise whatever their parsing stumbles over.
        raise DataError(f"{path} cannot be read as a triangle mesh ({error or type(error).__name__})") from error
    if len(faces) == 0:
        raise DataError(f"{path} holds no triangles; a surface mesh is expected, not a point cloud")
    try:
        return Mesh(vertices=vertices, faces=faces)
    except ValueError as error:
        raise DataError(f"{path} is not a valid mesh: {error}") from error
