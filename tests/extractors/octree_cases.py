"""Random octrees, random fields, and what an octree's surface must be by plain enumeration."""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from sculpt_framework.geometry.band import WALL_SDF, CornerSampler, cells_at_level, levels_of
from sculpt_framework.geometry.grid import Grid, pack, unpack_ijk
from sculpt_framework.geometry.octree import Octree, balanced, leaves, split, tree_around, vertex_level
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.testing import box_sdf, sphere_sdf, torus_sdf, union_sdf

NOTHING = torch.empty(0, dtype=torch.int64)


def box_grid(shape: tuple[int, int, int], level: int = 0) -> Grid:
    """A grid round the origin whose longest side is 2."""
    cell = 2 / max(shape)
    origin = (-0.5 * shape[0] * cell, -0.5 * shape[1] * cell, -0.5 * shape[2] * cell)
    return Grid(origin=origin, base_shape=shape, base_cell=cell, level=level)


def sampler(sdf: SdfFunction, grid: Grid, dtype: torch.dtype = torch.float32) -> CornerSampler:
    """Samples of an sdf at vertices of an octree."""
    finest = grid.at_level(vertex_level(grid))

    def sample(vertices: Tensor) -> tuple[Tensor, Tensor]:
        positions = finest.corner_positions(unpack_ijk(vertices), dtype)
        return positions, sdf(positions)

    return sample


def random_tree(grid: Grid, random: np.random.Generator, depth: int) -> Octree:
    """Splits at a few random places down to random levels, and of random leaves anywhere."""
    tree = balanced(grid, NOTHING)
    for _ in range(random.integers(1, 5)):
        cell = pack(grid.level, torch.tensor([[random.integers(n) for n in grid.shape]]))
        for _ in range(random.integers(1, depth + 1)):
            descendants = cells_at_level(cell, 1)
            cell = descendants[random.integers(8)][None]
        tree = split(tree, tree_around(grid, cell).split_cells)
    share = random.choice([0.0, 0.1, 0.4])
    candidates = leaves(tree)
    candidates = candidates[levels_of(candidates) < grid.level + depth]
    return split(tree, candidates[torch.from_numpy(random.random(len(candidates)) < share)])


def halves(grid: Grid, finer: int, axis: int = 0, leave: float = 0.5) -> Octree:
    """All cells beyond the share ``leave`` of an axis split ``finer`` times."""
    ijk = torch.cartesian_prod(*(torch.arange(n) for n in grid.shape))
    cells = pack(grid.level, ijk[ijk[:, axis] >= leave * grid.shape[axis]])
    return tree_around(grid, cells_at_level(cells, finer))


# --------------------------------------------------------------------------------------------------------------- fields


def hashed(points: Tensor, seed: int) -> Tensor:
    """Uniform noise in [0, 1), a value of its own at each place to 2^-14 or so."""
    quantised = (points.detach().double() * 8192).round().long()
    x, y, z = quantised.unbind(dim=1)
    mixed = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791) ^ (seed * 2654435761)
    for _ in range(3):
        mixed = (mixed ^ (mixed >> 15)) * 0x2C1B3C6D % (1 << 48)
    return ((mixed >> 8) % 65536 / 65536.0).to(points.dtype)


def _noise(random: np.random.Generator, cell: float) -> SdfFunction:
    """A sign of its own at every vertex."""
    seed, share, levels = int(random.integers(1 << 20)), random.uniform(0.1, 0.9), random.choice([0, 1, 3])

    def sdf(points: Tensor) -> Tensor:
        value = hashed(points, seed) - share
        # Rounding makes many exact zeros, and many equal values.
        return ((value * levels).round() / levels if levels else value).to(points.dtype)

    return sdf


def _waves(random: np.random.Generator, cell: float) -> SdfFunction:
    """A sum of waves not much longer than a cell."""
    frequency = torch.from_numpy(random.normal(size=(12, 3)) * random.uniform(0.3, 1.5) / cell)
    phase = torch.from_numpy(random.uniform(0, 2 * math.pi, size=12))
    level = random.uniform(-1, 1)

    def sdf(points: Tensor) -> Tensor:
        return (torch.sin(points.double() @ frequency.T + phase).sum(dim=1) + level).to(points.dtype) * cell

    return sdf


