"""Bending between faces, by Geman and McClure's measure: what yields to evidence, and to creases."""

import math

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.geometry.topology import directed_edges, edge_names
from sculpt_framework.losses import GeometryLoss

_LEAST_AREA = 0.02
"""Area, in squares of a cell, of faces that count half: the normal of a smaller one turns by any movement."""


class Bending(GeometryLoss):
    """Mean over the edges of d / (d + c): d is the square of the distance between the unit normals beside an edge, and
    c that of normals ``crease`` degrees apart.

    It pulls most at angles of a good half of a crease and lets go of larger ones. Edges beside a face without area
    cost nothing.
    """

    def __init__(self, crease: float):
        self._crease = (2 * math.sin(math.radians(crease) / 2)) ** 2

    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]:
        vertices, faces = extraction.surface.vertices, extraction.surface.faces
        beside = _beside(faces)
        if len(beside) == 0:
            return vertices.new_zeros(())
        # Not vertices[...]: the gradient of that is added up by threads in any order, and runs would not repeat.
        a, b, c = (vertices.index_select(0, corner) for corner in faces.unbind(dim=1))
        crossed = torch.linalg.cross(b - a, c - a)
        with torch.no_grad():
            area = 0.5 * crossed.norm(dim=1) / extraction.grid.cell**2
            counts = area / (area + _LEAST_AREA)
        # Where there is no area, any direction will do: it counts nothing, and has a gradient.
        safe = torch.where((counts > 0)[:, None], crossed, crossed.new_tensor([0.0, 0.0, 1.0]))
        normals = safe / safe.norm(dim=1, keepdim=True)
        first, second = beside.T
        apart = (normals.index_select(0, first) - normals.index_select(0, second)).square().sum(dim=1)
        return (torch.minimum(counts[first], counts[second]) * apart / (apart + self._crease)).mean()


def _beside(faces: Int64[Tensor, "f 3"]) -> Int64[Tensor, "e 2"]:
    """The two faces beside each edge; an edge with one face is left out."""
    names = edge_names(directed_edges(faces))
    order = np.argsort(names, kind="stable")
    same = np.flatnonzero(names[order][1:] == names[order][:-1])
    return torch.from_numpy(np.stack([order[same], order[same + 1]], axis=1) // 3).to(faces.device)
