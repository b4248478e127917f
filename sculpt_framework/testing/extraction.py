"""Shapes with known answers, and what every extractor must keep to."""

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from sculpt_framework.config import (
    ExtractorConfig,
)
from sculpt_framework.extractors import Extraction
from sculpt_framework.geometry.band import children, discover
from sculpt_framework.geometry.grid import Grid, grid_over_box
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.geometry.topology import (
    boundary_edges,
    components,
    euler_characteristic,
    is_consistently_oriented,
    is_edge_manifold,
    is_vertex_manifold,
    signed_volume,
)
from sculpt_framework.types import Surface


class ContractViolation(AssertionError):
    """A component does not do what its slot promises."""


def require(condition: bool | np.bool_, message: str) -> None:
    """Raise ContractViolation with the message unless the condition holds."""
    if not condition:
        raise ContractViolation(message)


# --------------------------------------------------------------------------------------------------------------- shapes


def sphere_sdf(radius: float = 0.6, center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> SdfFunction:
    """Exact distance to a sphere."""

    def sdf(points: Tensor) -> Tensor:
        return torch.linalg.vector_norm(points - points.new_tensor(center), dim=1) - radius

    return sdf


def torus_sdf(
    ring: float = 0.55, tube: float = 0.22, center: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> SdfFunction:
    """Exact distance to a torus round the z axis."""

    def sdf(points: Tensor) -> Tensor:
        x, y, z = (points - points.new_tensor(center)).unbind(dim=1)
        return torch.hypot(torch.hypot(x, y) - ring, z) - tube

    return sdf


def box_sdf(half_sides: tuple[float, float, float] = (0.5, 0.6, 0.4)) -> SdfFunction:
    """Exact distance to an axis-aligned box round the origin."""

    def sdf(points: Tensor) -> Tensor:
        beyond = points.abs() - points.new_tensor(half_sides)
        outside = torch.linalg.vector_norm(beyond.clamp(min=0), dim=1)
        return outside + beyond.amax(dim=1).clamp(max=0)

    return sdf


def union_sdf(*parts: SdfFunction) -> SdfFunction:
    """Distance to several shapes at once: exact outside, a bound inside where they overlap."""

    def sdf(points: Tensor) -> Tensor:
        return torch.stack([part(points) for part in parts]).amin(dim=0)

    return sdf


# ----------------------------------------------------------------------------------------------------------- extractors


def check_surface(surface: Surface) -> None:
    """Require a closed, manifold, outward-oriented mesh without repeated faces and with distinct keys."""
    faces = surface.faces.cpu().numpy()
    vertices = surface.vertices.detach()
    require(bool(torch.isfinite(vertices).all()), "vertices are not finite")
    require(len(faces) > 0, "there are no faces")
    require(faces.min() >= 0 and faces.max() < len(vertices), "faces name vertices that do not exist")
    require(len(np.unique(faces)) == len(vertices), "some vertices belong to no face")
    require((faces != np.roll(faces, 1, axis=1)).all(), "a face has the same vertex twice")
    require(len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces), "a face is repeated")
    require(len(boundary_edges(faces)) == 0, f"the mesh is open: {len(boundary_edges(faces))} edges have one face")
    require(is_edge_manifold(faces), "an edge has more than two faces")
    require(is_vertex_manifold(faces), "the faces at a vertex form more than one fan")
    require(is_consistently_oriented(faces), "two faces pass an edge in the same direction")
    require(len(surface.face_keys.unique()) == len(faces), "face keys are not distinct")


def check_extraction(extraction: Extraction) -> None:
    """Require a valid surface and a band that is consistent with itself."""
    check_surface(extraction.surface)
    cells, rows = extraction.cells, extraction.cell_corners
    require(bool((cells[1:] > cells[:-1]).all()), "cells are not in ascending order")
    inside = extraction.corner_sdf.detach()[rows] < 0
    require(bool((inside.any(dim=1) & ~inside.all(dim=1)).all()), "a cell of the band has no sign change")
    edges = extraction.edge_sdf.detach()
    require(bool((edges[:, 0] < 0).all() & (edges[:, 1] >= 0).all()), "edge_sdf is not (inside, outside)")
    low = torch.tensor(extraction.grid.origin, dtype=torch.float64)
    high = low + torch.tensor(extraction.grid.shape, dtype=torch.float64) * extraction.grid.cell
    vertices = extraction.surface.vertices.detach().double().cpu()
    slack = 1e-5 * float((high - low).max())
    require(bool(((vertices >= low - slack) & (vertices <= high + slack)).all()), "vertices leave the grid")


def kept_faces(before: Surface, after: Surface) -> tuple[Tensor, Tensor]:
    """Rows, before and after, of the faces whose key is in both surfaces."""
    common = before.face_keys[torch.isin(before.face_keys, after.face_keys)].sort().values
    old_keys, old = before.face_keys.sort()
    new_keys, new = after.face_keys.sort()
    return old[torch.searchsorted(old_keys, common)], new[torch.searchsorted(new_keys, common)]


def _analytic_cases() -> Iterator[tuple[str, SdfFunction, int, int, float]]:
    """Name, sdf, components, Euler characteristic and enclosed volume."""
    pi = torch.pi
    yield "sphere", sphere_sdf(0.61), 1, 2, 4 / 3 * pi * 0.61**3
    yield "torus", torus_sdf(0.55, 0.22), 1, 0, 2 * pi**2 * 0.55 * 0.22**2
    pair = union_sdf(sphere_sdf(0.3, (-0.4, 0.0, 0.05)), sphere_sdf(0.27, (0.45, 0.1, 0.0)))
    yield "two spheres", pair, 2, 4, 4 / 3 * pi * (0.3**3 + 0.27**3)
    yield "box", box_sdf((0.47, 0.61, 0.39)), 1, 2, 8 * 0.47 * 0.61 * 0.39


def check_extractor(config: ExtractorConfig, device: torch.device | None = None) -> None:
    """Check the contract of slot ``extractor`` on analytic shapes; takes a second or two."""
    device = device or torch.device("cpu")
    grid = grid_over_box(torch.tensor([1.0, 0.9, 0.7]), cells=12, level=1)
    for name, sdf, pieces, euler, volume in _analytic_cases():
        extraction = config.build(grid, device).extract(sdf, discover(sdf, grid, 0, device=device))
        check_extraction(extraction)
        faces = extraction.surface.faces
        require(components(faces)[0] == pieces, f"{name}: {components(faces)[0]} components instead of {pieces}")
        require(euler_characteristic(faces) == euler, f"{name}: Euler characteristic is not {euler}")
        enclosed = signed_volume(extraction.surface.vertices, faces)
        require(abs(enclosed / volume - 1) < 0.1, f"{name}: encloses {enclosed:.4f} instead of {volume:.4f}")
    _check_tracking(config, grid, device)
    _check_keys(config, grid, device)
    _check_gradient(config, grid, device)
    _check_levels(config, grid, device)
    _check_extremes(config, grid, device)


def _check_tracking(config: ExtractorConfig, grid: Grid, device: torch.device) -> None:
    sdf = torus_sdf()
    extractor = config.build(grid, device)
    seeds = discover(sdf, grid, 0, device=device)
    full = extractor.extract(sdf, seeds)
    one = config.build(grid, device).extract(sdf, full.cells[:1])
    require(torch.equal(full.cells, one.cells), "from one seed cell the surface is not followed all round")
    again = extractor.extract(sdf, full.cells)
    same = torch.equal(full.surface.faces, again.surface.faces) and torch.equal(
        full.surface.face_keys, again.surface.face_keys
    )
    require(same and torch.equal(full.surface.vertices, again.surface.vertices), "extracting twice gives two surfaces")


def _check_keys(config: ExtractorConfig, grid: Grid, device: torch.device) -> None:
    extractor = config.build(grid, device)
    before = extractor.extract(sphere_sdf(0.61), discover(sphere_sdf(0.61), grid, 0, device=device))
    after = extractor.extract(sphere_sdf(0.61 + 0.02 * grid.cell), before.cells)
    old, new = kept_faces(before.surface, after.surface)
    share = len(old) / len(before.surface.faces)
    require(share > 0.8, f"only {share:.0%} of the face keys survive a shift by 2 % of a cell")
    moved = (
        before.surface.vertices[before.surface.faces[old]] - after.surface.vertices[after.surface.faces[new]]
    ).detach()
    distance = torch.linalg.vector_norm(moved, dim=2) / grid.cell
    # A crossing on an edge that grazes the surface may run along all of it, but hardly any does.
    require(float(distance.max()) < 3**0.5, f"a corner of a kept face moved by {float(distance.max()):.2f} cells")
    require(float(distance.mean()) < 0.05, f"kept faces moved by {float(distance.mean()):.2f} cells on average")


def _check_gradient(config: ExtractorConfig, grid: Grid, device: torch.device) -> None:
    shift = torch.zeros((), device=device, requires_grad=True)

    def sdf(points: Tensor) -> Tensor:
        return sphere_sdf(0.6)(points) - shift

    seeds = discover(sdf, grid, 0, device=device)
    vertices = config.build(grid, device).extract(sdf, seeds).surface.vertices
    (slope,) = torch.autograd.grad(torch.linalg.vector_norm(vertices, dim=1).mean(), [shift])
    require(abs(float(slope) - 1) < 0.05, f"the mean radius grows by {float(slope):.3f} per unit of offset, not by 1")


def _check_levels(config: ExtractorConfig, grid: Grid, device: torch.device) -> None:
    sdf = sphere_sdf(0.6)
    extractor = config.build(grid, device)
    coarse = extractor.extract(sdf, discover(sdf, grid, 0, device=device))
    extractor.set_grid(grid.at_level(grid.level + 1))
    require(extractor.grid.level == grid.level + 1, "set_grid does not change the grid")
    fine = extractor.extract(sdf, children(coarse.cells))
    check_extraction(fine)
    require(not torch.isin(fine.surface.face_keys, coarse.surface.face_keys).any(), "levels share face keys")


def _check_extremes(config: ExtractorConfig, grid: Grid, device: torch.device) -> None:
    def everywhere(value: float) -> Callable[[Tensor], Tensor]:
        return lambda points: torch.full_like(points[:, 0], value)

    seeds = discover(everywhere(0.0), grid, grid.level, device=device)
    for value in (1.0, 0.0):
        try:
            config.build(grid, device).extract(everywhere(value), seeds)
        except EmptySurfaceError:
            continue
        raise ContractViolation(f"an sdf of {value} everywhere raises no EmptySurfaceError")
    check_extraction(config.build(grid, device).extract(everywhere(-1.0), seeds))

    values = torch.full((1,), 1e-30, device=device, requires_grad=True)

    def stiff(points: Tensor) -> Tensor:
        """A surface whose sdf is nearly zero on both of its sides."""
        return values * torch.sign(points[:, 0] + 0.25 * grid.cell) + 0.0 * points[:, 1]

    vertices = config.build(grid, device).extract(stiff, seeds).surface.vertices
    (slope,) = torch.autograd.grad(vertices.sum(), [values])
    require(bool(torch.isfinite(slope).all()), "a nearly vanishing sdf gives a gradient that is not finite")
