"""The surface of a level of the density: points along lines of sight, then Poisson reconstruction (SuGaR, 4.2)."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.export.ply import encode_ply
from sculpt_framework.free_gaussians.closing import closed_surface, is_closed
from sculpt_framework.free_gaussians.drawing import Drawing, on_white
from sculpt_framework.free_gaussians.meshing import MOST_VIEWS, Mesher
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.posing.colmap import require_pycolmap
from sculpt_framework.rendering.depth_normals import pixel_rays
from sculpt_framework.spread import spread
from sculpt_framework.types import Camera, Gaussians, Surface
from sculpt_plugins.methods.sugar.config import SugarConfig
from sculpt_plugins.methods.sugar.density import density_at, neighbours

_COVERED = 0.5
"""Opacity of a pixel from which on it has a depth."""
_REACH = 3.0
"""Standard deviations before and behind the depth, between which the level is looked for (4.2)."""
_ALONG = 21
"""Places there at which the density is asked for (program)."""
_FEWEST = 100
"""Points that a surface is made of."""
_CHUNK = 10_000
"""Rays at a time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedPoints:
    positions: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]
    """Unit, outward."""


class PoissonMesher(Mesher):
    """Where Poisson's surface is not closed, as at a side of its box that no point lies near, it is made so on the
    grid: ``closed_surface``."""

    def __init__(self, config: SugarConfig, grid: Grid, device: torch.device):
        require_pycolmap("the mesh of sugar", "take another method, as splatting-2d")
        self._config, self._grid, self._device = config, grid, device

    def surface(self, drawing: Drawing, gaussians: Gaussians, cameras: Sequence[Camera]) -> Surface:
        points = self._points(drawing, gaussians, cameras)
        if len(points.positions) < _FEWEST:
            raise EmptySurfaceError(f"{len(points.positions)} points have a density of {self._config.poisson.level:g}")
        mesh = poisson(points, self._config.poisson.depth)
        if not is_closed(mesh):
            return closed_surface(mesh, self._grid, self._config.extractor, self._device)
        return Surface(
            vertices=torch.from_numpy(mesh.vertices),
            faces=torch.from_numpy(mesh.faces),
            face_keys=torch.arange(len(mesh.faces)),
        )

    def _points(self, drawing: Drawing, gaussians: Gaussians, cameras: Sequence[Camera]) -> OrientedPoints:
        chosen, level = spread(cameras, MOST_VIEWS), self._config.poisson.level
        # The same at each call, so that a mesh can be asked for at any time.
        generator = torch.Generator().manual_seed(self._config.seed)
        found = []
        for camera in chosen:
            rendering = on_white(drawing, gaussians, camera)
            rows, columns = (rendering.alpha > _COVERED).nonzero().unbind(dim=1)
            count = min(len(rows), -(-self._config.poisson.points // len(chosen)))
            pick = torch.randperm(len(rows), generator=generator)[:count].to(rows.device)
            rows, columns = rows[pick], columns[pick]
            depth = rendering.depth[rows, columns] / rendering.alpha[rows, columns]
            rays = pixel_rays(camera, depth)[rows, columns]
            sight = rays @ camera.world_to_camera[:3, :3].to(rays)
            places = camera.position.to(rays) + depth[:, None] * sight
            sight = torch.nn.functional.normalize(sight, dim=1)
            found += [
                level_points(gaussians, places[first : first + _CHUNK], sight[first : first + _CHUNK], level)
                for first in range(0, count, _CHUNK)
            ]
        if not found:
            raise EmptySurfaceError("no view shows a Gaussian")
        return OrientedPoints(
            positions=torch.cat([each.positions for each in found]), normals=torch.cat([each.normals for each in found])
        )


@torch.no_grad()
def level_points(
    gaussians: Gaussians, places: Float[Tensor, "n 3"], sight: Float[Tensor, "n 3"], level: float
) -> OrientedPoints:
    """Where the density first rises to the level along unit lines of sight, within three standard deviations of the
    Gaussian each place belongs to: by linear interpolation between two of the places asked. At most one a line."""
    near = neighbours(gaussians, places)
    best = density_at(gaussians, places, near).best
    spread_along = (torch.einsum("nij,ni->nj", gaussians.rotations[best], sight) * gaussians.scales[best]).norm(dim=1)
    steps = torch.linspace(-_REACH, _REACH, _ALONG).to(places) * spread_along[:, None]
    densities = torch.stack(
        [density_at(gaussians, places + step[:, None] * sight, near).density for step in steps.unbind(dim=1)], dim=1
    )
    rises = (densities[:, :-1] < level) & (densities[:, 1:] >= level)
    lines = rises.any(dim=1).nonzero()[:, 0]
    at = rises[lines].long().argmax(dim=1)
    below, above = densities[lines, at], densities[lines, at + 1]
    share = (level - below) / (above - below)
    along = torch.lerp(steps[lines, at], steps[lines, at + 1], share)
    points = places[lines] + along[:, None] * sight[lines]
    slope = density_at(gaussians, points, near[lines]).slope
    length = slope.norm(dim=1)
    # A slope of 0 has no direction.
    steep = (length > 0) & torch.isfinite(length)
    return OrientedPoints(positions=points[steep], normals=-slope[steep] / length[steep, None])


def poisson(points: OrientedPoints, depth: int) -> Mesh:
    """The Poisson surface, by the library; it reaches the library's box where no point lies near.

    On one thread: more give other last digits each time.
    """
    import pycolmap

    options = pycolmap.PoissonMeshingOptions()
    # Without colour, and whole: nothing is trimmed off where points are few.
    options.depth, options.trim, options.color, options.num_threads = depth, 0.0, False, 1
    columns = torch.cat([points.positions, points.normals], dim=1).float().cpu().numpy()
    rows = np.zeros(len(columns), dtype=[(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")])
    for number, name in enumerate(rows.dtype.names or ()):
        rows[name] = columns[:, number]
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "points.ply", Path(folder) / "mesh.ply"
        given.write_bytes(encode_ply([("vertex", rows)]))
        pycolmap.poisson_meshing(given, made, options)
        return load_mesh(made)
