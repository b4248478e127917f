"""Distances to silhouettes: the loops, for the CPU."""

import math

import numpy as np
from numba import njit, prange

# No "nnan": a point that is not a number has no distance.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_ZERO, _HALF, _NEAR, _NAN = np.float32(0), np.float32(0.5), np.float32(1e-6), np.float32(np.nan)
_LARGEST = np.finfo(np.float32).max
_NEXT = np.uintp(1)
_BLOCK = 4096
"""Points that are looked at together."""


@njit(**_OPTIONS)
def squared_distances(wanted, out):
    """Fill ``out`` [h, w] with the squared distance of each pixel to the nearest ``wanted`` one, exactly, in pixels.

    At least one pixel is wanted. The nearest in each column is found first; along a row the distances to these are
    parabolas, whose lower envelope is kept as a stack (Meijster, Roerdink and Hesselink 2000).
    """
    height, width = wanted.shape
    none = np.int64(height + width)
    gap = np.empty((height, width), np.int64)
    for column in range(width):
        gap[0, column] = 0 if wanted[0, column] else none
    for row in range(1, height):
        for column in range(width):
            gap[row, column] = 0 if wanted[row, column] else gap[row - 1, column] + 1
    for row in range(height - 2, -1, -1):
        for column in range(width):
            gap[row, column] = min(gap[row, column], gap[row + 1, column] + 1)
    lowest, start = np.empty(width, np.int64), np.empty(width, np.int64)
    for row in range(height):
        top = 0
        lowest[0], start[0] = 0, 0
        for column in range(1, width):
            here = gap[row, column]
            while top >= 0:
                at, over = start[top] - lowest[top], gap[row, lowest[top]]
                if at * at + over * over <= (start[top] - column) ** 2 + here * here:
                    break
                top -= 1
            if top < 0:
                top = 0
                lowest[0], start[0] = column, 0
                continue
            before = lowest[top]
            over = gap[row, before]
            first = 1 + (column * column - before * before + here * here - over * over) // (2 * (column - before))
            if first < width:
                top += 1
                lowest[top], start[top] = column, first
        for column in range(width - 1, -1, -1):
            away, over = column - lowest[top], gap[row, lowest[top]]
            out[row, column] = away * away + over * over
            if column == start[top]:
                top -= 1


@njit(**_OPTIONS)
def _project(points, lens, size, depths, beyond, right, below, places):
    """Where points fall: depths, squared distances from the image, and of the pixel below and right of which each is,
    the place in the outline and how far from its centre."""
    height, width = size[0], size[1]
    last_row, last_column, stride = np.float32(height - 1), np.float32(width - 1), np.int32(width + 1)
    for n in range(points.shape[1]):
        x, y, z = points[0, n], points[1, n], points[2, n]
        depth = lens[8] * x + lens[9] * y + lens[10] * z + lens[11]
        column = (lens[0] * x + lens[1] * y + lens[2] * z + lens[3]) / depth
        row = (lens[4] * x + lens[5] * y + lens[6] * z + lens[7]) / depth
        # In this order what is not a number falls on the first pixel, not beyond the outline.
        u, v = column if column > 0 else _ZERO, row if row > 0 else _ZERO
        u, v = u if u < last_column else last_column, v if v < last_row else last_row
        i, j = np.int32(v), np.int32(u)
        depths[n] = depth
        beyond[n] = (column - u) * (column - u) + (row - v) * (row - v)
        right[n], below[n] = u - np.float32(j), v - np.float32(i)
        places[n] = i * stride + j


@njit(**_OPTIONS)
def _look_up(outline, stride, per_depth, is_open, depths, beyond, right, below, places, most):
    """Raise ``most`` to what the outline gives the points."""
    for n in range(most.shape[0]):
        # Unsigned, so that no index is tested for counting from the end.
        upper = np.uintp(places[n])
        lower = upper + stride
        above = outline[upper] + right[n] * (outline[upper + _NEXT] - outline[upper])
        under = outline[lower] + right[n] * (outline[lower + _NEXT] - outline[lower])
        pixels = above + below[n] * (under - above)
        if beyond[n] > 0:
            if is_open:
                continue
            pixels = math.sqrt(pixels * pixels + beyond[n])
        if depths[n] > _NEAR:
            most[n] = max(most[n], pixels * depths[n] * per_depth)


