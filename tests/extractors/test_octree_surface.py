"""The dual surface on an octree against the one on a plain grid, finite differences, and known volumes."""

import math

import numpy as np
import pytest
import torch
from octree_cases import FIELDS, box_grid, halves, hashed, sampler
from torch import Tensor

from sculpt_framework.geometry.band import cells_at_level, discover, levels_of
from sculpt_framework.geometry.grid import Grid, grid_over_box, unpack_ijk
from sculpt_framework.geometry.keys import find
from sculpt_framework.geometry.octree import balanced, leaves, split, tree_around
from sculpt_framework.geometry.octree_band import OctreeBand, track_octree
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.geometry.topology import signed_volume
from sculpt_framework.testing import sphere_sdf, torus_sdf
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.flexicubes.surface import octree_surface

CPU = torch.device("cpu")


def weights(cells: int, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    """Alpha, beta and gamma away from 1."""
    random = torch.Generator().manual_seed(7)
    return [torch.rand(cells, size, generator=random, dtype=dtype) + 0.5 for size in (8, 12, 1)]


# ----------------------------------------------------------------------------------------------------------- plain grid


@pytest.mark.parametrize("split_name", ["diagonal", "center"])
@pytest.mark.parametrize("field", ["torus", *FIELDS])
def test_on_one_level_it_is_the_plain_surface(field: str, split_name):
    grid = grid_over_box(torch.tensor([1.0, 0.8, 0.7]), cells=11, level=1)
    seeds = discover(lambda points: 0 * points[:, 0], grid, 1)
    compared = 0
    for seed in range(5):
        made = torus_sdf() if field == "torus" else FIELDS[field](np.random.default_rng(seed), grid.cell)
        sdf = closed(made, grid)
        roots = (grid.at_level(0), grid)[compared % 2]
        tree = tree_around(roots, seeds)
        extractor = FlexiCubesConfig(split=split_name, learn_weights=False).build(grid, CPU)
        try:
            band = track_octree(sampler(sdf, roots), tree, seeds)
        except EmptySurfaceError:
            with pytest.raises(EmptySurfaceError):
                extractor.extract(sdf, seeds)
            continue
        compared += 1
        plain = extractor.extract(sdf, seeds)
        assert torch.equal(band.cells, plain.cells)
        assert torch.equal(band.corner_sdf[band.cell_corners], plain.corner_sdf[plain.cell_corners])
        found = octree_surface(band, split_name)
        old, new = plain.surface.face_keys.argsort(), found.surface.face_keys.argsort()
        assert torch.equal(found.surface.face_keys[new], plain.surface.face_keys[old])
        # The same points in the same order, so the same triangles.
        assert torch.equal(
            found.surface.vertices[found.surface.faces[new]], plain.surface.vertices[plain.surface.faces[old]]
        )
        assert torch.equal(found.edge_sdf, plain.edge_sdf)
        torch.testing.assert_close(found.deviation.sum(), plain.deviation.sum())
    assert compared >= 3


def closed(sdf: SdfFunction, grid: Grid) -> SdfFunction:
    """Well outside at the wall of a grid, so that nothing is raised there, whatever the size of the roots."""

    def raised(points: Tensor) -> Tensor:
        low = torch.tensor(grid.origin)
        high = low + torch.tensor(grid.shape) * grid.cell
        at_wall = ((points - low).abs() < 0.5 * grid.cell) | ((points - high).abs() < 0.5 * grid.cell)
        return torch.where(at_wall.any(dim=1), 0.1 * grid.cell, sdf(points))

    return raised


def test_weights_act_as_on_the_plain_grid():
    grid = grid_over_box(torch.ones(3), cells=14)
    extractor = FlexiCubesConfig(split="center").build(grid, CPU)
    seeds = discover(torus_sdf(), grid, 0)
    cells = extractor.extract(torus_sdf(), seeds).cells
    random = torch.Generator().manual_seed(3)
    table = extractor.tables["cells"]
    for leaf in table.leaves.values():
        leaf.data.normal_(generator=random)
    plain = extractor.extract(torus_sdf(), cells)
    band = track_octree(sampler(torus_sdf(), grid), tree_around(grid, cells), cells)
    found = octree_surface(band, "center", *(1 + 0.99 * torch.tanh(leaf) for leaf in table.leaves.values()))
    old, new = plain.surface.face_keys.argsort(), found.surface.face_keys.argsort()
    torch.testing.assert_close(
        found.surface.vertices[found.surface.faces[new]], plain.surface.vertices[plain.surface.faces[old]]
    )


# ------------------------------------------------------------------------------------------------------------ gradients


def mixed_band(seed: int) -> OctreeBand:
    """A small band of several levels with values well away from 0, in float64."""
    random = np.random.default_rng(seed)
    grid = box_grid((5, 4, 4))
    tree = halves(grid, 1)
    cells = leaves(tree)
    tree = split(tree, cells[torch.from_numpy(random.random(len(cells)) < 0.03)])
    signs = FIELDS["noise"](random, grid.base_cell)

    def sdf(points: Tensor) -> Tensor:
        size = 0.2 + hashed(points, seed)  # No two alike: where distances are equal, the deviation has a kink.
        return torch.where(signs(points) < 0, -size, size)

    return track_octree(sampler(sdf, grid, torch.float64), tree, leaves(tree))


@pytest.mark.parametrize("seed", range(4))
def test_gradient_by_every_input(seed: int):
    band = mixed_band(seed)
    assert len(levels_of(band.cells).unique()) > 1
    assert len(band.uneven) > 0
    random = torch.Generator().manual_seed(seed)
    inputs = [band.corner_positions, band.corner_sdf, *weights(len(band.cells))]
    inputs = [tensor.clone().requires_grad_() for tensor in inputs]

    def everything(positions: Tensor, sdf: Tensor, *own: Tensor) -> tuple[Tensor, Tensor]:
        moved = OctreeBand(**(vars(band) | {"corner_positions": positions, "corner_sdf": sdf}))
        found = octree_surface(moved, "center", *own)
        return found.surface.vertices, found.deviation

    outputs = everything(*inputs)
    mixture = [torch.randn(output.shape, generator=random, dtype=torch.float64) for output in outputs]
    slopes = torch.autograd.grad(outputs, inputs, mixture)
    for tensor, slope in zip(inputs, slopes, strict=True):
        direction = torch.randn(tensor.shape, generator=random, dtype=torch.float64)
        step = 1e-7 * direction
        values = []
        for sign in (1, -1):
            with torch.no_grad():
                changed = [each + sign * step if each is tensor else each for each in inputs]
                values.append(sum((o * m).sum() for o, m in zip(everything(*changed), mixture, strict=True)))
        assert float(slope.abs().max()) > 0
        torch.testing.assert_close((slope * direction).sum(), (values[0] - values[1]) / 2e-7, rtol=1e-5, atol=1e-5)


def test_gradient_reaches_a_field_through_mixed_levels():
    grid = box_grid((10, 10, 10))
    tree = halves(grid, 1)
    offset = torch.zeros((), dtype=torch.float64, requires_grad=True)

    def radius(shift: Tensor) -> Tensor:
        band = track_octree(sampler(lambda p: sphere_sdf(0.61)(p) - shift, grid, torch.float64), tree, leaves(tree))
        return torch.linalg.vector_norm(octree_surface(band, "diagonal").surface.vertices, dim=1).mean()

    (slope,) = torch.autograd.grad(radius(offset), [offset])
    step = torch.tensor(1e-6, dtype=torch.float64)
    torch.testing.assert_close(slope, (radius(step) - radius(-step)) / 2e-6, rtol=1e-6, atol=1e-8)
    assert abs(float(slope) - 1) < 0.05


def test_neutral_weights_change_nothing():
    band = mixed_band(1)
    plain = octree_surface(band, "center")
    ones = [torch.ones(len(band.cells), size, dtype=torch.float64) for size in (8, 12, 1)]
    weighted = octree_surface(band, "center", *ones)
    # Without gamma a centre is the mean of its quad's corners, with gamma 1 too.
    torch.testing.assert_close(weighted.surface.vertices, plain.surface.vertices)
    torch.testing.assert_close(weighted.deviation, plain.deviation)


def test_dual_vertices_stay_in_their_leaves():
    band = mixed_band(2)
    alpha, beta, _ = (weight**6 for weight in weights(len(band.cells)))
    surface = octree_surface(band, "diagonal", alpha, beta).surface
    low = band.corner_positions[band.cell_corners[:, 0]]
    high = band.corner_positions[band.cell_corners[:, 7]]
    inside = (surface.vertices[:, None] >= low - 1e-12) & (surface.vertices[:, None] <= high + 1e-12)
    # Dual vertices are counted leaf by leaf: each lies in its own, and the leaves come in their order.
    holder = inside.all(dim=2)
    assert bool(holder.any(dim=1).all())
    assert bool(holder.any(dim=0).all())


# ---------------------------------------------------------------------------------------------------------- convergence

SOLIDS = {
    "sphere": (sphere_sdf(0.7), 4 / 3 * math.pi * 0.7**3),
    "torus": (torus_sdf(0.55, 0.27), 2 * math.pi**2 * 0.55 * 0.27**2),
}


@pytest.mark.parametrize("mix", ["one level", "two levels", "three levels"])
@pytest.mark.parametrize("solid", SOLIDS)
def test_volume_and_distance_converge_at_second_order(solid: str, mix: str):
    sdf, exact = SOLIDS[solid]
    errors, distances = [], []
    for cells in (14, 28, 56):
        grid = grid_over_box(torch.ones(3), cells=cells)
        seeds = discover(sdf, grid, 0)
        tree = tree_around(grid, seeds)
        if mix != "one level":
            beyond = seeds[unpack_ijk(seeds)[:, 0] >= grid.shape[0] // 2]
            tree = tree_around(grid, cells_at_level(beyond, 1 if mix == "two levels" else 2))
        band = track_octree(sampler(sdf, grid, torch.float64), tree, seeds)
        surface = octree_surface(band, "diagonal").surface
        errors.append(abs(signed_volume(surface.vertices, surface.faces) - exact))
        distances.append(float(sdf(surface.vertices[surface.faces].mean(dim=1)).abs().mean()))
    for measured in (errors, distances):
        assert measured[0] / measured[1] > 3.2
        assert measured[1] / measured[2] > 3.2


# ----------------------------------------------------------------------------------------------------------------- keys


def test_faces_away_from_the_change_keep_their_keys_and_places():
    grid = grid_over_box(torch.ones(3), cells=24)
    sdf = torus_sdf(0.5, 0.2)
    seeds = discover(sdf, grid, 0)
    before = octree_surface(track_octree(sampler(sdf, grid), tree_around(grid, seeds), seeds), "diagonal").surface
    chosen = seeds[:40]
    tree = split(balanced(grid, chosen[:0]), chosen)
    band = track_octree(sampler(sdf, grid), tree, seeds)
    after = octree_surface(band, "diagonal").surface
    assert 0 < int((levels_of(band.cells) == 1).sum()) < len(band.cells)
    order = after.face_keys.argsort()
    row, kept = find(after.face_keys[order], before.face_keys)
    old, new = before.vertices[before.faces[kept]], after.vertices[after.faces[order[row[kept]]]]
    same = (old == new).all(dim=2).all(dim=1)
    assert float(kept.float().mean()) > 0.9
    assert float(same.float().mean()) > 0.95
    # The others lie at the border: a kept face has moved a little, none has turned round.
    normals = [torch.linalg.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (old, new)]
    assert bool(((normals[0] * normals[1]).sum(dim=1) > 0).all())
