"""Closed and manifold for any tree and any field, with exactly the faces that a plain enumeration asks for."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from octree_cases import (
    DOUBLE_TORUS,
    FIELDS,
    NOTHING,
    box_grid,
    halves,
    plain_leaves,
    plain_minimal_edges,
    random_tree,
    sampler,
)

from sculpt_framework.geometry.band import levels_of
from sculpt_framework.geometry.grid import PART_BITS, Grid, unpack_ijk
from sculpt_framework.geometry.octree import Octree, balanced, leaves, split, vertex_level
from sculpt_framework.geometry.octree_band import OctreeBand, track_octree
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.geometry.topology import components, euler_characteristic, signed_volume
from sculpt_framework.testing import check_surface, sphere_sdf, torus_sdf
from sculpt_framework.types import Surface
from sculpt_plugins.extractors.flexicubes.surface import octree_surface
from sculpt_plugins.extractors.flexicubes.triangles import TRIANGLE_PRIMITIVE

CASES = {
    "seed": st.integers(0, 2**31),
    "shape": st.tuples(*[st.integers(2, 4)] * 3),
    "depth": st.integers(1, 3),
    "field": st.sampled_from(sorted(FIELDS)),
    "split": st.sampled_from(["diagonal", "center"]),
}


Case = tuple[OctreeBand, Surface, SdfFunction]


def check_case(seed: int, shape: tuple[int, int, int], depth: int, field: str, split: str) -> Case:
    random = np.random.default_rng(seed)
    grid = box_grid(shape)
    tree = random_tree(grid, random, depth)
    sdf = FIELDS[field](random, grid.base_cell)
    try:
        band = track_octree(sampler(sdf, grid), tree, leaves(tree))
    except EmptySurfaceError:
        assume(False)
    # Cells split for their neighbours' sake may show surface that no seed meets; now they are seeds.
    while len(band.tree.split_cells) > len(tree.split_cells):
        tree = band.tree
        band = track_octree(sampler(sdf, grid), tree, leaves(tree))
    surface = octree_surface(band, split).surface
    check_surface(surface)
    assert bool(((band.cases > 0) & (band.cases < 255)).all())
    return band, surface, sdf


@settings(max_examples=200, deadline=None)
@given(**CASES)
@pytest.mark.slow
def test_random_fields_on_random_trees(seed, shape, depth, field, split):
    check_case(seed, shape, depth, field, split)


@pytest.mark.slow
@settings(max_examples=1000, deadline=None)
@given(**CASES)
def test_very_many_random_fields_on_random_trees(seed, shape, depth, field, split):
    check_enumerated(*check_case(seed, shape, depth, field, split), split)


@settings(max_examples=15, deadline=None)
@given(**CASES)
def test_no_face_is_missing_or_doubled(seed, shape, depth, field, split):
    check_enumerated(*check_case(seed, shape, depth, field, split), split)


def check_enumerated(band: OctreeBand, surface: Surface, sdf: SdfFunction, split: str):
    """There are as many triangles for each minimal edge as the number of leaves round it asks for."""
    edges = plain_minimal_edges(band.tree, sdf)
    sides = {}
    for low, side in plain_leaves(band.tree):
        sides.setdefault(side, set()).add(low)

    def leaf_at(place: list[int]) -> tuple:
        """The leaf that holds a unit cube."""
        for side, found in sides.items():
            low = tuple(at // side * side for at in place)
            if low in found:
                return low
        raise AssertionError("the leaves do not fill the grid")

    expected = {}
    for (lower, axis), _ in edges.items():
        around = set()
        for below in itertools.product((0, 1), repeat=2):
            place = list(lower)
            place[(axis + 1) % 3] -= below[0]
            place[(axis + 2) % 3] -= below[1]
            around.add(leaf_at(place))
        expected[lower, axis] = {3: 1, 4: 2 if split == "diagonal" else 4}[len(around)]

    keys = surface.face_keys
    primitive = keys >> PART_BITS & 15
    assert bool((primitive < TRIANGLE_PRIMITIVE + 3).all())
    places = unpack_ijk(keys) << (vertex_level(band.tree.grid) - levels_of(keys))[:, None]
    found: dict = {}
    for place, axis in zip(places.tolist(), (primitive % 3).tolist(), strict=True):
        edge = (tuple(place), axis)
        found[edge] = found.get(edge, 0) + 1
    assert found == expected


def sprinkled(grid: Grid, share: float) -> Octree:
    """Cells of three levels in disorder."""
    tree = balanced(grid, NOTHING)
    for seed in range(2):
        cells = leaves(tree)
        chosen = torch.rand(len(cells), generator=torch.Generator().manual_seed(seed)) < share
        tree = split(tree, cells[chosen])
    return tree


@pytest.mark.parametrize("mix", ["even", "half x", "half y", "half z", "steps", "sprinkled", "mottled"])
@pytest.mark.parametrize(
    ("shape", "euler"), [(sphere_sdf(0.62), 2), (torus_sdf(0.5, 0.2), 0), (DOUBLE_TORUS, -2)], ids=["1", "0", "-2"]
)
def test_shapes_have_their_topology_at_every_mix_of_levels(shape: SdfFunction, euler: int, mix: str):
    grid = box_grid((20, 20, 20))
    tree = {
        "even": lambda: halves(grid, 1, leave=0.0),
        "half x": lambda: halves(grid, 1, axis=0),
        "half y": lambda: halves(grid, 1, axis=1),
        "half z": lambda: halves(grid, 1, axis=2),
        "steps": lambda: halves(grid, 2, leave=0.6),
        "sprinkled": lambda: sprinkled(grid, 0.03),
        "mottled": lambda: sprinkled(grid, 0.1),
    }[mix]()
    band = track_octree(sampler(shape, grid), tree, leaves(tree))
    surface = octree_surface(band, "diagonal").surface
    check_surface(surface)
    assert len(levels_of(band.cells).unique()) == (1 if mix == "even" else 2 if "half" in mix else 3)
    assert components(surface.faces)[0] == 1
    assert euler_characteristic(surface.faces) == euler
    assert signed_volume(surface.vertices, surface.faces) > 0
