"""The definition of what a rasteriser computes, as short as it can be said."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_framework.rendering.projection import project
from sculpt_framework.types import Camera
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig


class ReferenceRasterizer(Rasterizer):
    """Dense: all pixels against all Gaussians, any device and floating-point type, gradients by autograd.

    A Gaussian of which any projected value, opacity or feature is not finite is not drawn and gets zero gradients.
    """

    def __init__(self, config: ReferenceRasterizerConfig):
        self._pairs_at_once = config.pairs_at_once

    def rasterize(
        self,
        means: Float[Tensor, "g 3"],
        scales: Float[Tensor, "g 3"],
        rotations: Float[Tensor, "g 3 3"],
        opacities: Float[Tensor, " g"],
        features: Float[Tensor, "g c"],
        camera: Camera,
        background: Float[Tensor, " c"] | Float[Tensor, "h w c"],
        *,
        low_pass_px2: float,
        alpha_max: float,
    ) -> RasterOutput:
        order = _drawn_front_to_back(means, scales, rotations, opacities, features, camera, low_pass_px2)
        screen = project(means[order], scales[order], rotations[order], camera, low_pass_px2)
        # Depth travels as one more feature, over a background of zero.
        splat_features = torch.cat([features[order], screen.depths[:, None]], dim=1)
        splats = (screen.means, screen.conics, opacities[order], splat_features)

        centers = _pixel_centers(camera, means)
        rows = max(1, self._pairs_at_once // max(1, order.shape[0]))
        pieces = centers.split(rows)
        if len(pieces) == 1:
            sums, alpha = _composite(centers, *splats, alpha_max)
        else:
            # Recomputed in the backward pass, so that memory stays that of one piece.
            done = [checkpoint(_composite, piece, *splats, alpha_max, use_reentrant=False) for piece in pieces]
            sums, alpha = torch.cat([part[0] for part in done]), torch.cat([part[1] for part in done])
        image = sums.reshape(camera.height, camera.width, -1)
        alpha = alpha.reshape(camera.height, camera.width)
        behind = (1.0 - alpha)[..., None] * background.detach()
        return RasterOutput(features=image[..., :-1] + behind, alpha=alpha, depth=image[..., -1])


def _composite(
    pixels: Float[Tensor, "p 2"],
    means: Float[Tensor, "g 2"],
    conics: Float[Tensor, "g 3"],
    opacities: Float[Tensor, " g"],
    features: Float[Tensor, "g c"],
    alpha_max: float,
) -> tuple[Float[Tensor, "p c"], Float[Tensor, " p"]]:
    """Sum of weighted features and of weights at each pixel; Gaussians are sorted front to back."""
    dx, dy = (pixels[:, None] - means).unbind(dim=2)
    xx, xy, yy = conics.unbind(dim=1)
    alpha = opacities * torch.exp(-0.5 * (xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy))
    alpha = alpha.clamp(max=alpha_max)
    alpha = torch.where(alpha >= Rasterizer.ALPHA_MIN, alpha, 0.0)
    after = torch.cumprod(1.0 - alpha, dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    weights = torch.where(before >= Rasterizer.TRANSMITTANCE_MIN, alpha * before, 0.0)
    return weights @ features, weights.sum(dim=1)


@torch.no_grad()
def _drawn_front_to_back(
    means: Float[Tensor, "g 3"],
    scales: Float[Tensor, "g 3"],
    rotations: Float[Tensor, "g 3 3"],
    opacities: Float[Tensor, " g"],
    features: Float[Tensor, "g c"],
    camera: Camera,
    low_pass_px2: float,
) -> Int64[Tensor, " drawn"]:
    """Indices of the Gaussians that are drawn, by camera z, ties by index.

    Found before anything differentiable is computed: a NaN that is masked away afterwards comes back in the gradient.
    """
    screen = project(means, scales, rotations, camera, low_pass_px2)
    values = (screen.means, screen.depths[:, None], screen.conics, opacities[:, None], features)
    drawn: Bool[Tensor, " g"] = torch.isfinite(torch.cat(values, dim=1)).all(dim=1)
    drawn &= (screen.depths >= Rasterizer.NEAR) & (opacities >= Rasterizer.ALPHA_MIN)
    candidates = drawn.nonzero()[:, 0]
    return candidates[torch.sort(screen.depths[candidates], stable=True).indices]


def _pixel_centers(camera: Camera, like: Tensor) -> Float[Tensor, "p 2"]:
    """Pixel centres (column, row) in reading order."""
    columns = torch.arange(camera.width, dtype=like.dtype, device=like.device) + 0.5
    rows = torch.arange(camera.height, dtype=like.dtype, device=like.device) + 0.5
    return torch.cartesian_prod(rows, columns).flip(1)
