"""Colour difference (paper, eq. 12)."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.losses import ImageLoss, Target, TrainingImage
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.types import Rendering
from sculpt_plugins.losses.photometric.config import PhotometricConfig


class Photometric(ImageLoss):
    """With light per image, what is rendered of the object is brightened or tinted as that image is, before it is
    compared: c (1 + g) + o alpha over the same background, g and o of the image and channel."""

    inner = True

    def __init__(self, config: PhotometricConfig):
        self._config = config
        self._numbers: dict[str, int] = {}
        self._light: nn.Parameter | None = None
        """Gain less one, and offset: images x 2 x channels."""

    def begin(self, images: Sequence[TrainingImage]) -> None:
        if self._config.light == "one" or self._light is not None:
            return
        self._numbers = {image.name: number for number, image in enumerate(images)}
        self._light = nn.Parameter(torch.zeros(len(images), 2, 3, device=images[0].premultiplied.device))

    def parameter_groups(self) -> Sequence[ParameterGroup]:
        return () if self._light is None else [ParameterGroup(parameters=[self._light], rate=self._config.light_rate)]

    def __call__(self, rendering: Rendering, target: Target) -> Float[Tensor, ""]:
        if self._light is None:
            return l1_dssim(rendering.rgb, target.rgb, self._config.dssim)
        gain, offset = own = self._light[self._numbers[target.name]].to(rendering.rgb)
        alpha = rendering.alpha[..., None]
        lit = rendering.rgb if target.background is None else rendering.rgb - (1 - alpha) * target.background
        made = rendering.rgb + gain * lit + offset * alpha
        return l1_dssim(made, target.rgb, self._config.dssim) + self._config.light_prior * own.square().mean()
