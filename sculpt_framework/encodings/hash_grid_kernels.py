"""One level of the hash grid, forwards and backwards, for the CPU."""

import numpy as np
from numba import njit, prange

# No "nnan": a coordinate that is not a number has to show in the features.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc"}, "error_model": "numpy", "cache": True, "nogil": True}
_PRIME_Y, _PRIME_Z = np.uint32(2654435761), np.uint32(805459861)
_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_CHUNK = 1024
"""Points a thread takes at a time."""

# The loops over points stand in functions of their own that are inlined with the usual numbers of features, 1, 2 and 4,
# as constants, so that the loops over features are unrolled: that halves the time.


@njit(forceinline=True, **_OPTIONS)
def _cell(value, resolution):
    """(index, fraction) of the cell a coordinate in [-1, 1] lies in; clamped outside, cell 0 and NaN for NaN."""
    if value != value:
        return np.uint32(0), value
    position = _HALF * (min(max(value, -_ONE), _ONE) + _ONE) * np.float32(resolution)
    index = min(np.uint32(position), np.uint32(resolution - 1))
    return index, position - np.float32(index)


@njit(forceinline=True, **_OPTIONS)
def _corners(points, n, resolution, entries):
    """The point's fractions and the table rows of its cell's eight corners, x fastest.

    Unsigned all the way: numba need not look for negative indices, and products wrap around as the hash wants.
    """
    x, fx = _cell(points[n, 0], resolution)
    y, fy = _cell(points[n, 1], resolution)
    z, fz = _cell(points[n, 2], resolution)
    side = np.uint64(resolution + 1)
    if side * side * side <= np.uint64(entries):
        first = (np.uint64(z) * side + np.uint64(y)) * side + np.uint64(x)
        second, third, fourth = first + side, first + side * side, first + side * side + side
        one = np.uint64(1)
        rows = (first, first + one, second, second + one, third, third + one, fourth, fourth + one)
    else:
        mask = np.uint32(entries - 1)
        x1 = np.uint32(x + np.uint32(1))
        y0 = np.uint32(y * _PRIME_Y)
        y1 = np.uint32(y0 + _PRIME_Y)
        z0 = np.uint32(z * _PRIME_Z)
        z1 = np.uint32(z0 + _PRIME_Z)
        rows = (
            np.uint64((x ^ y0 ^ z0) & mask), np.uint64((x1 ^ y0 ^ z0) & mask),
            np.uint64((x ^ y1 ^ z0) & mask), np.uint64((x1 ^ y1 ^ z0) & mask),
            np.uint64((x ^ y0 ^ z1) & mask), np.uint64((x1 ^ y0 ^ z1) & mask),
            np.uint64((x ^ y1 ^ z1) & mask), np.uint64((x1 ^ y1 ^ z1) & mask),
        )  # fmt: skip
    return fx, fy, fz, rows


@njit(forceinline=True, **_OPTIONS)
def _encode(points, table, resolution, column, features, first, end, out):
    entries = table.shape[0]
    for n in range(first, end):
        fx, fy, fz, (r0, r1, r2, r3, r4, r5, r6, r7) = _corners(points, n, resolution, entries)
        gx, gy, gz = _ONE - fx, _ONE - fy, _ONE - fz
        w0, w1, w2, w3 = gy * gz, fy * gz, gy * fz, fy * fz
        for f in range(features):
            out[n, column + f] += (
                w0 * (gx * table[r0, f] + fx * table[r1, f])
                + w1 * (gx * table[r2, f] + fx * table[r3, f])
                + w2 * (gx * table[r4, f] + fx * table[r5, f])
                + w3 * (gx * table[r6, f] + fx * table[r7, f])
            )


