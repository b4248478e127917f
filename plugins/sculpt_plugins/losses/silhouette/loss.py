"""Coverage difference (paper, 3.3: the silhouette mask loss)."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.losses import ImageLoss, Target
from sculpt_framework.types import Rendering


class Silhouette(ImageLoss):
    """Mean over pixels of |alpha - mask|; 0 where the image has no mask."""

    outline = True

    def __call__(self, rendering: Rendering, target: Target) -> Float[Tensor, ""]:
        if target.alpha is None:
            return rendering.alpha.new_zeros(())
        return (rendering.alpha - target.alpha).abs().mean()
