"""Closed and manifold for any signs at the corners, however ambiguous."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sampled_grids import all_cells, corner_lookup, unit_grid

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.geometry.tetrahedra import triangles_of
from sculpt_framework.geometry.topology import components
from sculpt_framework.testing import check_extraction
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.flexicubes.tables import EDGES, dual_tables, patches, segments
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.extractors.marching_tetrahedra.tables import TETRAHEDRA, tetrahedra_tables

CPU = torch.device("cpu")
CORNERS = [(n & 1, n >> 1 & 1, n >> 2) for n in range(8)]


def check_corner_values(config: ExtractorConfig, values: torch.Tensor):
    grid = unit_grid(tuple(n - 1 for n in values.shape))
    extraction = config.build(grid, CPU).extract(corner_lookup(values), all_cells(grid))
    check_extraction(extraction)
    return extraction


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    shape=st.tuples(*[st.integers(3, 9)] * 3),
    inside=st.floats(0.1, 0.9),
    levels=st.sampled_from([0, 1, 3]),
)
def test_noise_gives_a_manifold(config: ExtractorConfig, seed, shape, inside, levels):
    random = np.random.default_rng(seed)
    noise = random.uniform(size=tuple(n + 1 for n in shape)) - inside
    if levels:
        noise = np.round(noise * levels) / levels  # Many exact zeros, and many equal values.
    noise[1, 1, 1] = -1.0  # At least one corner inside.
    check_corner_values(config, torch.tensor(noise, dtype=torch.float32))


def test_every_case_of_a_cell(config: ExtractorConfig):
    values = torch.ones(32, 32, 16)
    for case in range(256):
        x, y, z = case % 8 * 4 + 1, case // 8 % 8 * 4 + 1, case // 64 * 4 + 1
        for n, (i, j, k) in enumerate(CORNERS):
            values[x + i, y + j, z + k] = -1.0 if case >> n & 1 else 1.0
    extraction = check_corner_values(config, values)
    if isinstance(config, FlexiCubesConfig):
        # Ambiguous faces part inside corners: there are as many pieces as groups of inside corners joined by edges.
        assert components(extraction.surface.faces)[0] == sum(groups_along_edges(case) for case in range(256))


def groups_along_edges(case: int) -> int:
    group = list(range(8))
    for lower, upper in EDGES:
        if case >> lower & case >> upper & 1:
            group = [group[lower] if g == group[upper] else g for g in group]
    return len({group[n] for n in range(8) if case >> n & 1})


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    "config", [MarchingTetrahedraConfig(), FlexiCubesConfig(learn_weights=False)], ids=["tetrahedra", "dual"]
)
def test_every_pair_of_cells_at_a_face(config: ExtractorConfig, axis: int):
    block = [2, 2, 2]
    block[axis] = 3
    places = list(itertools.product(*(range(n) for n in block)))
    period = [n + 1 for n in block]
    values = torch.ones([16 * n + 2 for n in period])
    number = torch.arange(4096)
    origin = torch.stack([number & 15, number >> 4 & 15, number >> 8], dim=1) * torch.tensor(period) + 1
    for bit, place in enumerate(places):
        i, j, k = (origin + torch.tensor(place)).unbind(dim=1)
        values[i, j, k] = 1.0 - 2.0 * (number >> bit & 1)
    check_corner_values(config, values)


def test_troubled_cells_have_one_ambiguous_face_and_inverting_it_helps():
    tables = dual_tables(CPU)
    troubled = torch.nonzero(tables.troubled_face >= 0).squeeze(1).tolist()
    assert sorted(bin(case).count("1") for case in troubled) == [5] * 24 + [6] * 12
    for case in troubled:
        ambiguous = [face for face in range(6) if len(list(segments(case, face, inverted=False))) == 2]
        assert ambiguous == [int(tables.troubled_face[case])]
        (first, _), (second, _) = segments(case, ambiguous[0], inverted=True)
        patch = patches(case, inverted=True)
        assert patch[first] != patch[second]


def test_dual_tables_list_each_crossed_edge_once():
    tables = dual_tables(CPU)
    for case in range(256):
        crossed = torch.tensor([(case >> lower ^ case >> upper) & 1 == 1 for lower, upper in EDGES])
        for inverted in range(2):
            assert torch.equal(tables.patch[inverted, case] >= 0, crossed)
            loops = tables.patch[inverted, case][crossed].bincount()
            assert len(loops) == tables.patch_count[inverted, case]
            assert bool((loops >= 3).all())


def test_patches_do_not_depend_on_how_the_cell_is_turned():
    sizes = {}
    for case in range(256):
        loops = torch.tensor(patches(case, inverted=False))
        sizes[case] = sorted(loops[loops >= 0].bincount().tolist())
    for order in itertools.permutations(range(3)):
        for flips in itertools.product((0, 1), repeat=3):
            moved = [
                sum((CORNERS[n][axis] ^ flips[axis]) << place for place, axis in enumerate(order)) for n in range(8)
            ]
            for case in range(256):
                image = sum(1 << moved[n] for n in range(8) if case >> n & 1)
                assert sizes[image] == sizes[case]


def test_tetrahedra_fill_the_cell():
    points = np.array(CORNERS, dtype=float)
    volumes = [abs(np.linalg.det(points[list(t[1:])] - points[t[0]])) / 6 for t in TETRAHEDRA]
    assert volumes == pytest.approx([1 / 6] * 6)
    codes = tetrahedra_tables(CPU).code
    assert codes.max() == 119
    assert len(codes.unique()) == 120
    assert [len(triangles_of(TETRAHEDRA[0], case)) for case in range(16)] == [
        min(case.bit_count(), 4 - case.bit_count()) for case in range(16)
    ]
