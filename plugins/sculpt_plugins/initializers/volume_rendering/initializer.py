"""Volume rendering within the visual hull."""

from collections.abc import Iterator, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework import registry
from sculpt_framework.config import FieldConfig
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.posed_images.training_images import prepare_images
from sculpt_framework.shape_from_images.field_fit import fit_field
from sculpt_framework.shape_from_images.volume import Volume, sample
from sculpt_framework.shape_from_images.within_hull import within_hull
from sculpt_framework.types import Box, View
from sculpt_framework.volume_rendering.config import Passing, RadianceConfig, SdfShape, ShapeWeights
from sculpt_framework.volume_rendering.learner import VolumeLearner
from sculpt_framework.volume_rendering.logistic import LogisticVolume
from sculpt_framework.volume_rendering.pixels import Pixels
from sculpt_framework.volume_rendering.reconstructor import built_by_seed
from sculpt_plugins.initializers.volume_rendering.config import VolumeRenderingConfig

_HULL_STEPS = 60
_SHARES = (4, 2, 1)
"""Of the finest cells' number, how few there are in each third of the steps: a wide dent is found before a narrow one,
and what few views leave open stays smooth."""
_FIELD_RATE, _FINAL_RATE = 2.0, 0.03
"""Of the field's own rates, and of all at the end. Fast at first, since hulls of few views lie far outside, and slow at
the end, since what has settled is smooth."""
_WEIGHTS = ShapeWeights(eikonal=0.1, bending=5e-4)
"""Where few views look, much has the same colours; of that the least bent is believed."""
_SHARPNESS, _SHARPNESS_RATE = 60.0, 3e-3
_STEPS_ACROSS, _OCCUPIED_CELLS, _MASK_WEIGHT = 128, 64, 0.1
_BLOCK = 2
"""Cells along a side of the blocks that are looked at first: a learned distance is only roughly one."""


class VolumeRendering(Initializer):
    """Gradients through fog reach what is in front of the surface and behind it, so that it moves as far as it must;
    each pixel is explained, not compared with its neighbours: views may look from everywhere. What no view contradicts
    stays as the visual hull has it."""

    def __init__(self, config: VolumeRenderingConfig):
        self._config = config
        self._findings: dict[str, float] = {}

    @property
    def findings(self) -> Mapping[str, float]:
        """The mean absolute difference of colours at the end."""
        return self._findings

    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        def learned(masked: Sequence[View], solid: Volume) -> Volume:
            box = Box(minimum=-half_sides.cpu(), maximum=half_sides.cpu())
            return self._learned(Pixels(prepare_images(masked, box, 1.0, device)), solid, half_sides, device)

        return within_hull(views, half_sides, device, self._config.cells, self._config.max_views, learned)

    def _learned(self, images: Pixels, solid: Volume, half_sides: Float[Tensor, " 3"], device: torch.device) -> Volume:
        config, generator = self._config, torch.Generator().manual_seed(0)
        volume = built_by_seed(self._build, 0).to(device)
        volume.field.set_detail(2.0 * _SHARES[0] / config.cells)
        fit_field(volume.field, solid, steps=_HULL_STEPS, generator=generator, device=device)
        passing = Passing(rays=config.rays, steps_across=_STEPS_ACROSS, cells=_OCCUPIED_CELLS, mask_weight=_MASK_WEIGHT)
        learner = VolumeLearner(volume, passing, half_sides, generator)
        learner.look(afresh=True)
        for step in range(config.steps):
            volume.field.set_detail(2.0 * _SHARES[len(_SHARES) * step // config.steps] / config.cells)
            lesson = learner.learn(images, _FINAL_RATE ** (step / config.steps), step)
            self._findings = {"color_difference": lesson.terms["color"]}
        x, y, z = (float(side) for side in half_sides)
        with torch.no_grad():
            return sample(volume.field, (x, y, z), config.cells, device, block=_BLOCK)

    def _build(self) -> LogisticVolume:
        field = registry.default("field", "hash-grid")
        assert isinstance(field, FieldConfig)  # noqa: S101
        shape = SdfShape(
            field=field,
            field_rate=_FIELD_RATE,
            radiance=RadianceConfig(),
            weights=_WEIGHTS,
            mesh_cells=self._config.cells,
        )
        return LogisticVolume(shape, _SHARPNESS, _SHARPNESS_RATE)
