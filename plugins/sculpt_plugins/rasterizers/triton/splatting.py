"""The differentiable whole: kernels in the order they run, and the tensors they read and write."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from . import layout
from .compositing import composite, composite_backward
from .projection import project, project_backward
from .tiles import TileLists, tile_lists

# A launch, kernel[grid](...), is to the checker a call of the function, and does not know Triton's own options.
# pyright: reportCallIssue=false


@dataclass(frozen=True, kw_only=True)
class Screen:
    """An image to be made: focal lengths and principal point in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    low_pass_px2: float
    alpha_max: float
    jacobian_margin: float
    """How far outside the image the projection is still linearised where it is, in half fields of view."""

    @property
    def lens(self) -> tuple[float, ...]:
        """fx, fy, cx, cy, then the bounds of x/z and of y/z inside the Jacobian."""
        margin_x = self.jacobian_margin * 0.5 * self.width / self.fx
        margin_y = self.jacobian_margin * 0.5 * self.height / self.fy
        return (
            self.fx,
            self.fy,
            self.cx,
            self.cy,
            -self.cx / self.fx - margin_x,
            (self.width - self.cx) / self.fx + margin_x,
            -self.cy / self.fy - margin_y,
            (self.height - self.cy) / self.fy + margin_y,
        )

    @property
    def tile_columns(self) -> int:
        return -(-self.width // layout.TILE.value)

    @property
    def tiles(self) -> int:
        return self.tile_columns * -(-self.height // layout.TILE.value)


def splat(
    means: Tensor,
    scales: Tensor,
    rotations: Tensor,
    opacities: Tensor,
    features: Tensor,
    pose: Tensor,
    background: Tensor,
    screen: Screen,
) -> tuple[Tensor, Tensor, Tensor]:
    """Image (h, w, c), alpha (h, w) and depth (h, w), as sculpt_framework/rasterizers.py defines them.

    All tensors are float32 on one device, (g, 3), (g, 3), (g, 3, 3), (g), (g, c) with c up to ``layout.CHANNELS``,
    (4, 4), and (c) or (h, w, c). Gradients reach all of them but the background, and repeat to the last bit.
    """
    return _Splat.apply(means, scales, rotations, opacities, features, pose, background.detach(), screen)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Drawn:
    """What the forward pass leaves for the backward pass beside its inputs and images."""

    records: Tensor
    lists: TileLists
    stops: Tensor
    seen: Tensor


class _Splat(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, scales, rotations, opacities, features, pose, background, screen: Screen):
        inputs = [tensor.detach().contiguous() for tensor in (means, scales, rotations, opacities, features, pose)]
        with torch.cuda.device_of(means):
            images, drawn = _forward(*inputs, background.contiguous(), screen)
        ctx.save_for_backward(means, scales, rotations, opacities, pose, *images)
        ctx.drawn, ctx.screen = drawn, screen
        ctx.set_materialize_grads(False)
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx, to_image, to_alpha, to_depth):  # pyright: ignore[reportIncompatibleMethodOverride]
        *inputs, image, alpha, depth = ctx.saved_tensors
        inputs = [tensor.detach().contiguous() for tensor in inputs]
        gradients = (
            torch.zeros_like(image) if to_image is None else to_image.contiguous(),
            torch.zeros_like(alpha) if to_alpha is None else to_alpha.contiguous(),
            None if to_depth is None else to_depth.contiguous(),
        )
        with torch.cuda.device_of(image):
            row_sums = _sums_over_pixels(ctx.drawn, (image, alpha, depth), gradients, ctx.screen)
            to_inputs = _backward(inputs, ctx.drawn, row_sums, image.shape[2], ctx.needs_input_grad[5], ctx.screen)
        return *to_inputs, None, None


def _programs(gaussians: int) -> tuple[int]:
    return (-(-gaussians // layout.GAUSSIANS.value),)


def _forward(
    means: Tensor,
    scales: Tensor,
    rotations: Tensor,
    opacities: Tensor,
    features: Tensor,
    pose: Tensor,
    background: Tensor,
    screen: Screen,
) -> tuple[tuple[Tensor, Tensor, Tensor], _Drawn]:
    count, channels = features.shape
    records = means.new_empty(count, layout.record_width(channels))
    depths, counts = means.new_empty(count), means.new_empty(count, dtype=torch.int32)
    if count > 0:
        project[_programs(count)](
            means, scales, rotations, opacities, features, pose, *screen.lens, screen.low_pass_px2,
            screen.width, screen.height, count, records, depths, counts, CHANNELS=channels, RECORD=records.shape[1],
        )  # fmt: skip
    lists = tile_lists(records, depths, counts, screen.width, screen.height)
    image = means.new_empty(screen.height, screen.width, channels)
    alpha, depth = means.new_empty(screen.height, screen.width), means.new_empty(screen.height, screen.width)
    stops = torch.empty_like(lists.starts[1:])
    seen = torch.zeros_like(lists.gaussians, dtype=torch.uint8)
    composite[(screen.tiles,)](
        records, lists.gaussians, lists.sources, lists.starts, screen.width, screen.height, screen.tile_columns,
        background, channels if background.ndim == 3 else 0, screen.alpha_max, image, alpha, depth, stops, seen,
        CHANNELS=channels, RECORD=records.shape[1], num_warps=1,
    )  # fmt: skip
    return (image, alpha, depth), _Drawn(records=records, lists=lists, stops=stops, seen=seen)


def _sums_over_pixels(
    drawn: _Drawn,
    images: tuple[Tensor, Tensor, Tensor],
    gradients: tuple[Tensor, Tensor, Tensor | None],
    screen: Screen,
) -> Tensor:
    """(entries, sums) rows as in layout.py, of the entries that were seen; the others are not initialised."""
    (image, alpha, depth), (to_image, to_alpha, to_depth) = images, gradients
    channels, lists = image.shape[2], drawn.lists
    row_sums = image.new_empty(drawn.seen.shape[0], layout.sums_width(channels))
    composite_backward[(screen.tiles,)](
        drawn.records, lists.gaussians, lists.sources, lists.starts, drawn.stops,
        screen.width, screen.height, screen.tile_columns, screen.alpha_max,
        image, alpha, depth, to_image, to_alpha, depth if to_depth is None else to_depth, row_sums,
        CHANNELS=channels, RECORD=drawn.records.shape[1], SUMS=row_sums.shape[1], WITH_DEPTH=to_depth is not None,
        num_warps=1,
    )  # fmt: skip
    return row_sums


def _backward(
    inputs: list[Tensor], drawn: _Drawn, row_sums: Tensor, channels: int, wants_pose: bool, screen: Screen
) -> tuple[Tensor | None, ...]:
    means, scales, rotations, opacities, pose = inputs
    count = means.shape[0]
    to_inputs = [torch.empty_like(tensor) for tensor in (means, scales, rotations, opacities)]
    to_features = means.new_empty(count, channels)
    to_pose_parts = means.new_empty(_programs(count)[0] if wants_pose else 0, 3, 4)
    if count > 0:
        project_backward[_programs(count)](
            *inputs, *screen.lens, screen.low_pass_px2, count, drawn.lists.first_entries, drawn.lists.counts,
            drawn.seen, row_sums, *to_inputs, to_features, to_pose_parts,
            CHANNELS=channels, SUMS=row_sums.shape[1], WANTS_POSE=wants_pose,
        )  # fmt: skip
    to_pose = None
    if wants_pose:
        to_pose = torch.zeros_like(pose)
        to_pose[:3] = to_pose_parts.sum(dim=0, dtype=torch.float64)
    return *to_inputs, to_features, to_pose
