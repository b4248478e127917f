"""Cycles on the boundary of a leaf that smaller leaves touch: what ``tables`` lists for a plain cell, for any boundary.

The boundary of such a leaf is made of *squares*: a face that is whole, or the four quarters of one where four smaller
leaves lie. Contours pass from edge to edge of the squares. Where a leaf has no hidden crossing there are at most 36
places for them to cross: *slots* 0 to 11 are the leaf's edges, whole or in either half, and 12 + 4f + 2r + h is, on
face f, the lower (h = 0) or upper half of the line through its middle that runs along the first (r = 0) or the second
of the two axes after the face's own.

In each square the contour joins two crossed edges; where all four are crossed, it joins those at each inside corner,
and in a *flipped* square those at each outside corner. Both leaves at a square see the same square and the same rule,
so what they see fits together whatever their sizes. Every crossed slot lies in two squares: following the joins gives
closed cycles, and each has one dual vertex.

A square with two joins is *troubled* for a leaf if both lie on one cycle. If it is so for both its leaves, the two dual
vertices would share two mesh edges. Flipping parts the cycle in two, for both leaves, since the way the two joins are
linked outside the square stays. All squares that are troubled for both their leaves can be flipped at once. The middle
of such a square links two places of a cycle on the outer side of it; two such links cannot cross, so when one flipping
has parted the cycle, both joins of the other square are still on one piece. As flipping parts cycles and merges none,
it troubles no other square.
"""

from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from sculpt_framework.geometry.octree import AXES, FACE_POINTS
from sculpt_framework.geometry.octree_band import face_lattice, quarter_corners

SLOTS = 36
SQUARES = 30
"""The six faces, then four quarters of each."""

Point = tuple[int, ...]


