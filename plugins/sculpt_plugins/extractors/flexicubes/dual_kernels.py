"""``geometry.dual_vertices_in_torch`` and its gradient in compiled kernels. For the CPU.

What belongs to one place (a cell at a crossed edge) is computed side by side; what several places share is added up on
one thread, in their order, so that sums have the same bits for any number of threads.
"""

import math

import numpy as np
from numba import njit, prange

# No "nnan" and "ninf": a signed distance that is not a number has to show in its vertices.
_OPTIONS = {"fastmath": {"nsz", "arcp", "contract"}, "error_model": "numpy", "cache": True, "nogil": True}
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


@njit(forceinline=True, **_OPTIONS)
def _crossing(ends, positions, weight, place):
    inner, outer = ends[place >> 2, 0], ends[place >> 2, 1]
    x, y, z = positions[inner, 0], positions[inner, 1], positions[inner, 2]
    return (
        x + weight * (positions[outer, 0] - x),
        y + weight * (positions[outer, 1] - y),
        z + weight * (positions[outer, 2] - z),
    )


@njit(forceinline=True, **_OPTIONS)
def _reaches(ends, cells, cell_ends, sdf, alpha, edge, corner):
    """alpha |sdf| at the inner and the outer end of an edge, as one of its cells has them."""
    cell = cells[edge, corner]
    inner = abs(sdf[ends[edge, 0]]) * alpha[cell, cell_ends[edge, corner, 0]]
    return inner, abs(sdf[ends[edge, 1]]) * alpha[cell, cell_ends[edge, corner, 1]]


@njit(forceinline=True, **_OPTIONS)
def _sign(value):
    # Without branches, which nothing could foresee.
    return np.float32(value > _ZERO) - np.float32(value < _ZERO)


@njit(parallel=True, **_OPTIONS)
def weigh(places, ends, cells, cell_ends, sdf, alpha, least, weights):
    """Where along its edge, from 0 at the inner end to 1, each place sees the crossing (``band.crossing_weight``)."""
    for m in prange(places.shape[0]):
        edge = places[m] >> 2
        inner, outer = _reaches(ends, cells, cell_ends, sdf, alpha, edge, places[m] & 3)
        weights[m] = _HALF + _HALF * (inner - outer) / max(inner + outer, least[edge])


@njit(**_OPTIONS)
def gather(places, ends, cells, cell_edge, vertex, positions, beta, weights, vertices, total, count):
    """The mean of each vertex' crossings by beta, the sum of these shares and the number of crossings; comes zeroed."""
    for m in range(places.shape[0]):
        place = places[m]
        edge, corner = place >> 2, place & 3
        x, y, z = _crossing(ends, positions, weights[m], place)
        share, v = beta[cells[edge, corner], cell_edge[edge, corner]], vertex[edge, corner]
        total[v] += share
        count[v] += _ONE
        vertices[v, 0] += share * x
        vertices[v, 1] += share * y
        vertices[v, 2] += share * z
    for v in range(vertices.shape[0]):
        for axis in range(3):
            vertices[v, axis] /= total[v]


@njit(parallel=True, **_OPTIONS)
def measure(places, ends, vertex, positions, weights, vertices, distances):
    """How far each place's vertex is from its crossing."""
    for m in prange(places.shape[0]):
        x, y, z = _crossing(ends, positions, weights[m], places[m])
        v = vertex[places[m] >> 2, places[m] & 3]
        x, y, z = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
        distances[m] = math.sqrt(x * x + y * y + z * z)


@njit(**_OPTIONS)
def deviate(places, vertex, distances, count, mean, deviation):
    """The mean of each vertex' distances and their mean absolute deviation from it; both come zeroed."""
    for m in range(places.shape[0]):
        mean[vertex[places[m] >> 2, places[m] & 3]] += distances[m]
    for v in range(mean.shape[0]):
        mean[v] /= count[v]
    for m in range(places.shape[0]):
        v = vertex[places[m] >> 2, places[m] & 3]
        deviation[v] += abs(distances[m] - mean[v])
    for v in range(mean.shape[0]):
        deviation[v] /= count[v]


