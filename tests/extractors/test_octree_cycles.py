"""Cycles on the boundaries of leaves, and which of them follow from which signs."""

import itertools

import pytest
import torch
from torch import Tensor

from sculpt_framework.geometry.octree import (
    CORNER_POINTS,
    EDGE_ENDS,
    EDGE_POINTS,
    FACE_EDGES,
    FACE_POINTS,
    FinerNeighbours,
)
from sculpt_plugins.extractors.flexicubes.octree_cycles import SLOTS, SQUARES, cycles, slot_of, square_tables
from sculpt_plugins.extractors.flexicubes.tables import dual_tables

CPU = torch.device("cpu")


def renumbered(patch: list[int]) -> list[int]:
    """Patches counted in the order they are met."""
    names: dict[int, int] = {-1: -1}
    return [names.setdefault(p, len(names) - 1) for p in patch]


@pytest.mark.parametrize("flipped", [False, True])
def test_cells_without_finer_neighbours_are_as_in_the_tables(flipped: bool):
    tables = dual_tables(CPU)
    case = torch.arange(256)
    vertices = torch.zeros(256, 27, dtype=torch.bool)
    vertices[:, CORNER_POINTS] = True
    inside = torch.zeros_like(vertices)
    inside[:, CORNER_POINTS] = (case[:, None] >> torch.arange(8) & 1) == 1
    found = cycles(inside, vertices, torch.full((256, SQUARES), flipped))
    assert bool((found.patch[:, 12:] == -1).all())
    assert torch.equal(found.count, tables.patch_count[int(flipped)])
    for n in range(256):
        assert renumbered(found.patch[n, :12].tolist()) == renumbered(tables.patch[int(flipped), n].tolist())
    if not flipped:
        troubled = torch.where(found.troubled.any(dim=1), found.troubled.long().argmax(dim=1), -1)
        assert torch.equal(troubled, tables.troubled_face)


def random_boundaries(count: int) -> tuple[Tensor, Tensor]:
    """Signs and vertices of leaves with finer neighbours, in all ways, without hidden crossings."""
    random = torch.Generator().manual_seed(3)
    faces = torch.rand(count, 6, generator=random) < 0.5
    edges = torch.rand(count, 12, generator=random) < 0.2
    for face, around in enumerate(FACE_EDGES):
        edges[:, around] |= faces[:, face : face + 1]
    vertices = FinerNeighbours(rows=torch.arange(count), edges=edges, faces=faces).vertices()
    inside = (torch.rand(count, 27, generator=random) < 0.5) & vertices
    first, second = inside[:, torch.tensor(EDGE_ENDS)].unbind(dim=2)
    inside[:, EDGE_POINTS] = torch.where(torch.rand(count, 12, generator=random) < 0.5, first, second) & edges
    around = inside[:, EDGE_POINTS][:, torch.tensor(FACE_EDGES)]
    hidden = (faces & (around != inside[:, FACE_POINTS][..., None]).all(dim=2)).any(dim=1)
    return inside[~hidden], vertices[~hidden]


def test_every_crossing_is_on_one_cycle_of_at_least_three():
    inside, vertices = random_boundaries(20_000)
    found = cycles(inside, vertices, torch.zeros(len(inside), SQUARES, dtype=torch.bool))
    ends = inside[:, torch.tensor(EDGE_ENDS)]
    assert torch.equal(found.patch[:, :12] >= 0, ends[..., 0] != ends[..., 1])
    halves = torch.zeros(len(inside), SLOTS - 12, dtype=torch.bool)
    for face in range(6):
        for line, half in itertools.product(range(2), range(2)):
            axis = (face // 2 + 1 + line) % 3
            end = FACE_POINTS[face] + (2 * half - 1) * 3**axis
            differs = inside[:, end] != inside[:, FACE_POINTS[face]]
            halves[:, 4 * face + 2 * line + half] = differs & vertices[:, FACE_POINTS[face]]
    assert torch.equal(found.patch[:, 12:] >= 0, halves)
    assert bool((halves.sum(dim=1) > 8).any())
    sizes = torch.zeros(len(inside), SLOTS + 1, dtype=torch.long).scatter_add(
        1, found.patch + 1, torch.ones_like(found.patch)
    )[:, 1:]
    used = torch.arange(SLOTS) < found.count[:, None]
    assert bool((sizes[used] >= 3).all())
    assert bool((sizes[~used] == 0).all())


def test_flipping_troubled_squares_parts_cycles_and_troubles_no_other():
    inside, vertices = random_boundaries(60_000)
    plain = torch.zeros(len(inside), SQUARES, dtype=torch.bool)
    before = cycles(inside, vertices, plain)
    number = before.troubled.sum(dim=1)
    assert bool((number == 2).any())
    for keep in range(3):  # The first of the troubled squares, all but the first, all.
        first = before.troubled & (before.troubled.long().cumsum(dim=1) == 1)
        flipped = (first, before.troubled & ~first, before.troubled)[keep]
        after = cycles(inside, vertices, flipped)
        assert torch.equal(after.count, before.count + flipped.sum(dim=1))
        assert torch.equal(after.troubled, before.troubled & ~flipped)


def test_slots_and_squares():
    tables = square_tables(CPU)
    lower = [(x, y, z) for z, y, x in itertools.product(range(3), repeat=3)]
    slots = [slot_of(axis, point) for axis in range(3) for point in lower if point[axis] < 2]
    assert sorted(set(slots)) == [-1, *range(SLOTS)]
    assert all(slots.count(slot) == (2 if slot < 12 else 1) for slot in range(SLOTS))
    assert tables.slots.unique().tolist() == list(range(SLOTS))
    assert bool((tables.sources >= 0).all())
    found = tables.slots.reshape(-1)[tables.sources.reshape(SLOTS, -1)]
    assert torch.equal(found, torch.arange(SLOTS)[:, None].expand_as(found))
