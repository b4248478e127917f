"""The hash grid's fused kernels for the CPU: numpy and numba only, so that the file can be measured anywhere.

Forward runs in parallel over points, backward over levels: a level's table is written by one thread, so there are no
conflicts, no atomics, and sums are the same from run to run.
"""

import numpy as np
from numba import njit, prange

_OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}}
_PRIME_Y = np.uint32(2654435761)
_PRIME_Z = np.uint32(805459861)


@njit(inline="always", **_OPTIONS)
def _cell(value, resolution):
    """Cell index and fraction of a coordinate in [-1, 1]; NaN goes to cell 0 with a NaN fraction."""
    position = np.float32(0.5) * (min(max(value, np.float32(-1.0)), np.float32(1.0)) + np.float32(1.0)) * resolution
    index = np.int64(position) if position == position else np.int64(0)
    index = min(index, np.int64(resolution) - 1)
    return index, position - np.float32(index)


@njit(inline="always", **_OPTIONS)
def _entry(x, y, z, side, dense, mask):
    if dense:
        return (z * side + y) * side + x
    hashed = np.uint32(x) ^ (np.uint32(y) * _PRIME_Y) ^ (np.uint32(z) * _PRIME_Z)
    return np.int64(hashed & np.uint32(mask))


@njit(parallel=True, **_OPTIONS)
def encode_forward(points, tables, resolutions, out):
    """out[n, level * features + f] = trilinear features. ``tables`` is a tuple of [entries, features] arrays."""
    count, levels, features = points.shape[0], len(tables), tables[0].shape[1]
    for n in prange(count):
        for level in range(levels):
            table, resolution = tables[level], np.float32(resolutions[level])
            side = resolutions[level] + 1
            dense, mask = side * side * side <= table.shape[0], table.shape[0] - 1
            x, fx = _cell(points[n, 0], resolution)
            y, fy = _cell(points[n, 1], resolution)
            z, fz = _cell(points[n, 2], resolution)
            base = level * features
            for f in range(features):
                out[n, base + f] = np.float32(0.0)
            for corner in range(8):
                bx, by, bz = corner & 1, corner >> 1 & 1, corner >> 2
                weight = (fx if bx else np.float32(1.0) - fx) * (fy if by else np.float32(1.0) - fy)
                weight *= fz if bz else np.float32(1.0) - fz
                row = _entry(x + bx, y + by, z + bz, side, dense, mask)
                for f in range(features):
                    out[n, base + f] += weight * table[row, f]


@njit(parallel=True, **_OPTIONS)
def encode_backward(points, resolutions, entries, features, grad_out, grad_tables):
    """Add the gradient of every level's table to ``grad_tables``, a tuple of zeroed arrays."""
    count, levels = points.shape[0], len(grad_tables)
    for level in prange(levels):
        grad_table, resolution = grad_tables[level], np.float32(resolutions[level])
        side = resolutions[level] + 1
        dense, mask = side * side * side <= entries[level], entries[level] - 1
        base = level * features
        for n in range(count):
            x, fx = _cell(points[n, 0], resolution)
            y, fy = _cell(points[n, 1], resolution)
            z, fz = _cell(points[n, 2], resolution)
            for corner in range(8):
                bx, by, bz = corner & 1, corner >> 1 & 1, corner >> 2
                weight = (fx if bx else np.float32(1.0) - fx) * (fy if by else np.float32(1.0) - fy)
                weight *= fz if bz else np.float32(1.0) - fz
                row = _entry(x + bx, y + by, z + bz, side, dense, mask)
                for f in range(features):
                    grad_table[row, f] += weight * grad_out[n, base + f]


@njit(parallel=True, **_OPTIONS)
def encode_backward_points(points, tables, resolutions, grad_out, grad_points):
    """Gradient by position; 0 along an axis where the point lies outside [-1, 1]."""
    count, levels, features = points.shape[0], len(tables), tables[0].shape[1]
    for n in prange(count):
        gx, gy, gz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for level in range(levels):
            table, resolution = tables[level], np.float32(resolutions[level])
            side = resolutions[level] + 1
            dense, mask = side * side * side <= table.shape[0], table.shape[0] - 1
            x, fx = _cell(points[n, 0], resolution)
            y, fy = _cell(points[n, 1], resolution)
            z, fz = _cell(points[n, 2], resolution)
            base = level * features
            half = np.float32(0.5) * resolution
            for corner in range(8):
                bx, by, bz = corner & 1, corner >> 1 & 1, corner >> 2
                row = _entry(x + bx, y + by, z + bz, side, dense, mask)
                value = np.float32(0.0)
                for f in range(features):
                    value += table[row, f] * grad_out[n, base + f]
                value *= half
                wx = fx if bx else np.float32(1.0) - fx
                wy = fy if by else np.float32(1.0) - fy
                wz = fz if bz else np.float32(1.0) - fz
                gx += value * wy * wz * (np.float32(1.0) if bx else np.float32(-1.0))
                gy += value * wx * wz * (np.float32(1.0) if by else np.float32(-1.0))
                gz += value * wx * wy * (np.float32(1.0) if bz else np.float32(-1.0))
        grad_points[n, 0] = gx if abs(points[n, 0]) <= np.float32(1.0) else np.float32(0.0)
        grad_points[n, 1] = gy if abs(points[n, 1]) <= np.float32(1.0) else np.float32(0.0)
        grad_points[n, 2] = gz if abs(points[n, 2]) <= np.float32(1.0) else np.float32(0.0)
