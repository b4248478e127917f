"""The opacity of places: the least that any training view has up to them (Yu et al. 2024, eq. 10)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64

from sculpt_framework.cpu_kernels import array_of, share_threads
from sculpt_framework.export.mesh_pixels import lens_values
from sculpt_framework.free_gaussians.tiles import TileLists
from sculpt_framework.types import Camera, Gaussians
from sculpt_plugins.methods.gof.rays import kernels, seen_by


@dataclass(frozen=True, kw_only=True, eq=False)
class _View:
    camera: Camera
    forms: Float64[np.ndarray, "g 10"]
    """Of ``Seen``."""
    opacities: Float64[np.ndarray, " g"]
    limits: Float64[np.ndarray, " g"]
    tiles: TileLists


class OpacityField:
    @torch.no_grad()
    def __init__(self, gaussians: Gaussians, cameras: Sequence[Camera], smoothing: float):
        self._views = []
        for camera in cameras:
            seen = seen_by(gaussians, camera, smoothing)
            self._views.append(
                _View(
                    camera=camera,
                    forms=array_of(seen.forms),
                    opacities=array_of(seen.opacities.double()),
                    limits=array_of(seen.limits),
                    tiles=seen.tiles(camera),
                )
            )

    def at(self, points: Float64[np.ndarray, "n 3"], enough: float) -> Float64[np.ndarray, " n"]:
        """Whether the opacity is ``enough``: where it is not, that of the first view found to have less; else what was
        found to be enough. 0 of a place that no image shows."""
        share_threads()
        least, seen = np.ones(len(points)), np.zeros(len(points), bool)
        for view in self._views:
            camera, tiles = view.camera, view.tiles
            size = np.array([camera.width, camera.height], np.float64)
            kernels.lower(
                camera.local(points), enough, view.forms, view.opacities, view.limits, lens_values(camera), size,
                tiles.lists, tiles.starts, tiles.columns, least, seen,
            )  # fmt: skip
        return np.where(seen, least, 0.0)
