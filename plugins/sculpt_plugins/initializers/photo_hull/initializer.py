"""Carve the visual hull by plane-sweep stereo."""

import logging
from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.shape_from_images.depth_maps import SweepOptions, find_depths, refine_depths
from sculpt_framework.shape_from_images.fusion import carve
from sculpt_framework.shape_from_images.packing import pack_views
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.shape_from_images.within_hull import within_hull
from sculpt_framework.types import View
from sculpt_plugins.initializers.photo_hull.config import PhotoHullConfig

_MARGIN = 0.7
"""What is less deep below the hull is left alone, in steps of depth: no depth is more exact."""


class PhotoHull(Initializer):
    """Deep hollows that no silhouette shows are out of reach of the gradients of an opaque surface; views side by side
    show them at once. Where colours say nothing, or the views stand too far apart, this is the visual hull."""

    def __init__(self, config: PhotoHullConfig):
        self._config = config

    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        config = self._config
        return within_hull(views, half_sides, device, config.cells, config.max_views, self._carved)

    def _carved(self, views: Sequence[View], solid: Volume) -> Volume:
        config = self._config
        packed = pack_views(views, config.pixels / 2)
        options = SweepOptions(
            views=config.maps,
            depths=config.depths,
            neighbours=config.neighbours,
            agreeing=config.agreeing,
        )
        maps = find_depths(packed, solid, options)
        if maps.known == 0.0:
            why = "no views stand close enough to each other to compare their colours: start from the visual hull"
            logging.getLogger("sculpt").info(why)
            return solid
        for level in range(config.refinements):
            finer = pack_views(views, float(2**level * config.pixels))
            packed, maps = finer, refine_depths(finer, packed, maps, options)
        return carve(solid, packed, maps, _MARGIN * maps.step)
