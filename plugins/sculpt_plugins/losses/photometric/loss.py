"""Colour difference (paper, eq. 11)."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.losses import ImageLoss, Target
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.types import Rendering


class Photometric(ImageLoss):
    inner = True

    def __init__(self, dssim: float):
        self._dssim = dssim

    def __call__(self, rendering: Rendering, target: Target) -> Float[Tensor, ""]:
        return l1_dssim(rendering.rgb, target.rgb, self._dssim)
