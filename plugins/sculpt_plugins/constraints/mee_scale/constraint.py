"""The scale constraint (paper, equations 3 to 5)."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.binders import Binding
from sculpt_framework.constraints import Constraint
from sculpt_framework.cpu_kernels import array_of, float32_on_cpu, kernel_cache, share_threads

with kernel_cache("mee-scale", Path(__file__).with_name("kernels.py")):
    from sculpt_plugins.constraints.mee_scale import kernels

_TINY = 1e-12


class MeeScale(Constraint):
    """Mean over Gaussians of max(0, lambda_max(M^-1 Sigma) - limit), Sigma the covariance in the face's tangent frame.

    ``edges``    the paper's D = diag(|v2 - v1| / 2, |v3 - v1| / 2), M = D D^T. Not an enclosing ellipse: the corners of
                 an equilateral triangle lie at 1.33, and the value depends on the order of the vertices.
    ``steiner``  M = (2/3) sum_i (v_i - c)(v_i - c)^T, the Steiner circumellipse: the smallest that holds the triangle.

    The eigenvalue is that of L^-1 Sigma L^-T with M = L L^T: the mean of its diagonal and the length of its deviator,
    rounded off at 0, where both eigenvalues agree and the length has no gradient. A face of no area is given a
    thickness of 1e-6 units, so its penalty is large but finite.
    """

    def __init__(self, form: str, limit: float):
        self._form = form
        self._limit = limit

    def __call__(self, binding: Binding) -> Float[Tensor, ""]:
        corners = binding.tangent_corners
        if self._form == "steiner":
            ellipse = (2.0 / 3.0) * corners.transpose(1, 2) @ corners
        else:
            edges = corners[:, 1:] - corners[:, :1]
            ellipse = torch.diag_embed(0.25 * edges.square().sum(dim=2))
        ellipse = ellipse + _TINY * torch.eye(2, dtype=corners.dtype, device=corners.device)
        covariance = binding.tangent_covariance
        if float32_on_cpu(covariance) and not ellipse.requires_grad:
            return _CompiledExcess.apply(ellipse, covariance, self._limit)
        return mean_excess(ellipse, covariance, self._limit)


class _CompiledExcess(torch.autograd.Function):
    """``mean_excess`` for float32 on the CPU, differentiable once, in the covariances."""

    @staticmethod
    def forward(ctx, metric: Tensor, covariance: Tensor, limit: float) -> Tensor:
        share_threads()
        gradient = torch.empty(covariance.shape if ctx.needs_input_grad[1] else (0, 1, 2, 2))
        sums = np.empty(-(-len(metric) // kernels.CHUNK))
        kernels.excess(
            array_of(metric), array_of(covariance), np.float32(limit), np.float32(_TINY), sums, gradient.numpy()
        )
        ctx.save_for_backward(gradient)
        ctx.count = covariance.shape[0] * covariance.shape[1]
        return covariance.new_tensor(sums.sum() / ctx.count)

    @staticmethod
    @once_differentiable
    def backward(ctx, to_value: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        (gradient,) = ctx.saved_tensors
        return None, gradient * (to_value / ctx.count), None


def mean_excess(
    metric: Float[Tensor, "f 2 2"], covariance: Float[Tensor, "f k 2 2"], limit: float
) -> Float[Tensor, ""]:
    """Mean over Gaussians of what the largest eigenvalue of metric^-1 covariance exceeds the limit by, in torch."""
    return (_largest_eigenvalue(metric[:, None], covariance) - limit).clamp(min=0).mean()


def _largest_eigenvalue(metric: Float[Tensor, "f 1 2 2"], covariance: Float[Tensor, "f k 2 2"]) -> Float[Tensor, "f k"]:
    """Of metric^-1 covariance, both symmetric; the metric positive definite."""
    a, b, c = metric[..., 0, 0], metric[..., 0, 1], metric[..., 1, 1]
    p, q, r = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    determinant = (a * c - b * b).clamp(min=_TINY * _TINY)
    slope = b / a
    first = p / a
    second = (r - 2 * slope * q + slope * slope * p) * a / determinant
    mixed = (q - slope * p) / determinant.sqrt()
    # A sum of squares: as trace^2 / 4 - determinant it would cancel where both eigenvalues are about the same.
    gap = (0.5 * (first - second)).square() + mixed.square()
    return 0.5 * (first + second) + (gap + _TINY).sqrt()
