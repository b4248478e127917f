"""The tables of marching tetrahedra, derived from the cube.

A cell is split into the six tetrahedra (Kuhn) that follow a path of cell edges from corner 0 to corner 7, one axis
after the other. All cells share the direction of their diagonals, so the split is conforming: neighbours cut their
common face alike. Every edge of a tetrahedron goes up along one, two or three axes: it is named by its lower corner and
by the corner number, 1 to 7, of its direction.
"""

from dataclasses import dataclass
from functools import cache
from itertools import permutations

import torch
from jaxtyping import Int64
from torch import Tensor

from sculpt_framework.geometry.tetrahedra import Edge, triangles_of

TETRAHEDRA = tuple((0, 1 << a, 1 << a | 1 << b, 7) for a, b, _ in permutations(range(3)))
CODES_PER_TETRAHEDRON = 20
"""8 cases of one triangle, 6 of two: with six tetrahedra 120 names, which fit the 7 low bits of a key."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TetrahedraTables:
    """The triangles of all 256 cases of a cell, one after the other."""

    first: Int64[Tensor, "256"]
    """Row of the first triangle of each case."""
    count: Int64[Tensor, "256"]
    code: Int64[Tensor, " t"]
    """Name of the triangle within its cell, 0 to 119: tetrahedron, signs of its corners, first or second triangle."""
    edge_corner: Int64[Tensor, "t 3"]
    """Lower corner of the edge each triangle corner lies on."""
    edge_direction: Int64[Tensor, "t 3"]


@cache
def tetrahedra_tables(device: torch.device) -> TetrahedraTables:
    rows: list[tuple[int, tuple[Edge, ...]]] = []
    counts = []
    cut = [[triangles_of(tetrahedron, case) for case in range(16)] for tetrahedron in TETRAHEDRA]
    for cell_case in range(256):
        before = len(rows)
        for number, tetrahedron in enumerate(TETRAHEDRA):
            case = sum(1 << m for m, corner in enumerate(tetrahedron) if cell_case >> corner & 1)
            code = number * CODES_PER_TETRAHEDRON + sum(len(cut[number][n]) for n in range(case))
            rows += [(code + n, triangle) for n, triangle in enumerate(cut[number][case])]
        counts.append(len(rows) - before)
    count = torch.tensor(counts)
    edges = torch.tensor([triangle for _, triangle in rows])
    return TetrahedraTables(
        first=(count.cumsum(0) - count).to(device),
        count=count.to(device),
        code=torch.tensor([code for code, _ in rows], device=device),
        edge_corner=edges[..., 0].to(device),
        edge_direction=(edges[..., 1] - edges[..., 0]).to(device),
    )
