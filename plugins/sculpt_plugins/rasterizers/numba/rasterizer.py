"""The CPU rasteriser: kernels in the order they run, and the tensors they read and write."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.cpu_kernels import array_of, kernel_cache, load_numba, share_threads
from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_framework.rendering.projection import JACOBIAN_MARGIN
from sculpt_framework.types import Camera
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig

with kernel_cache("rasterizer", Path(__file__).parent):
    from sculpt_plugins.rasterizers.numba import backward, forward, layout, projection, sorting
    from sculpt_plugins.rasterizers.numba.scratch import Lease, Scratch

_LARGEST_IMAGE = 32767
_POSE_PARTS = 64
_BANDS = 16
"""Bands of tile rows where the sums must not depend on the number of threads."""
_BANDS_PER_THREAD = 8
_PARTS_PER_THREAD = 4


class NumbaRasterizer(Rasterizer):
    """float32 on the CPU. Repeated runs with the same number of threads give the same bits.

    A Gaussian of which any projected value, opacity or feature is not finite (or beyond 1e18) is not drawn and gets
    zero gradients. Working memory is kept from call to call: about 80 bytes per Gaussian and rendering in flight.
    """

    def __init__(self, config: NumbaRasterizerConfig):
        load_numba()
        self._deterministic = config.deterministic
        self._free: list[Scratch] = []

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
        """Raises TypeError for tensors that are not float32, ValueError for sizes and limits out of range."""
        pose = camera.world_to_camera
        named = {
            "means": means,
            "scales": scales,
            "rotations": rotations,
            "opacities": opacities,
            "features": features,
            "world_to_camera": pose,
            "background": background,
        }
        for name, tensor in named.items():
            if tensor.dtype != torch.float32 or tensor.device.type != "cpu":
                raise TypeError(
                    f"rasterizer 'numba' takes float32 on the CPU, but {name} is {tensor.dtype} on {tensor.device}: "
                    "convert it, or use rasterizer 'reference'"
                )
        if not layout.ALPHA_MIN < alpha_max < 1.0:
            raise ValueError(f"alpha_max is {alpha_max}; it must lie between 1/255 and 1")
        if low_pass_px2 < 0.0:
            raise ValueError(f"low_pass_px2 is {low_pass_px2}; a variance is not negative")
        if features.shape[1] == 0:
            raise ValueError("features have no channels; at least one is needed")
        if not (0 < camera.width <= _LARGEST_IMAGE and 0 < camera.height <= _LARGEST_IMAGE):
            raise ValueError(f"image of {camera.width} x {camera.height} pixels; sides from 1 to {_LARGEST_IMAGE}")
        threads = share_threads()
        job = _Job(
            lens=_lens(camera),
            width=camera.width,
            height=camera.height,
            low_pass=np.float32(low_pass_px2),
            alpha_max=np.float32(alpha_max),
            threads=threads,
            bands=_BANDS if self._deterministic else 1 if threads == 1 else _BANDS_PER_THREAD * threads,
            lease=Lease(self._free),
        )
        image, alpha, depth = _Rasterize.apply(
            means, scales, rotations, opacities, features, pose, background.detach(), job
        )
        return RasterOutput(features=image, alpha=alpha, depth=depth)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Job:
    """What stays the same from the forward to the backward pass of one rendering."""

    lens: np.ndarray
    width: int
    height: int
    low_pass: np.float32
    alpha_max: np.float32
    threads: int
    bands: int
    lease: Lease

    @property
    def tile_columns(self) -> int:
        return -(-self.width // layout.TILE)

    @property
    def tile_rows(self) -> int:
        return -(-self.height // layout.TILE)

    @property
    def band_rows(self) -> int:
        return -(-self.tile_rows // self.bands)


def _lens(camera: Camera) -> np.ndarray:
    """fx, fy, cx, cy, then the bounds of x/z and of y/z inside the Jacobian (see rendering/projection.py)."""
    margin_x = JACOBIAN_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = JACOBIAN_MARGIN * 0.5 * camera.height / camera.fy
    return np.array(
        [
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            -camera.cx / camera.fx - margin_x,
            (camera.width - camera.cx) / camera.fx + margin_x,
            -camera.cy / camera.fy - margin_y,
            (camera.height - camera.cy) / camera.fy + margin_y,
        ],
        np.float32,
    )


def _tile_lists(job: _Job, tiles: np.ndarray, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(all tiles' lists of Gaussians by depth, one after the other; where each begins, and the end).

    Raises ValueError for more entries than 32 bits number.
    """
    scratch, count = job.lease.scratch, keys.shape[0]
    order = sorting.sort_by_depth(
        keys,
        scratch.take("keys_a", (count,), np.uint32),
        scratch.take("keys_b", (count,), np.uint32),
        scratch.take("order_a", (count,), np.int32),
        scratch.take("order_b", (count,), np.int32),
    )
    counts = scratch.take("counts", (job.threads, job.tile_rows * job.tile_columns), np.int32)
    starts = scratch.take("starts", (job.tile_rows * job.tile_columns + 1,), np.int32)
    sorting.count_tiles(order, tiles, job.tile_columns, counts)
    entries = int(sorting.place_tiles(counts, starts))
    if entries >= 2**31:
        raise ValueError(
            f"{entries} pairs of a Gaussian and a tile; 32 bits number them. Are the scales in object units?"
        )
    lists = scratch.take("lists", (entries,), np.int32)
    sorting.fill_tiles(order, tiles, job.tile_columns, counts, lists)
    return lists, starts