@njit(**_OPTIONS)
def _look_beyond(points, lens, size, per_depth, least):
    """Lower ``least`` to the distances of points from what the image can show, negative inside."""
    # Counted from the middle of the first pixel.
    last_row, last_column = np.float32(size[0]) - _HALF, np.float32(size[1]) - _HALF
    for n in range(points.shape[1]):
        x, y, z = points[0, n], points[1, n], points[2, n]
        depth = lens[8] * x + lens[9] * y + lens[10] * z + lens[11]
        if not depth > _NEAR:
            continue
        column = (lens[0] * x + lens[1] * y + lens[2] * z + lens[3]) / depth
        row = (lens[4] * x + lens[5] * y + lens[6] * z + lens[7]) / depth
        across = max(-_HALF - column, column - last_column)
        along = max(-_HALF - row, row - last_row)
        pixels = max(across, along)
        if across > 0 and along > 0:
            pixels = math.sqrt(across * across + along * along)
        least[n] = min(least[n], pixels * depth * per_depth)


@njit(**_OPTIONS)
def _ahead(points, n, lenses):
    """Whether a point is in front of any camera."""
    for view in range(lenses.shape[0]):
        lens = lenses[view]
        if lens[8] * points[0, n] + lens[9] * points[1, n] + lens[10] * points[2, n] + lens[11] > _NEAR:
            return True
    return False


@njit(parallel=True, **_OPTIONS)
def carve(points, outlines, starts, lenses, per_depth, sizes, is_open, nearest, furthest, distances):
    """Fill ``distances`` with the largest that any view's silhouette gives a point, between ``nearest`` and
    ``furthest``; ``points`` are columns.

    ``outlines`` has the views' signed distances in pixels, one after the other from ``starts`` on, in rows, with a row
    and a column more than ``sizes`` says. ``lenses`` lead to pixels, ``per_depth`` from pixels at depth 1 to lengths. A
    view says nothing about what is behind it, nor, where its silhouette ``is_open`` to the border, of what lies beyond.
    Beyond the border of others nothing is nearer than this: the silhouette is inside. What is behind all views is
    outside. Where all are open, nothing is known of what no image shows: it is outside, as far away as the nearest
    image's edge.
    """
    count, all_open = points.shape[1], is_open.all()
    for block in prange((count + _BLOCK - 1) // _BLOCK):
        # View by view, so that a view's outline stays in the cache; in two loops, the first of which is vectorised.
        begin, end = block * _BLOCK, min((block + 1) * _BLOCK, count)
        some, most = points[:, begin:end], distances[begin:end]
        depths, beyond = np.empty(end - begin, np.float32), np.empty(end - begin, np.float32)
        right, below = np.empty(end - begin, np.float32), np.empty(end - begin, np.float32)
        places = np.empty(end - begin, np.int32)
        most[:] = nearest
        for view in range(starts.shape[0]):
            stride = sizes[view, 1] + 1
            outline = outlines[starts[view] : starts[view] + (sizes[view, 0] + 1) * stride]
            _project(some, lenses[view], sizes[view], depths, beyond, right, below, places)
            _look_up(
                outline, np.uintp(stride), per_depth[view], is_open[view], depths, beyond, right, below, places, most
            )
        if all_open:
            least = np.full(end - begin, furthest)
            for view in range(starts.shape[0]):
                _look_beyond(some, lenses[view], sizes[view], per_depth[view], least)
            for n in range(end - begin):
                most[n] = max(most[n], least[n])
        for n in range(end - begin):
            if most[n] <= nearest and not _ahead(some, n, lenses):
                most[n] = furthest
            known = abs(some[0, n]) + abs(some[1, n]) + abs(some[2, n]) <= _LARGEST
            most[n] = min(most[n], furthest) if known else _NAN
