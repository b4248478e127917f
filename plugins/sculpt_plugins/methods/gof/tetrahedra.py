"""A level of the opacity field in tetrahedra that have their corners at Gaussians (Yu et al. 2024)."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float64
from scipy.spatial import Delaunay

from sculpt_framework.free_gaussians.drawing import Drawing
from sculpt_framework.free_gaussians.meshing import MOST_VIEWS, Mesher
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.geometry.tetrahedra import march_tetrahedra
from sculpt_framework.spread import spread
from sculpt_framework.types import Camera, Gaussians, Surface
from sculpt_plugins.methods.gof.config import GofConfig
from sculpt_plugins.methods.gof.opacity_field import OpacityField

_REACH = 3.0
"""Standard deviations from the centre of a Gaussian to the sides of its box (program)."""
_ROOM = 2.0
"""Half sides of the grid: there are corners, all outside, around everything."""
_JITTER = 1e-5
"""Object units: the corners of a box lie on a sphere, and those of a disk's in pairs, where tetrahedra are not unique
and may have no volume. Chance parts them."""


class OpacityMesher(Mesher):
    """Closed, as the outermost corners are outside. Corners in the grid's box are made use of, no other."""

    def __init__(self, config: GofConfig, grid: Grid):
        self._config, self._grid = config, grid

    @torch.no_grad()
    def surface(self, drawing: Drawing, gaussians: Gaussians, cameras: Sequence[Camera]) -> Surface:
        config = self._config
        field = OpacityField(gaussians, spread(cameras, MOST_VIEWS), config.smoothing)
        corners = self._corners(gaussians)
        tetrahedra = Delaunay(corners).simplices.astype(np.int64)
        inside = field.at(corners, config.level) >= config.level
        inside[:8] = False
        if not inside.any():
            raise EmptySurfaceError(f"no Gaussian has an opacity of {config.level:g} from all sides")
        cut = march_tetrahedra(corners, tetrahedra, inside)
        inner, outer = corners[cut.ends[:, 0]], corners[cut.ends[:, 1]]
        for _ in range(config.bisections):
            middle = 0.5 * (inner + outer)
            within = (field.at(middle, config.level) >= config.level)[:, None]
            inner, outer = np.where(within, middle, inner), np.where(within, outer, middle)
        return Surface(
            vertices=torch.from_numpy(0.5 * (inner + outer)),
            faces=torch.from_numpy(cut.faces),
            face_keys=torch.arange(len(cut.faces)),
        )

    def _corners(self, gaussians: Gaussians) -> Float64[np.ndarray, "n 3"]:
        """Those around everything, then centres and corners of Gaussians' boxes."""
        half = 0.5 * self._grid.cell * np.array(self._grid.shape)
        # The same at each call, so that a mesh can be asked for at any time.
        random = np.random.default_rng(self._config.seed)
        rows = np.arange(len(gaussians))
        if len(rows) > self._config.mesh_gaussians:
            rows = np.sort(random.choice(rows, self._config.mesh_gaussians, replace=False))
        signs = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij"), axis=-1).reshape(8, 3)
        means, sizes = (each.double().numpy()[rows] for each in (gaussians.means, gaussians.scales))
        axes = gaussians.rotations.double().numpy()[rows] * sizes[:, None]
        boxes = means[:, None] + _REACH * np.einsum("gij,cj->gci", axes, signs)
        points = np.concatenate([means[:, None], boxes], axis=1).reshape(-1, 3)
        points += _JITTER * random.standard_normal(points.shape)
        points = points[(np.abs(points) < half).all(axis=1)]
        return np.concatenate([_ROOM * half * signs, points])