def slot_of(axis: int, lower: Point) -> int:
    """Slot of the lattice edge that goes up along ``axis`` from a lattice point; -1 inside the leaf."""
    _, first, second = AXES[axis]
    if lower[first] != 1 and lower[second] != 1:
        return 4 * axis + lower[first] // 2 + lower[second]
    for normal, across in ((first, second), (second, first)):
        if lower[normal] != 1 and lower[across] == 1:
            return 12 + 4 * (2 * normal + lower[normal] // 2) + 2 * (AXES[normal][1] != axis) + lower[axis]
    return -1


def _point(number: int) -> Point:
    return number % 3, number // 3 % 3, number // 9


def _edges(corners: list[int]) -> list[int]:
    """Slots of the four edges of a square; edge n goes from corner n to the next."""
    slots = []
    for n in range(4):
        lower, upper = sorted((_point(corners[n]), _point(corners[(n + 1) % 4])))
        axis = next(a for a in range(3) if lower[a] != upper[a])
        slots.append(slot_of(axis, lower))
    return slots


def _square_corners() -> list[list[int]]:
    """Lattice points round each square."""
    whole = [[face_lattice(face)[q][p] for p, q in ((0, 0), (2, 0), (2, 2), (0, 2))] for face in range(6)]
    return whole + [quarter for face in range(6) for quarter in quarter_corners(face)]


def _partners(case: int, flipped: bool) -> list[int]:
    """For each edge of a square with the inside corners given as bits, the edge it is joined to; -1 if not crossed."""
    crossed = [n for n in range(4) if (case >> n ^ case >> (n + 1) % 4) & 1]
    partner = [-1] * 4
    if len(crossed) == 2:
        partner[crossed[0]], partner[crossed[1]] = crossed[1], crossed[0]
    elif len(crossed) == 4:
        for n in range(4):
            if (case >> n & 1) != flipped:
                partner[n], partner[n - 1] = (n - 1) % 4, n
    return partner


@dataclass(frozen=True, kw_only=True, eq=False)
class SquareTables:
    corners: Int64[Tensor, "30 4"]
    """Lattice points of each square, in turn."""
    slots: Int64[Tensor, "30 4"]
    """Slots of its edges: edge n goes from corner n to the next."""
    partner: Int64[Tensor, "2 16 4"]
    """First index: flipped; second: the inside corners of the square, as bits."""
    sources: Int64[Tensor, "36 2 3"]
    """For each slot and each of its two sides, where among 30 x 4 square edges the one it is in now may be found."""
    slot_of_edge: Int64[Tensor, "3 27"]
    """Slot of the lattice edge up along an axis from a lattice point, -1 if there is none."""


@cache
def square_tables(device: torch.device) -> SquareTables:
    corners = _square_corners()
    slots = [_edges(square) for square in corners]
    sources = [_sources(slot, slots) for slot in range(SLOTS)]
    slot_of_edge = [[slot_of(axis, _point(n)) if _point(n)[axis] < 2 else -1 for n in range(27)] for axis in range(3)]
    return SquareTables(
        corners=torch.tensor(corners, device=device),
        slots=torch.tensor(slots, device=device),
        partner=torch.tensor(
            [[_partners(case, flipped) for case in range(16)] for flipped in (False, True)], device=device
        ),
        sources=torch.tensor(sources, device=device),
        slot_of_edge=torch.tensor(slot_of_edge, device=device),
    )


def _sources(slot: int, slots: list[list[int]]) -> list[list[int]]:
    """Two lists of three square edges. An edge of the leaf has a face on each side, as one square or two quarters of
    it; a line within a face has a quarter on each side."""
    found = [4 * square + slots[square].index(slot) for square in range(SQUARES) if slot in slots[square]]
    if slot >= 12:
        return [[place] * 3 for place in found]
    face_of = [place // 4 if place < 24 else (place - 24) // 16 for place in found]
    return [[p for p, f in zip(found, face_of, strict=True) if f == face] for face in sorted(set(face_of))]


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycles:
    patch: Int64[Tensor, "t 36"]
    """Number of the cycle through each slot, counted from 0; -1 where nothing crosses."""
    count: Int64[Tensor, " t"]
    troubled: Bool[Tensor, "t 30"]
    """Squares with two joins on one cycle."""


def cycles(inside: Bool[Tensor, "t 27"], vertices: Bool[Tensor, "t 27"], flipped: Bool[Tensor, "t 30"]) -> Cycles:
    """The cycles of leaves without hidden crossings, from the signs of the vertices at their lattice points."""
    tables = square_tables(inside.device)
    divided = vertices[:, FACE_POINTS]
    present = torch.cat([~divided, divided.repeat_interleave(4, dim=1)], dim=1)
    bits = torch.arange(4, device=inside.device)
    case = (inside[:, tables.corners].long() << bits).sum(dim=2)
    edge = tables.partner[flipped.long(), case]
    partner = tables.slots.expand(len(inside), -1, -1).gather(2, edge.clamp(min=0))
    partner = torch.where((edge >= 0) & present[..., None], partner, -1).reshape(-1, 4 * SQUARES)
    sides = partner[:, tables.sources.reshape(-1)].reshape(-1, SLOTS, 2, 3).amax(dim=3)
    crossed = sides[..., 0] >= 0

    slot = torch.arange(SLOTS, device=inside.device)
    label = slot.expand(len(inside), -1)
    first, second = torch.where(crossed[..., None], sides, slot[:, None]).unbind(dim=2)
    while True:
        least = torch.minimum(label, torch.minimum(label.gather(1, first), label.gather(1, second)))
        least = least.gather(1, least)
        if torch.equal(least, label):
            break
        label = least
    root = crossed & (label == slot)
    number = root.long().cumsum(dim=1) - 1
    labels = label[:, tables.slots]
    ambiguous = present & ((case == 0b0101) | (case == 0b1010))
    return Cycles(
        patch=torch.where(crossed, number.gather(1, label), -1),
        count=root.sum(dim=1),
        troubled=ambiguous & (labels == labels[..., :1]).all(dim=2),
    )