@njit(parallel=True, **_OPTIONS)
def encode_level(points, table, resolution, column, out):
    """out[:, column : column + features] += trilinear features; ``table`` is (entries, features)."""
    count, features = points.shape[0], table.shape[1]
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        first, end = chunk * _CHUNK, min((chunk + 1) * _CHUNK, count)
        if features == 1:
            _encode(points, table, resolution, column, 1, first, end, out)
        elif features == 2:
            _encode(points, table, resolution, column, 2, first, end, out)
        elif features == 4:
            _encode(points, table, resolution, column, 4, first, end, out)
        else:
            _encode(points, table, resolution, column, features, first, end, out)


@njit(forceinline=True, **_OPTIONS)
def _differentiate_table(points, resolution, column, features, to_out, to_table):
    entries = to_table.shape[0]
    for n in range(points.shape[0]):
        # Of a surface's Gaussians one view shows less than half; what the others say is not asked.
        wanted = False
        for f in range(features):
            wanted |= to_out[n, column + f] != _ZERO
        if not wanted:
            continue
        fx, fy, fz, (r0, r1, r2, r3, r4, r5, r6, r7) = _corners(points, n, resolution, entries)
        gx, gy, gz = _ONE - fx, _ONE - fy, _ONE - fz
        w0, w1, w2, w3 = gy * gz, fy * gz, gy * fz, fy * fz
        for row, weight in (
            (r0, w0 * gx), (r1, w0 * fx), (r2, w1 * gx), (r3, w1 * fx),
            (r4, w2 * gx), (r5, w2 * fx), (r6, w3 * gx), (r7, w3 * fx),
        ):  # fmt: skip
            for f in range(features):
                to_table[row, f] += weight * to_out[n, column + f]


@njit(**_OPTIONS)
def differentiate_table(points, resolution, column, to_out, to_table):
    """Add the gradient by the table to ``to_table``. On one thread: each table has one writer, so no two collide."""
    features = to_table.shape[1]
    if features == 1:
        _differentiate_table(points, resolution, column, 1, to_out, to_table)
    elif features == 2:
        _differentiate_table(points, resolution, column, 2, to_out, to_table)
    elif features == 4:
        _differentiate_table(points, resolution, column, 4, to_out, to_table)
    else:
        _differentiate_table(points, resolution, column, features, to_out, to_table)


@njit(parallel=True, **_OPTIONS)
def differentiate_points(points, table, resolution, column, to_out, to_points):
    """Add the gradient by position to ``to_points``; nothing along an axis where a point is clamped."""
    count, features, entries = points.shape[0], table.shape[1], table.shape[0]
    slope = _HALF * np.float32(resolution)
    for chunk in prange((count + _CHUNK - 1) // _CHUNK):
        for n in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, count)):
            fx, fy, fz, (r0, r1, r2, r3, r4, r5, r6, r7) = _corners(points, n, resolution, entries)
            v0 = v1 = v2 = v3 = v4 = v5 = v6 = v7 = _ZERO
            for f in range(features):
                g = to_out[n, column + f]
                v0 += g * table[r0, f]
                v1 += g * table[r1, f]
                v2 += g * table[r2, f]
                v3 += g * table[r3, f]
                v4 += g * table[r4, f]
                v5 += g * table[r5, f]
                v6 += g * table[r6, f]
                v7 += g * table[r7, f]
            gx, gy, gz = _ONE - fx, _ONE - fy, _ONE - fz
            # Along x first: what is left are the values and x slopes at the four corners of the cell's y-z face.
            a0, a1, a2, a3 = gx * v0 + fx * v1, gx * v2 + fx * v3, gx * v4 + fx * v5, gx * v6 + fx * v7
            if abs(points[n, 0]) <= _ONE:
                to_points[n, 0] += slope * (
                    gz * (gy * (v1 - v0) + fy * (v3 - v2)) + fz * (gy * (v5 - v4) + fy * (v7 - v6))
                )
            if abs(points[n, 1]) <= _ONE:
                to_points[n, 1] += slope * (gz * (a1 - a0) + fz * (a3 - a2))
            if abs(points[n, 2]) <= _ONE:
                to_points[n, 2] += slope * (gy * (a2 - a0) + fy * (a3 - a1))
