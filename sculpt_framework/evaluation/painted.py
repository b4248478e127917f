"""A mesh with colours: what every method makes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int64

from sculpt_framework.evaluation.mesh import Mesh

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, kw_only=True, eq=False)
class PaintedMesh:
    """World frame."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    colors: Float[np.ndarray, "v 3"]
    """sRGB in [0, 1]."""

    @property
    def mesh(self) -> Mesh:
        return Mesh(vertices=self.vertices.astype(np.float64), faces=self.faces)

    def to_trimesh(self) -> "trimesh.Trimesh":
        """With vertex colours, and nothing merged."""
        import trimesh

        colors = np.rint(self.colors.clip(0, 1) * 255).astype(np.uint8)
        return trimesh.Trimesh(self.vertices, self.faces, vertex_colors=colors, process=False)
