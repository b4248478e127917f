"""Marching tetrahedra on an octree: the split fits together and fills the leaves, and so does the surface."""

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from octree_cases import DOUBLE_TORUS, FIELDS, box_grid, halves, hashed, random_tree, sampler
from torch import Tensor

from sculpt_framework.geometry.band import cells_at_level, discover, levels_of
from sculpt_framework.geometry.grid import Grid, grid_over_box, unpack_ijk
from sculpt_framework.geometry.octree import Octree, leaves, split, tree_around
from sculpt_framework.geometry.octree_band import OctreeBand, track_octree
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.geometry.topology import components, euler_characteristic, signed_volume
from sculpt_framework.testing import check_surface, sphere_sdf, torus_sdf
from sculpt_framework.types import Surface
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.extractors.marching_tetrahedra.extractor import edge_crossings
from sculpt_plugins.extractors.marching_tetrahedra.octree import (
    CODE_SHIFT,
    edge_lengths,
    march,
    split_leaves,
    with_centers,
)

CPU = torch.device("cpu")


def extract(
    sdf: SdfFunction, grid: Grid, tree: Octree, seeds: Tensor, dtype: torch.dtype = torch.float32
) -> tuple[OctreeBand, Surface]:
    sample = sampler(sdf, grid, dtype)
    band = track_octree(sample, tree, seeds)
    keys, positions, values = with_centers(band, sample)
    return band, surface_of(band, keys, positions, values)


def surface_of(band: OctreeBand, keys: Tensor, positions: Tensor, values: Tensor) -> Surface:
    inside = values.detach() < 0
    cut = march(band, split_leaves(band, inside), inside)
    flat = cut.ends.reshape(-1)
    vertices = edge_crossings(
        positions[flat].reshape(-1, 2, 3), values[flat].reshape(-1, 2), edge_lengths(keys, cut.ends, band)
    )
    return Surface(vertices=vertices, faces=cut.faces, face_keys=cut.face_keys)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    shape=st.tuples(*[st.integers(2, 4)] * 3),
    depth=st.integers(1, 3),
    field=st.sampled_from(sorted(FIELDS)),
)
def test_random_fields_on_random_trees(seed, shape, depth, field):
    random = np.random.default_rng(seed)
    grid = box_grid(shape)
    tree = random_tree(grid, random, depth)
    try:
        _, surface = extract(FIELDS[field](random, grid.base_cell), grid, tree, leaves(tree))
    except EmptySurfaceError:
        assume(False)
    check_surface(surface)


def test_tetrahedra_fill_the_leaves():
    grid = box_grid((4, 4, 3))
    tree = halves(grid, 1)
    tree = split(tree, leaves(tree)[100:110])
    sample = sampler(sphere_sdf(0.55, (0.1, 0.0, 0.05)), grid, torch.float64)
    band = track_octree(sample, tree, leaves(tree))
    assert len(levels_of(band.cells).unique()) > 1
    assert 5 < len(band.uneven) < len(band.cells)
    _, positions, _ = with_centers(band, sample)
    volumes: dict[tuple[int, int], float] = {}
    for seed in range(40):
        # Tetrahedra with a sign change are listed; with enough signs, each of them once or more.
        signs = torch.rand(len(positions), generator=torch.Generator().manual_seed(seed)) < 0.5
        found = split_leaves(band, signs)
        corners = positions[found.corners]
        volume = torch.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
        assert bool((volume[found.numbers >= 6] > 0).all())
        volume = volume.abs()
        volumes |= dict(
            zip(zip(found.cells.tolist(), found.numbers.tolist(), strict=True), volume.tolist(), strict=True)
        )
    filled = np.zeros(len(band.cells))
    for (cell, _), volume in volumes.items():
        filled[cell] += volume
    sides = (grid.base_cell * 0.5 ** levels_of(band.cells)).numpy()
    np.testing.assert_allclose(filled, sides**3, rtol=1e-6)


