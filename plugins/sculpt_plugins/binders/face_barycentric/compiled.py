"""Binding in compiled kernels, for float32 on the CPU."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.binders import Binding
from sculpt_framework.cpu_kernels import array_of, float32_on_cpu, kernel_cache, share_threads
from sculpt_framework.types import Surface
from sculpt_plugins.binders.face_barycentric.in_torch import BindOptions
from sculpt_plugins.binders.face_barycentric.limits import TINY
from sculpt_plugins.binders.face_barycentric.outline import COLUMN, Neighbourhood, log_density

with kernel_cache("face-barycentric", Path(__file__).parent):
    from sculpt_plugins.binders.face_barycentric import backward, forward, vectors
    from sculpt_plugins.binders.face_barycentric import neighbourhood_kernels as kernels


def runs_compiled(surface: Surface, rows: Mapping[str, Tensor]) -> bool:
    """Whether there are kernels for these tensors."""
    return float32_on_cpu(surface.vertices, *rows.values())


def bind_compiled(
    surface: Surface, rows: Mapping[str, Tensor], opacities: Float[Tensor, "f k"], options: BindOptions
) -> Binding:
    """As ``bind_in_torch``; not differentiable twice. The same bits from run to run, for any number of threads."""
    logits, log_ratios, rotation = rows["barycentric_logits"], rows["log_ratios"], rows.get("rotation")
    means, scales, rotations, barycentrics, covariance, corners = _Bind.apply(
        surface.vertices, logits, log_ratios, rotation, surface.faces, options
    )
    return Binding(
        means=means,
        scales=scales,
        rotations=rotations,
        opacities=opacities,
        barycentrics=barycentrics,
        tangent_covariance=covariance,
        tangent_corners=corners,
    )


def neighbourhood_compiled(surface: Surface, reference: str) -> Neighbourhood:
    """As ``outline.neighbourhood_of``; the same bits from run to run, for any number of threads."""
    share_threads()
    vertices, faces = array_of(surface.vertices), array_of(surface.faces)
    count = len(faces)
    starts, entries = np.zeros(len(vertices) + 2, np.int64), np.empty(3 * count, np.int64)
    across = np.empty(3 * count, np.int64)
    kernels.list_edges(faces, starts, entries)
    kernels.pair_edges(faces, starts, entries, across)
    normals, centroids = np.empty((3, count), np.float32), np.empty((3, count), np.float32)
    kernels.look_along(vertices, faces, normals, centroids)
    outward, reach = np.empty((3, 3, count), np.float32), np.empty((3, 2, count), np.float32)
    heights, cosine, sine = (np.empty((3, count), np.float32) for _ in range(3))
    areas = np.empty(-(-count // vectors.CHUNK))
    steiner = reference == "steiner"
    kernels.look_across(vertices, faces, steiner, across, normals, outward, heights, cosine, sine, reach, areas)
    area = float(areas.sum()) / count
    low = centroids.min(axis=1)
    extent = (centroids.max(axis=1) - low).max()
    names, wanted = np.empty(count, np.int64), np.empty((2, count), np.int64)
    kernels.name_sides(centroids, normals, low, extent, np.float32(COLUMN * math.sqrt(area + TINY)), names, wanted)
    order = np.argsort(names)
    thickness = np.empty(count, np.float32)
    kernels.find_gaps(centroids, normals, names[order], order, wanted, thickness)
    return Neighbourhood(
        outward=torch.from_numpy(outward),
        heights=torch.from_numpy(heights),
        cosine=torch.from_numpy(cosine),
        sine=torch.from_numpy(sine),
        reach=torch.from_numpy(reach),
        area=area,
        thickness=torch.from_numpy(thickness),
    )


class _Bind(torch.autograd.Function):
    @staticmethod
    def forward(ctx, vertices, logits, log_ratios, rotation, faces, options: BindOptions):
        share_threads()
        count, per_face = logits.shape[:2]
        neighbourhood = options.neighbourhood
        outline = [
            np.zeros(0, np.float32).reshape(shape) for shape in ((3, 3, 0), (3, 0), (3, 0), (3, 0), (3, 2, 0), 0)
        ]
        if neighbourhood is not None:
            fitted = (
                neighbourhood.outward,
                neighbourhood.heights,
                neighbourhood.cosine,
                neighbourhood.sine,
                neighbourhood.reach,
                neighbourhood.thickness,
            )
            outline = [array_of(tensor) for tensor in fitted]
        outward, heights, cosine, sine, reach, thickness = outline
        mixing = np.empty((count, per_face, 4), np.float32)
        squares = np.empty(-(-count // vectors.CHUNK))
        forward.mix(array_of(log_ratios), _turns(rotation), reach, mixing, squares)
        density = 0.0
        if neighbourhood is not None:
            variance = float(squares.sum()) / (3 * count * per_face)
            density = log_density(
                neighbourhood, variance, per_face, math.hypot(options.blur, options.normal_scale), options.blur
            )
        means, scales, barycentrics = (torch.empty(count, per_face, 3) for _ in range(3))
        rotations, covariance = torch.empty(count, per_face, 3, 3), torch.empty(count, per_face, 2, 2)
        corners = torch.empty(count, 3, 2)
        fitted = 0 if neighbourhood is None else count
        depth, trims = np.empty(fitted, np.float32), np.empty((fitted, per_face, 3), np.float32)
        forward.place(
            array_of(vertices), array_of(faces), array_of(logits), mixing, options.reference == "steiner",
            np.float32(options.normal_scale), np.float32(options.blur),
            outward, heights, cosine, sine, reach, thickness, array_of(options.depths.float()), density,
            means.numpy(), scales.numpy(), rotations.numpy(), barycentrics.numpy(), covariance.numpy(), corners.numpy(),
            depth, trims,
        )  # fmt: skip
        ctx.save_for_backward(vertices, faces, rotation, barycentrics, scales, rotations)
        ctx.steiner, ctx.mixing, ctx.depth, ctx.trims = options.reference == "steiner", mixing, depth, trims
        ctx.least = np.float32(options.least_parallelogram)
        ctx.set_materialize_grads(False)
        if not ctx.needs_input_grad[0]:
            ctx.mark_non_differentiable(corners)
        return means, scales, rotations, barycentrics, covariance, corners

    @staticmethod
    @once_differentiable
    def backward(ctx, *to_outputs):  # pyright: ignore[reportIncompatibleMethodOverride]
        vertices, faces, rotation, barycentrics, scales, rotations = ctx.saved_tensors
        share_threads()
        gradients = [
            np.zeros((0,) * dimensions, np.float32) if gradient is None else array_of(gradient)
            for gradient, dimensions in zip(to_outputs, (3, 3, 4, 3, 4, 3), strict=True)
        ]
        to_means, to_scales, to_rotations, to_barycentrics, to_covariance, to_flat_corners = gradients
        count, per_face = barycentrics.shape[:2]
        to_logits, to_log_ratios = torch.empty(count, per_face, 3), torch.empty(count, per_face, 2)
        to_rotation = None if rotation is None else torch.empty(count, per_face)
        to_corners = np.empty((count if ctx.needs_input_grad[0] else 0, 3, 3), np.float32)
        backward.place_backward(
            array_of(vertices), array_of(faces), ctx.least, ctx.steiner, ctx.mixing, ctx.trims, ctx.depth,
            array_of(barycentrics), array_of(scales), array_of(rotations),
            to_means, to_scales, to_rotations, to_barycentrics, to_covariance, to_flat_corners,
            to_logits.numpy(), to_log_ratios.numpy(), _turns(to_rotation), to_corners,
        )  # fmt: skip
        to_vertices = None
        if ctx.needs_input_grad[0]:
            to_vertices = torch.zeros(vertices.shape)
            backward.gather(array_of(faces), to_corners, to_vertices.numpy())
        return to_vertices, to_logits, to_log_ratios, to_rotation, None, None


def _turns(rotation: Tensor | None) -> np.ndarray:
    """In-plane angles, or an array without entries where Gaussians do not turn."""
    return np.zeros((0, 0), np.float32) if rotation is None else array_of(rotation)
