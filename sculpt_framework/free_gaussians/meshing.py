"""How a mesh is made of free Gaussians."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.free_gaussians.drawing import Drawing, on_white
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.shape_from_images.tsdf import fuse_renderings, surface_of
from sculpt_framework.spread import spread
from sculpt_framework.types import Camera, Gaussians, Surface

MOST_VIEWS = 40
"""Training views that a mesh is made from."""


class Mesher(ABC):
    """The same surface for the same Gaussians, however often it is asked."""

    @abstractmethod
    def surface(self, drawing: Drawing, gaussians: Gaussians, cameras: Sequence[Camera]) -> Surface:
        """Closed and outward; Gaussians, surface and the training views' cameras in the object frame.

        Raises EmptySurfaceError where there is none.
        """


class FusedDepths(Mesher):
    """Depths that training views show, fused on a grid. What all images that show a place hide there is inside: the
    surface is closed by it."""

    def __init__(self, grid: Grid, extractor: ExtractorConfig, device: torch.device):
        self._grid, self._extractor, self._device = grid, extractor, device

    def surface(self, drawing: Drawing, gaussians: Gaussians, cameras: Sequence[Camera]) -> Surface:
        seen = ((camera, on_white(drawing, gaussians, camera)) for camera in spread(cameras, MOST_VIEWS))
        level, seeds = surface_of(fuse_renderings(seen, self._grid), self._grid, self._device)
        return self._extractor.build(self._grid, self._device).extract(level, seeds).surface