def _checkers(random: np.random.Generator, cell: float) -> SdfFunction:
    """Saddles about the size of a root's faces: diagonal corners alike, every other way."""
    pitch = torch.from_numpy(random.uniform(0.8, 1.2, size=3)) * math.pi / cell * random.choice([0.5, 1.0])
    phase = torch.from_numpy(random.uniform(0, 2 * math.pi, size=3))
    level = random.uniform(-0.3, 0.3)

    def sdf(points: Tensor) -> Tensor:
        return (torch.sin(points.double() * pitch + phase).prod(dim=1) + level).to(points.dtype) * cell

    return sdf


def _solids(random: np.random.Generator, cell: float) -> SdfFunction:
    """Spheres, tori and boxes, joined, cut out of each other and intersected."""

    def solid() -> SdfFunction:
        kind = random.integers(3)
        if kind == 0:
            return sphere_sdf(random.uniform(0.2, 0.8))
        if kind == 1:
            return torus_sdf(random.uniform(0.3, 0.6), random.uniform(0.1, 0.3))
        # Often with faces exactly on vertices.
        sides = np.round(random.uniform(0.2, 0.9, size=3) / cell * 2) * cell / 2 + cell / 2
        return box_sdf((sides[0], sides[1], sides[2]))

    parts = [(solid(), torch.from_numpy(random.uniform(-0.5, 0.5, size=3)), random.integers(3)) for _ in range(3)]

    def sdf(points: Tensor) -> Tensor:
        value = torch.full_like(points[:, 0], math.inf)
        for part, center, operation in parts:
            other = part(points - center.to(points))
            first = bool(torch.isinf(value).all())
            if operation == 0 or first:
                value = torch.minimum(value, other)
            else:
                value = torch.maximum(value, -other if operation == 1 else other)
        return value

    return sdf


FIELDS: dict[str, Callable[[np.random.Generator, float], SdfFunction]] = {
    "noise": _noise,
    "waves": _waves,
    "checkers": _checkers,
    "solids": _solids,
}

DOUBLE_TORUS = union_sdf(torus_sdf(0.3, 0.12, (-0.36, 0.0, 0.0)), torus_sdf(0.3, 0.12, (0.36, 0.0, 0.0)))


# ---------------------------------------------------------------------------------------------------- plain enumeration

Place = tuple[int, int, int]


def plain_leaves(tree: Octree) -> list[tuple[Place, int]]:
    """Corner 0 and side of every leaf, in units of the finest vertices."""
    cells = leaves(tree)
    finest = vertex_level(tree.grid)
    sides = (1 << (finest - levels_of(cells))).tolist()
    return [((i * s, j * s, k * s), s) for (i, j, k), s in zip(unpack_ijk(cells).tolist(), sides, strict=True)]


def plain_minimal_edges(tree: Octree, sdf: SdfFunction) -> dict[tuple[Place, int], int]:
    """Every edge of a leaf without a vertex between its ends, which differ in sign: lower end and axis; its length."""
    places = plain_leaves(tree)
    vertices: set[Place] = set()
    edges: set[tuple[Place, int, int]] = set()
    for (x, y, z), s in places:
        for n in range(8):
            vertices.add((x + s * (n & 1), y + s * (n >> 1 & 1), z + s * (n >> 2)))
        for axis in range(3):
            for n in range(8):
                if not n >> axis & 1:
                    edges.add(((x + s * (n & 1), y + s * (n >> 1 & 1), z + s * (n >> 2)), axis, s))
    finest = tree.grid.at_level(vertex_level(tree.grid))
    ordered = sorted(vertices)
    values = sdf(finest.corner_positions(torch.tensor(ordered), torch.float32))
    wall = finest.on_wall(torch.tensor(ordered))
    values = torch.where(wall, values.clamp(min=WALL_SDF * tree.grid.cell), values)
    inside = dict(zip(ordered, (values < 0).tolist(), strict=True))

    def moved(place: Place, axis: int, by: int) -> Place:
        x, y, z = (p + by * (a == axis) for a, p in enumerate(place))
        return x, y, z

    return {
        (lower, axis): length
        for lower, axis, length in edges
        if inside[lower] != inside[moved(lower, axis, length)] and moved(lower, axis, length // 2) not in vertices
    }
