"""From the polygons of the dual surface to triangles, and the names of these."""

from typing import Literal

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.geometry.grid import PART_BITS
from sculpt_framework.types import Surface
from sculpt_plugins.extractors.flexicubes.geometry import center_split, diagonal_split

CENTER_PRIMITIVE = 6
"""Face keys: primitive is axis + 3 * diagonal for split diagonal, this + axis for split center."""
TRIANGLE_PRIMITIVE = 9
"""Face keys: primitive is this + axis where only three leaves of an octree meet at the edge; part is the place that is
left out."""
DESCENDING_PART = 4
"""Face keys: part is the triangle's number in its quad, plus this where the upper end of the edge is inside. Such a
face turns the other way round, so it is another face."""


def split_quads(
    vertices: Float[Tensor, "d 3"],
    quads: Int64[Tensor, "q 4"],
    cells: Int64[Tensor, "q 4"],
    axis: Int64[Tensor, " q"],
    keys: Int64[Tensor, " q"],
    gamma: Float[Tensor, "c 1"] | None,
    split: Literal["diagonal", "center"],
) -> Surface:
    """Two triangles, or four round a centre, for each quad.

    ``cells`` are rows of ``gamma``, of the cells at the quad's corners; ``axis`` is that of the edge the quad belongs
    to, and ``keys`` are the keys of these edges' lower corners with ``DESCENDING_PART`` added where it is due.
    """
    if split == "diagonal":
        triangles, second = diagonal_split(vertices, quads)
        primitive = axis + 3 * second.long()
    else:
        quad_gamma = None if gamma is None else gamma[:, 0].index_select(0, cells.reshape(-1)).reshape(-1, 4)
        triangles, centers = center_split(vertices, quads, quad_gamma)
        vertices = torch.cat([vertices, centers])
        primitive = axis + CENTER_PRIMITIVE
    part = torch.arange(triangles.shape[1], device=triangles.device)
    face_keys = (keys + (primitive << PART_BITS))[:, None] + part
    return Surface(vertices=vertices, faces=triangles.reshape(-1, 3), face_keys=face_keys.reshape(-1))
