"""Geometry of the dual surface in compiled kernels, for float32 on the CPU."""

import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.cpu_kernels import array_of, kernel_cache, share_threads
from sculpt_framework.geometry.band import LEAST_DROP
from sculpt_plugins.extractors.flexicubes.octree_topology import OctreeTopology
from sculpt_plugins.extractors.flexicubes.topology import DualTopology, quad_kernels

with kernel_cache("flexicubes", Path(__file__).with_name("dual_kernels.py")):
    from sculpt_plugins.extractors.flexicubes import dual_kernels


def dual_vertices_compiled(
    topology: DualTopology | OctreeTopology,
    corner_positions: Float[Tensor, "n 3"],
    corner_sdf: Float[Tensor, " n"],
    sides: Float[Tensor, " e"],
    alpha: Float[Tensor, "c a"],
    beta: Float[Tensor, "c b"],
    places: Int64[Tensor, " m"],
    damp_grazing: bool,
) -> tuple[Float[Tensor, "d 3"], Float[Tensor, " d"]]:
    """As ``geometry.dual_vertices_in_torch``; not differentiable twice.

    The same bits from run to run, for any number of threads.
    """
    return _DualVertices.apply(corner_positions, corner_sdf, alpha, beta, topology, sides, places, damp_grazing)


def second_diagonals_compiled(
    vertices: Float[Tensor, "d 3"], quads: Int64[Tensor, "e 4"], preferred_by: float
) -> Bool[Tensor, " e"]:
    """As ``geometry.second_diagonals_in_torch``, up to rounding where both diagonals are equally good."""
    share_threads()
    second = torch.empty(len(quads), dtype=torch.bool)
    quad_kernels.choose_diagonals(
        array_of(vertices), array_of(quads), np.float32(math.tan(preferred_by)), second.numpy()
    )
    return second


class _DualVertices(torch.autograd.Function):
    @staticmethod
    def forward(ctx, positions, sdf, alpha, beta, topology, sides, places, damp_grazing: bool):
        share_threads()
        ctx.topology, ctx.damp_grazing = topology, damp_grazing
        at, ends, cells = array_of(places), array_of(topology.ends), array_of(topology.cells)
        vertex, count, points = array_of(topology.vertices), topology.vertex_count, array_of(positions)
        weights, distances = torch.empty(len(at)), torch.empty(len(at))
        vertices, deviation = torch.zeros(count, 3), torch.zeros(count)
        total, number, mean = torch.zeros(count), torch.zeros(count), torch.zeros(count)
        dual_kernels.weigh(
            at, ends, cells, array_of(topology.cell_ends), array_of(sdf), array_of(alpha), array_of(LEAST_DROP * sides),
            weights.numpy(),
        )  # fmt: skip
        dual_kernels.gather(
            at, ends, cells, array_of(topology.cell_edge), vertex, points, array_of(beta), weights.numpy(),
            vertices.numpy(), total.numpy(), number.numpy(),
        )  # fmt: skip
        dual_kernels.measure(at, ends, vertex, points, weights.numpy(), vertices.numpy(), distances.numpy())
        dual_kernels.deviate(at, vertex, distances.numpy(), number.numpy(), mean.numpy(), deviation.numpy())
        ctx.save_for_backward(
            positions, sdf, alpha, beta, sides, places, weights, distances, vertices, total, number, mean
        )
        return vertices, deviation

    @staticmethod
    @once_differentiable
    def backward(ctx, to_vertices: Tensor, to_deviation: Tensor):
        share_threads()
        positions, sdf, alpha, beta, sides, places, *found = ctx.saved_tensors
        weights, distances, vertices, total, number, mean = map(array_of, found)
        topology, at, points = ctx.topology, array_of(places), array_of(positions)
        ends, cells, vertex = array_of(topology.ends), array_of(topology.cells), array_of(topology.vertices)
        cell_ends, cell_edge = array_of(topology.cell_ends), array_of(topology.cell_edge)
        to_distances, to_shares = np.empty(len(at), np.float32), np.empty(len(at), np.float32)
        to_crossings, to_reaches = np.empty((len(at), 3), np.float32), np.empty((len(at), 2), np.float32)
        slopes, lean = np.array(array_of(to_vertices)), np.zeros(len(mean), np.float32)
        dual_kernels.spread_deviation(at, vertex, distances, mean, number, array_of(to_deviation), lean, to_distances)
        dual_kernels.spread_distances(at, ends, vertex, points, weights, vertices, distances, to_distances, slopes)
        dual_kernels.differentiate(
            at, ends, cells, cell_ends, cell_edge, vertex, points, array_of(sdf), array_of(alpha), array_of(beta),
            array_of(LEAST_DROP * sides), array_of(sides if ctx.damp_grazing else torch.zeros_like(sides)),
            weights, vertices, total, distances, to_distances, slopes, to_shares, to_crossings, to_reaches,
        )  # fmt: skip
        moves = ctx.needs_input_grad[0]
        to_positions = torch.zeros(len(points) if moves else 0, 3)
        to_sdf, to_alpha, to_beta = torch.zeros_like(sdf), torch.zeros_like(alpha), torch.zeros_like(beta)
        dual_kernels.scatter(
            at, ends, cells, cell_ends, cell_edge, array_of(sdf), array_of(alpha), weights,
            to_shares, to_crossings, to_reaches,
            to_positions.numpy(), to_sdf.numpy(), to_alpha.numpy(), to_beta.numpy(),
        )  # fmt: skip
        return to_positions if moves else None, to_sdf, to_alpha, to_beta, None, None, None, None
