"""The tables of dual marching cubes, derived from the cube.

A patch is a closed loop of crossed cell edges, joined across the faces of the cell; each patch has one dual vertex. A
face with two crossed edges joins them. A face with four (diagonal corners alike) is ambiguous; by default it joins the
two edges at each of its *inside* corners, a rule that both cells at the face agree on.

Two facts make the mesh manifold (Wenger, Isosurfaces, 2013, shows them for his tables; the tests check them for ours).
The mesh edge across a face segment joins the two dual vertices whose loops pass it. It is shared by more than two
quads only if both segments of an ambiguous face lie on one loop in *both* its cells. That happens only in a cell whose
outside corners are two diagonal ones of the face, or three of which two share an edge; such a cell has no other
ambiguous face, so the pair can be resolved on its own: both use the *inverted* table, which joins the edges at outside
corners and so puts the segments on two loops.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Int64
from torch import Tensor

from sculpt_framework.geometry.band import FACE_CORNERS

AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""Each axis with the two that follow it: right-handed."""


def _corner_pairs() -> tuple[tuple[int, int], ...]:
    """Lower and upper corner of each edge: edge 4a + p + 2q runs along axis a, at p and q on the next two axes."""
    lower = [(p << b | q << c, 1 << a) for a, b, c in AXES for q in (0, 1) for p in (0, 1)]
    return tuple((corner, corner | step) for corner, step in lower)


EDGES = _corner_pairs()


def segments(case: int, face: int, inverted: bool) -> Iterator[list[int]]:
    """Pairs of crossed edges that the surface joins on a face of a cell."""
    crossed = [
        edge
        for edge, (lower, upper) in enumerate(EDGES)
        if FACE_CORNERS[face] >> lower & FACE_CORNERS[face] >> upper & (case >> lower ^ case >> upper) & 1
    ]
    if len(crossed) == 2:
        yield crossed
    elif len(crossed) == 4:
        for corner in range(8):
            if FACE_CORNERS[face] >> corner & 1 and (case >> corner & 1) != inverted:
                yield [edge for edge in crossed if corner in EDGES[edge]]


def patches(case: int, inverted: bool) -> list[int]:
    """Number of the patch each of the 12 edges belongs to, counted from 0; -1 for edges that are not crossed."""
    patch = [edge if (case >> lower ^ case >> upper) & 1 else -1 for edge, (lower, upper) in enumerate(EDGES)]
    for face in range(6):
        for first, second in segments(case, face, inverted):
            joined = patch[second]
            patch = [patch[first] if p == joined else p for p in patch]
    names = sorted({p for p in patch if p >= 0})
    return [names.index(p) if p >= 0 else -1 for p in patch]


def troubled_face(case: int) -> int:
    """The ambiguous face both of whose segments lie on one loop, -1 if there is none."""
    patch = patches(case, inverted=False)
    for face in range(6):
        pairs = list(segments(case, face, inverted=False))
        if len(pairs) == 2 and patch[pairs[0][0]] == patch[pairs[1][0]]:
            return face
    return -1


@dataclass(frozen=True, kw_only=True, eq=False)
class DualTables:
    """First index: 0 default, 1 inverted; second: case of the cell."""

    patch: Int64[Tensor, "2 256 12"]
    """Patch of each edge, -1 where it is not crossed."""
    patch_count: Int64[Tensor, "2 256"]
    troubled_face: Int64[Tensor, "256"]


@cache
def dual_tables(device: torch.device) -> DualTables:
    patch = torch.tensor([[patches(case, inverted) for case in range(256)] for inverted in (False, True)])
    return DualTables(
        patch=patch.to(device),
        patch_count=(patch.max(dim=2).values + 1).to(device),
        troubled_face=torch.tensor([troubled_face(case) for case in range(256)], device=device),
    )
