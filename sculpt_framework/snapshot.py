"""What a run looks like now, as "snapshot" events carry it: cheap to take, for others to work out."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from sculpt_framework.geometry.grid import Grid
from sculpt_framework.types import Box, Gaussians, Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """The cells of a grid that the surface passes through."""

    grid: Grid
    keys: Int64[Tensor, " c"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """A surface in the object frame of ``box``, on the device of the run, coloured by the Gaussians on it or, where a
    method has none, at its vertices. Read-only."""

    surface: Surface
    box: Box
    gaussians: Gaussians | None = None
    colors: Float[Tensor, "v 3"] | None = None
    """sRGB in [0, 1]; for surfaces without Gaussians."""
    cells: Cells | None = None

    @property
    def vertex_colors(self) -> Float[Tensor, "v 3"]:
        """Of a surface without Gaussians; ValueError of one with them."""
        if self.colors is None:
            raise ValueError("a surface with Gaussians has its colours from them")
        return self.colors

    @staticmethod
    def of_mesh(
        vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"], colors: Float[Tensor, "v 3"]
    ) -> "Snapshot":
        """Of a mesh in world frame. Faces are named by their numbers."""
        points = torch.from_numpy(vertices)
        box = Box(minimum=points.amin(dim=0), maximum=points.amax(dim=0))
        surface = Surface(
            vertices=box.to_object(points).float(),
            faces=torch.from_numpy(faces),
            face_keys=torch.arange(len(faces)),
        )
        return Snapshot(surface=surface, box=box, colors=colors)