@njit(**_OPTIONS)
def spread_deviation(places, vertex, distances, mean, count, to_deviation, lean, to_distances):
    """The gradient by the deviations, handed on to the distances. ``lean``, a number for each vertex, comes zeroed."""
    for m in range(places.shape[0]):
        v = vertex[places[m] >> 2, places[m] & 3]
        lean[v] += _sign(distances[m] - mean[v])
    for m in range(places.shape[0]):
        v = vertex[places[m] >> 2, places[m] & 3]
        to_distances[m] = to_deviation[v] * (_sign(distances[m] - mean[v]) - lean[v] / count[v]) / count[v]


@njit(**_OPTIONS)
def spread_distances(places, ends, vertex, positions, weights, vertices, distances, to_distances, to_vertices):
    """The gradient by the distances, added to that by the vertices; at distance 0 it is 0."""
    for m in range(places.shape[0]):
        if distances[m] > _ZERO:
            x, y, z = _crossing(ends, positions, weights[m], places[m])
            v, slope = vertex[places[m] >> 2, places[m] & 3], to_distances[m] / distances[m]
            to_vertices[v, 0] += slope * (vertices[v, 0] - x)
            to_vertices[v, 1] += slope * (vertices[v, 1] - y)
            to_vertices[v, 2] += slope * (vertices[v, 2] - z)


@njit(parallel=True, **_OPTIONS)
def differentiate(
    places, ends, cells, cell_ends, cell_edge, vertex, positions, sdf, alpha, beta, least, damped_below,
    weights, vertices, total, distances, to_distances, to_vertices, to_shares, to_crossings, to_reaches,
):  # fmt: skip
    """From the gradient by the vertices, what it is by each place's share, its crossing and the reaches at its ends.

    ``damped_below`` as in ``band.crossing_weight``, 0 for none.
    """
    for m in prange(places.shape[0]):
        place = places[m]
        edge, corner = place >> 2, place & 3
        cell, v = cells[edge, corner], vertex[edge, corner]
        share = beta[cell, cell_edge[edge, corner]]
        x, y, z = _crossing(ends, positions, weights[m], place)
        x, y, z = x - vertices[v, 0], y - vertices[v, 1], z - vertices[v, 2]
        part = _ONE / total[v]
        gx, gy, gz = to_vertices[v, 0] * part, to_vertices[v, 1] * part, to_vertices[v, 2] * part
        to_shares[m] = gx * x + gy * y + gz * z
        slope = to_distances[m] / distances[m] if distances[m] > _ZERO else _ZERO
        gx, gy, gz = share * gx + slope * x, share * gy + slope * y, share * gz + slope * z
        to_crossings[m, 0], to_crossings[m, 1], to_crossings[m, 2] = gx, gy, gz
        i, o = ends[edge, 0], ends[edge, 1]
        to_weight = (
            gx * (positions[o, 0] - positions[i, 0])
            + gy * (positions[o, 1] - positions[i, 1])
            + gz * (positions[o, 2] - positions[i, 2])
        )
        inner, outer = _reaches(ends, cells, cell_ends, sdf, alpha, edge, corner)
        change = inner + outer
        if change < damped_below[edge]:
            to_weight *= change / damped_below[edge]
        if change >= least[edge]:
            to_weight /= change * change
            to_reaches[m, 0], to_reaches[m, 1] = to_weight * outer, -to_weight * inner
        else:
            to_weight *= _HALF / least[edge]
            to_reaches[m, 0], to_reaches[m, 1] = to_weight, -to_weight


@njit(**_OPTIONS)
def scatter(
    places, ends, cells, cell_ends, cell_edge, sdf, alpha, weights, to_shares, to_crossings, to_reaches,
    to_positions, to_sdf, to_alpha, to_beta,
):  # fmt: skip
    """Add the places' gradients up where they come from; all four come zeroed. ``to_positions`` may have no rows."""
    for m in range(places.shape[0]):
        edge, corner = places[m] >> 2, places[m] & 3
        cell = cells[edge, corner]
        to_beta[cell, cell_edge[edge, corner]] += to_shares[m]
        for side in range(2):
            end, number = ends[edge, side], cell_ends[edge, corner, side]
            to_alpha[cell, number] += abs(sdf[end]) * to_reaches[m, side]
            to_sdf[end] += _sign(sdf[end]) * alpha[cell, number] * to_reaches[m, side]
            if to_positions.shape[0] > 0:
                part = weights[m] if side == 1 else _ONE - weights[m]
                for axis in range(3):
                    to_positions[end, axis] += part * to_crossings[m, axis]