def test_on_one_level_it_is_the_plain_surface():
    grid = grid_over_box(torch.tensor([1.0, 0.8, 0.7]), cells=11, level=1)
    seeds = discover(lambda points: 0 * points[:, 0], grid, 1)
    for name in ("waves", "checkers", "solids"):
        sdf = FIELDS[name](np.random.default_rng(4), grid.cell)
        plain = MarchingTetrahedraConfig().build(grid, CPU).extract(sdf, seeds).surface
        _, found = extract(sdf, grid, tree_around(grid, seeds), seeds)
        old, new = plain.face_keys.argsort(), found.face_keys.argsort()
        assert torch.equal(found.face_keys[new], plain.face_keys[old])
        assert torch.equal(found.vertices[found.faces[new]], plain.vertices[plain.faces[old]])
        assert len(found.vertices) == len(plain.vertices)


@pytest.mark.parametrize(
    ("shape", "euler"), [(sphere_sdf(0.62), 2), (torus_sdf(0.5, 0.2), 0), (DOUBLE_TORUS, -2)], ids=["1", "0", "-2"]
)
def test_shapes_have_their_topology(shape: SdfFunction, euler: int):
    grid = box_grid((20, 20, 20))
    tree = halves(grid, 2, leave=0.6)
    band, surface = extract(shape, grid, tree, leaves(tree))
    check_surface(surface)
    assert len(levels_of(band.cells).unique()) == 3
    assert components(surface.faces)[0] == 1
    assert euler_characteristic(surface.faces) == euler
    # Faces in leaves with a centre have names of their own, above all levels.
    assert bool((levels_of(surface.face_keys) >= 1 << (CODE_SHIFT - 55)).any())
    assert bool((surface.face_keys >= 0).all())


def test_volume_and_distance_converge_at_second_order():
    sdf, exact = torus_sdf(0.55, 0.27), 2 * math.pi**2 * 0.55 * 0.27**2
    errors, distances = [], []
    for cells in (14, 28, 56):
        grid = grid_over_box(torch.ones(3), cells=cells)
        seeds = discover(sdf, grid, 0)
        beyond = seeds[unpack_ijk(seeds)[:, 0] >= grid.shape[0] // 2]
        _, surface = extract(sdf, grid, tree_around(grid, cells_at_level(beyond, 1)), seeds, torch.float64)
        errors.append(abs(signed_volume(surface.vertices, surface.faces) - exact))
        distances.append(float(sdf(surface.vertices[surface.faces].mean(dim=1)).abs().mean()))
    for measured in (errors, distances):
        assert measured[0] / measured[1] > 3.2
        assert measured[1] / measured[2] > 3.2


def test_gradient_by_positions_and_distances():
    grid = box_grid((5, 4, 4))
    tree = halves(grid, 1)
    signs = FIELDS["noise"](np.random.default_rng(2), grid.base_cell)

    def sdf(points: Tensor) -> Tensor:
        size = 0.2 + hashed(points, 2)
        return torch.where(signs(points) < 0, -size, size)

    sample = sampler(sdf, grid, torch.float64)
    band = track_octree(sample, tree, leaves(tree))
    assert len(band.uneven) > 5
    keys, positions, values = with_centers(band, sample)
    random = torch.Generator().manual_seed(1)
    inputs = [positions.clone().requires_grad_(), values.clone().requires_grad_()]
    vertices = surface_of(band, keys, *inputs).vertices
    mixture = torch.randn(vertices.shape, generator=random, dtype=torch.float64)
    slopes = torch.autograd.grad(vertices, inputs, mixture)
    for which, slope in enumerate(slopes):
        direction = torch.randn(slope.shape, generator=random, dtype=torch.float64)
        ends = []
        for sign in (1e-6, -1e-6):
            moved = [each.detach() + (sign * direction if n == which else 0) for n, each in enumerate(inputs)]
            ends.append((surface_of(band, keys, *moved).vertices * mixture).sum())
        torch.testing.assert_close((slope * direction).sum(), (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-7)