@dataclass(frozen=True, kw_only=True, eq=False)
class _Drawn:
    """What the forward pass leaves for the backward pass, all of it in the job's scratch."""

    records: np.ndarray
    tiles: np.ndarray
    lists: np.ndarray
    blocks: np.ndarray
    starts: np.ndarray
    kept: np.ndarray
    seen: np.ndarray


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, scales, rotations, opacities, features, pose, background, job: _Job):
        scratch = job.lease.scratch
        count, channels = features.shape
        records = scratch.take("records", (count, layout.record_width(channels)), np.float32)
        tiles = scratch.take("tiles", (count, 4), np.int16)
        keys = scratch.take("keys", (count,), np.uint32)
        projection.project(
            array_of(means), array_of(scales), array_of(rotations), array_of(opacities), array_of(features),
            array_of(pose), job.lens, job.width, job.height, job.low_pass,
            records, records.view(np.int32), tiles, keys,
        )  # fmt: skip
        lists, starts = _tile_lists(job, tiles, keys)

        image = torch.empty(job.height, job.width, channels)
        alpha, depth = torch.empty(job.height, job.width), torch.empty(job.height, job.width)
        blocks = scratch.take("blocks", lists.shape, np.uint16)
        kept = scratch.take("kept", (starts.shape[0] - 1,), np.int32)
        seen = scratch.take("seen", (count + 1,), np.uint8)
        seen[:] = 0
        forward.composite(
            records.reshape(-1), records.shape[1], lists, blocks, starts, job.width, job.height, job.threads,
            array_of(background).reshape(-1), channels if background.ndim == 3 else 0, job.alpha_max,
            image.numpy(), alpha.numpy(), depth.numpy(), kept, seen, np.zeros(1, np.int64),
        )  # fmt: skip
        ctx.save_for_backward(means, scales, rotations, opacities, pose, image, alpha, depth)
        ctx.job = job
        ctx.drawn = _Drawn(
            records=records, tiles=tiles, lists=lists, blocks=blocks, starts=starts, kept=kept, seen=seen
        )
        ctx.set_materialize_grads(False)
        return image, alpha, depth

    @staticmethod
    @once_differentiable
    def backward(ctx, to_image, to_alpha, to_depth):  # pyright: ignore[reportIncompatibleMethodOverride]
        means, scales, rotations, opacities, pose, image, alpha, depth = ctx.saved_tensors
        job: _Job = ctx.job
        with_shape = any((*ctx.needs_input_grad[:4], ctx.needs_input_grad[5]))
        sums, first_slot = _sums_over_pixels(
            job, ctx.drawn, (image, alpha, depth), (to_image, to_alpha, to_depth), with_shape
        )
        count, channels = means.shape[0], image.shape[2]
        to_features = torch.empty(count, channels)
        if not with_shape:
            projection.features_backward(first_slot, sums, to_features.numpy())
            return None, None, None, None, to_features, None, None, None
        to_means, to_scales, to_rotations = torch.empty(count, 3), torch.empty(count, 3), torch.empty(count, 3, 3)
        to_opacities = torch.empty(count)
        to_pose_parts = np.empty((_POSE_PARTS if ctx.needs_input_grad[5] else 0, 3, 4))
        projection.project_backward(
            array_of(means), array_of(scales), array_of(rotations), array_of(opacities),
            array_of(pose), job.lens, job.low_pass,
            first_slot, sums, to_means.numpy(), to_scales.numpy(), to_rotations.numpy(), to_opacities.numpy(),
            to_features.numpy(), to_pose_parts,
        )  # fmt: skip
        to_pose = None
        if ctx.needs_input_grad[5]:
            to_pose = torch.zeros(4, 4)
            to_pose[:3] = torch.from_numpy(to_pose_parts.sum(axis=0))
        return to_means, to_scales, to_rotations, to_opacities, to_features, to_pose, None, None


def _sums_over_pixels(
    job: _Job,
    drawn: _Drawn,
    images: tuple[Tensor, ...],
    gradients: tuple[Tensor | None, ...],
    with_shape: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """(rows of sums as in layout.py; where each Gaussian's rows begin, and the end)."""
    (image, alpha, depth), (to_image, to_alpha, to_depth) = (array_of(tensor) for tensor in images), gradients
    records, scratch = drawn.records, job.lease.scratch
    count, stride = records.shape
    bits = records.view(np.int32).reshape(-1)
    part_starts = np.zeros(_PARTS_PER_THREAD * job.threads + 1, np.int64)
    backward.count_slots(drawn.seen, drawn.tiles, job.band_rows, part_starts[1:])
    np.cumsum(part_starts, out=part_starts)
    first_slot = scratch.take("first_slot", (count + 1,), np.int32)
    width = layout.sums_width(image.shape[2])
    sums = scratch.take("sums", (int(part_starts[-1]), width), np.float32)
    backward.assign_slots(
        drawn.seen, drawn.tiles, job.band_rows, part_starts, first_slot, bits, stride, sums.reshape(-1), width
    )
    backward.composite_backward(
        records.reshape(-1), bits, stride, drawn.lists, drawn.blocks, drawn.starts, drawn.kept,
        job.width, job.height, job.threads, job.band_rows, job.alpha_max, image, alpha, depth,
        np.zeros_like(image) if to_image is None else array_of(to_image),
        np.zeros_like(alpha) if to_alpha is None else array_of(to_alpha),
        alpha if to_depth is None else array_of(to_depth), to_depth is not None, with_shape,
        sums.reshape(-1), width, np.zeros(1, np.int64),
    )  # fmt: skip
    return sums, first_slot
