"""The octree as a data structure: splitting, balance, and who touches whom."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from octree_cases import NOTHING, box_grid, plain_leaves, random_tree

from sculpt_framework.geometry.band import cells_at_level, children, corners_of, levels_of, parents
from sculpt_framework.geometry.grid import MAX_CELLS_PER_AXIS, pack, unpack_ijk
from sculpt_framework.geometry.octree import (
    EDGE_ENDS,
    EDGE_POINTS,
    FACE_EDGES,
    FACE_POINTS,
    Octree,
    balanced,
    corner_keys,
    finer_neighbours,
    holding_leaves,
    lattice_keys,
    leaves,
    leaves_at,
    split,
    tree_around,
    vertex_level,
)

SHAPES = st.tuples(*[st.integers(1, 4)] * 3)


def make(seed: int, shape: tuple[int, int, int], depth: int = 3, level: int = 0) -> Octree:
    return random_tree(box_grid(shape, level), np.random.default_rng(seed), depth)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), shape=SHAPES, level=st.integers(0, 1))
def test_leaves_fill_the_grid_and_are_balanced(seed, shape, level):
    tree = make(seed, shape, depth=3, level=level)
    assert torch.equal(tree.split_cells, tree.split_cells.unique())
    assert bool(tree.is_split(parents(tree.split_cells[levels_of(tree.split_cells) > level])).all())
    plain = plain_leaves(tree)
    unit = 1 << (vertex_level(tree.grid) - tree.finest_level)
    filled = np.zeros([n << tree.finest_level for n in shape], dtype=int)
    for (x, y, z), side in plain:
        low, size = (x // unit, y // unit, z // unit), side // unit
        filled[tuple(slice(at, at + size) for at in low)] += 1
    assert (filled == 1).all()
    # Of every two neighbours on the finest cells, the sizes of their leaves differ by a factor of two at most.
    sizes = np.zeros_like(filled)
    for (x, y, z), side in plain:
        sizes[tuple(slice(at // unit, at // unit + side // unit) for at in (x, y, z))] = side
    for step in itertools.product((-1, 0, 1), repeat=3):
        here = sizes[tuple(slice(max(0, d), n + min(0, d)) for d, n in zip(step, sizes.shape, strict=True))]
        there = sizes[tuple(slice(max(0, -d), n + min(0, -d)) for d, n in zip(step, sizes.shape, strict=True))]
        assert (np.maximum(here, there) <= 2 * np.minimum(here, there)).all()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), shape=SHAPES)
def test_splitting_splits_no_more_than_it_must(seed, shape):
    tree = make(seed, shape)
    cells = leaves(tree)
    cells = cells[levels_of(cells) < 3]
    random = np.random.default_rng(seed)
    chosen = cells[torch.from_numpy(random.random(len(cells)) < 0.1)]
    finer = split(tree, chosen)
    assert bool(finer.is_split(chosen).all())
    # Every other cell that was split has a finer neighbour that needs it: without it the tree is not balanced.
    extra = finer.split_cells[~torch.isin(finer.split_cells, torch.cat([tree.split_cells, chosen]))]
    for cell in extra:
        without = balanced(finer.grid, finer.split_cells[finer.split_cells != cell])
        assert torch.equal(without.split_cells, finer.split_cells)
    assert torch.equal(split(finer, chosen).split_cells, finer.split_cells)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), shape=SHAPES)
def test_every_cell_finds_its_leaf(seed, shape):
    tree = make(seed, shape)
    cells = leaves(tree)
    assert torch.equal(holding_leaves(tree, cells), cells)
    deeper = cells_at_level(cells[::5], 2)
    assert torch.equal(holding_leaves(tree, deeper).unique(), cells[::5])
    ijk = torch.cartesian_prod(*(torch.arange(n) for n in shape))
    assert torch.equal(leaves_at(tree, pack(0, ijk)), cells)
    assert torch.equal(leaves_at(tree, torch.cat([deeper, cells[:3]])), torch.cat([cells[::5], cells[:3]]).unique())
    assert leaves_at(tree, NOTHING).tolist() == []


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), shape=SHAPES)
def test_finer_neighbours_are_those_with_vertices_on_the_boundary(seed, shape):
    tree = make(seed, shape)
    cells = leaves(tree)
    vertices = set(corner_keys(tree.grid, cells).reshape(-1).tolist())
    finer = finer_neighbours(tree, cells)
    present = torch.zeros(len(cells), 27, dtype=torch.bool)
    present[:, [0, 2, 6, 8, 18, 20, 24, 26]] = True
    present[finer.rows] = finer.vertices()
    expected = [[key in vertices for key in row] for row in lattice_keys(tree.grid, cells).tolist()]
    assert present.tolist() == expected
    assert bool(finer.edges.any(dim=1).all())


def test_tree_around_has_the_cells_and_no_more():
    grid = box_grid((4, 4, 4))
    cell = pack(2, torch.tensor([[8, 8, 8]]))
    tree = tree_around(grid, cell)
    # Its parent at (4, 4, 4) of level 1 is split, and so must be the eight roots that this parent touches.
    assert unpack_ijk(tree.split_cells[levels_of(tree.split_cells) == 1]).tolist() == [[4, 4, 4]]
    roots = unpack_ijk(tree.split_cells[levels_of(tree.split_cells) == 0])
    assert sorted(roots.tolist()) == [list(place) for place in itertools.product((1, 2), repeat=3)]
    assert torch.isin(cell, leaves(tree)).all()
    assert len(tree_around(grid, pack(0, torch.tensor([[1, 2, 3]]))).split_cells) == 0
    assert tree_around(grid, NOTHING).finest_level == 0


def test_cells_that_cannot_be_split_are_refused():
    grid = box_grid((4, 4, 4), level=1)
    with pytest.raises(ValueError, match="levels 0 to 0 cannot be split: roots have level 1"):
        balanced(grid, pack(0, torch.tensor([[1, 1, 1]])))
    finest = vertex_level(grid)
    with pytest.raises(ValueError, match=f"the finest level is {finest}"):
        balanced(grid, pack(finest, torch.tensor([[1, 1, 1]])))


def test_vertices_have_one_name_at_all_levels():
    grid = box_grid((3, 2, 4))
    assert 4 << vertex_level(grid) <= MAX_CELLS_PER_AXIS < 4 << vertex_level(grid) + 1
    cells = pack(1, torch.tensor([[1, 2, 3]]))
    corners = corner_keys(grid, cells)[0]
    of_children = corner_keys(grid, children(cells))
    assert torch.equal(of_children.reshape(-1).unique(), lattice_keys(grid, cells)[0].unique())
    shared = torch.unique(of_children, return_counts=True)
    assert torch.equal(shared[0][shared[1] == 1], corners.sort().values)
    finest = grid.at_level(vertex_level(grid))
    places = finest.corner_positions(unpack_ijk(corners), torch.float32)
    plain = grid.at_level(1).corner_positions(unpack_ijk(corners_of(cells)[0]), torch.float32)
    assert torch.equal(places[torch.argsort(corners)], plain)


def test_numbers_of_edges_and_faces_fit_together():
    for edge, (first, second) in enumerate(EDGE_ENDS):
        assert (first + second) // 2 == EDGE_POINTS[edge]
    for face, edges in enumerate(FACE_EDGES):
        axis, side = divmod(face, 2)
        assert len(edges) == 4
        assert sum(EDGE_POINTS[edge] for edge in edges) == 4 * FACE_POINTS[face]
        assert all(EDGE_POINTS[edge] // 3**axis % 3 == 2 * side for edge in edges)


def test_nothing_of_the_size_of_the_volume_is_made():
    grid = box_grid((5, 5, 5), level=9)  # 2560 cells per axis.
    cells = pack(12, torch.tensor([[9000, 9001, 9002]]))
    tree = split(tree_around(grid, cells), cells)
    assert len(tree.split_cells) < 100
    assert torch.equal(holding_leaves(tree, children(cells)), children(cells))
