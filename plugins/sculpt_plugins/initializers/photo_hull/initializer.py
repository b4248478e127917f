"""Carve the visual hull by plane-sweep stereo."""

import logging
from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.shape_from_images.closing import close_cones, close_unseen
from sculpt_framework.shape_from_images.depth_maps import SweepOptions, find_depths, refine_depths
from sculpt_framework.shape_from_images.fusion import carve
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.shape_from_images.packing import pack_views
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.types import View
from sculpt_plugins.initializers.photo_hull.config import PhotoHullConfig


class PhotoHull(Initializer):
    """Deep hollows that no silhouette shows are out of reach of the gradients of an opaque surface; views side by side
    show them at once. Where colours say nothing, or the views stand too far apart, this is the visual hull."""

    def __init__(self, config: PhotoHullConfig):
        self._config = config

    @property
    def silhouette_first(self) -> bool:
        return False

    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        config = self._config
        hull = visual_hull(views, config.max_views, device)
        yield hull
        x, y, z = (float(side) for side in half_sides)
        sampled = sample(hull, (x, y, z), config.cells, device)
        masked = [view for view in views if view.alpha is not None]
        chosen = masked[:: max(1, -(-len(masked) // config.max_views))]
        # Before depths are looked for: in a mirror on the ground, what stands on it is seen once more, below.
        cameras = [view.camera for view in chosen]
        solid = close_cones(sampled, cameras)
        packed = pack_views(chosen, config.pixels / 2)
        options = SweepOptions(
            views=config.maps,
            depths=config.depths,
            neighbours=config.neighbours,
            best_of=config.best_of,
            ambiguity=config.ambiguity,
            agreeing=config.agreeing,
        )
        maps = find_depths(packed, solid, options)
        shape = solid
        if maps.known == 0.0:
            why = "no views stand close enough to each other to compare their colours: start from the visual hull"
            logging.getLogger("sculpt").info(why)
        else:
            for level in range(config.refinements):
                finer = pack_views(chosen, float(2**level * config.pixels))
                packed, maps = finer, refine_depths(finer, packed, maps, options)
            shape = carve(solid, packed, maps, config.margin * maps.step)
        shape = close_unseen(shape, cameras)
        if shape is sampled:
            return
        yield shape.within(hull, device)
