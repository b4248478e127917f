"""How much of what a ray brings comes from each stretch of it."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.cpu_kernels import array_of, share_threads
from sculpt_framework.volume_rendering.stretches import Stretches, kernels


def weigh(alphas: Float[Tensor, " n"], stretches: Stretches) -> tuple[Float[Tensor, " n"], Float[Tensor, " r"]]:
    """Weights of the stretches, w_i = alpha_i prod_{j < i} (1 - alpha_j), and what is left for what lies behind.

    Opacities are in [0, 1], both included: a stretch behind an opaque one has weight and gradient 0, the opaque one has
    the gradient that the product has there.
    """
    if alphas.device.type == "cpu":
        weights, through = _Weights.apply(alphas, stretches.offsets)
        return weights, through
    return weigh_in_torch(alphas, stretches)


class _Weights(torch.autograd.Function):
    """``weigh_in_torch`` on the CPU. Not differentiable twice."""

    @staticmethod
    def forward(ctx, alphas: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(alphas, offsets)
        share_threads()
        weights, through = torch.empty_like(alphas), alphas.new_empty(len(offsets) - 1)
        kernels.weigh(array_of(alphas), offsets.numpy(), weights.numpy(), through.numpy())
        return weights, through

    @staticmethod
    @once_differentiable
    def backward(ctx, to_weights: Tensor, to_through: Tensor) -> tuple[Tensor, None]:
        alphas, offsets = ctx.saved_tensors
        share_threads()
        to_alphas, light = torch.empty_like(alphas), torch.empty_like(alphas)
        kernels.differentiate_weights(
            array_of(alphas), offsets.numpy(), array_of(to_weights), array_of(to_through), light.numpy(),
            to_alphas.numpy(),
        )  # fmt: skip
        return to_alphas, None


def weigh_in_torch(
    alphas: Float[Tensor, " n"], stretches: Stretches
) -> tuple[Float[Tensor, " n"], Float[Tensor, " r"]]:
    """The same in plain torch: any device and floating-point type, with room for each ray as for the longest."""
    counts = stretches.offsets.diff()
    place = torch.arange(len(alphas), device=alphas.device) - stretches.offsets[stretches.ray]
    left = alphas.new_ones(len(counts), int(counts.max()) + 1 if len(counts) else 1)
    left = left.index_put((stretches.ray, place + 1), 1 - alphas)
    light = left.cumprod(dim=1)
    return alphas * light[stretches.ray, place], light[:, -1]


def add_up(
    weights: Float[Tensor, " n"], values: Float[Tensor, "n c"], offsets: Int64[Tensor, " r1"]
) -> Float[Tensor, "r c"]:
    """What the stretches of each ray bring together: the sum of weight times value; 0 for a ray without any."""
    return torch.segment_reduce(weights[:, None] * values, "sum", offsets=offsets, initial=0)
