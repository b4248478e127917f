"""Multi-view stereo within the visual hull."""

import logging
from collections.abc import Iterator, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.multi_view_stereo.depth_maps import StereoOptions, find_depths
from sculpt_framework.multi_view_stereo.fusion import fuse
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.shape_from_images.within_hull import within_hull
from sculpt_framework.types import View
from sculpt_plugins.initializers.stereo.config import StereoConfig


class Stereo(Initializer):
    """Deep hollows that no silhouette shows are out of reach of the gradients of an opaque surface; views side by side
    show them at once. Where images say nothing, or the views stand too far apart, this is the visual hull."""

    def __init__(self, config: StereoConfig):
        self._config = config
        self._findings: dict[str, float] = {}

    @property
    def findings(self) -> Mapping[str, float]:
        """Share of the object's pixels that have a depth, and the mean confidence of these."""
        return self._findings

    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        config = self._config
        return within_hull(views, half_sides, device, config.cells, config.max_views, self._fused)

    def _fused(self, views: Sequence[View], solid: Volume) -> Volume:
        config = self._config
        options = StereoOptions(pixels=config.pixels, neighbours=config.neighbours, agreeing=config.agreeing)
        maps = find_depths(views, solid, options)
        self._findings = {"depths_known": maps.known, "confidence": maps.mean_confidence}
        if maps.known == 0.0:
            why = "no views stand close enough to each other to compare them: start from the visual hull"
            logging.getLogger("sculpt").info(why)
            return solid
        return fuse(solid, maps)
