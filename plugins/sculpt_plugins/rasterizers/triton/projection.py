"""Gaussians to screen records, and gradients back; one lane per Gaussian."""

import triton
import triton.language as tl

from .layout import (
    ALPHA_MIN,
    GAUSSIANS,
    HALF_LOG2_E,
    LARGEST,
    LOG2_OF_255,
    NEAR,
    TILE,
    load_quad,
    store_quad,
)
from .tiles import columns_reached, rows_reached


@triton.jit
def _load_3(pointer, offsets, mask):
    return (
        tl.load(pointer + offsets, mask=mask, other=0.0),
        tl.load(pointer + offsets + 1, mask=mask, other=0.0),
        tl.load(pointer + offsets + 2, mask=mask, other=0.0),
    )


@triton.jit
def _store_3(pointer, offsets, x, y, z, mask):
    tl.store(pointer + offsets, x, mask=mask)
    tl.store(pointer + offsets + 1, y, mask=mask)
    tl.store(pointer + offsets + 2, z, mask=mask)


@triton.jit
def _dot_3(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@triton.jit
def _camera_rows(pose):
    """The rows of a row-major 4 x 4 world-to-camera matrix, each (x, y, z, shift)."""
    return (
        (tl.load(pose), tl.load(pose + 1), tl.load(pose + 2), tl.load(pose + 3)),
        (tl.load(pose + 4), tl.load(pose + 5), tl.load(pose + 6), tl.load(pose + 7)),
        (tl.load(pose + 8), tl.load(pose + 9), tl.load(pose + 10), tl.load(pose + 11)),
    )


@triton.jit
def _on_screen(point, scale, rotation, rows, lens, low_pass):
    """What forward and backward pass both need of a Gaussian; see rendering/projection.py for the definition.

    Returns 1 / depth, x/z and y/z, the two as clamped, the two rows w of J W times depth / focal length, the two rows p
    of J W R, their products a, b with the scales, and of the covariance xx, xy, yy and the determinant.
    """
    fx, fy, low_x, high_x, low_y, high_y = lens
    column, row, forward = rows
    inverse = 1.0 / (_dot_3(forward, point) + forward[3])
    along_x = (_dot_3(column, point) + column[3]) * inverse
    along_y = (_dot_3(row, point) + row[3]) * inverse
    at_x = tl.minimum(tl.maximum(along_x, low_x), high_x)
    at_y = tl.minimum(tl.maximum(along_y, low_y), high_y)
    w = (column[0] - at_x * forward[0], column[1] - at_x * forward[1], column[2] - at_x * forward[2])
    v = (row[0] - at_y * forward[0], row[1] - at_y * forward[1], row[2] - at_y * forward[2])
    jx, jy = fx * inverse, fy * inverse
    p = (jx * _dot_3(w, rotation[0]), jx * _dot_3(w, rotation[1]), jx * _dot_3(w, rotation[2]))
    q = (jy * _dot_3(v, rotation[0]), jy * _dot_3(v, rotation[1]), jy * _dot_3(v, rotation[2]))
    a = (scale[0] * p[0], scale[1] * p[1], scale[2] * p[2])
    b = (scale[0] * q[0], scale[1] * q[1], scale[2] * q[2])
    aa, ab, bb = _dot_3(a, a), _dot_3(a, b), _dot_3(b, b)
    # det(A A^T + h I) by Cauchy-Binet: a sum of squares, where aa bb - ab^2 would cancel for slivers.
    m = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    determinant = _dot_3(m, m) + low_pass * (aa + bb) + low_pass * low_pass
    return inverse, along_x, along_y, at_x, at_y, w, v, p, q, a, b, aa + low_pass, ab, bb + low_pass, determinant


@triton.jit
def _load_gaussian(means, scales, rotations, gaussian, mask):
    """Mean, scales, and the columns of the rotation."""
    first = _load_3(rotations, gaussian * 9, mask)
    second = _load_3(rotations, gaussian * 9 + 3, mask)
    third = _load_3(rotations, gaussian * 9 + 6, mask)
    columns = (
        (first[0], second[0], third[0]),
        (first[1], second[1], third[1]),
        (first[2], second[2], third[2]),
    )
    return _load_3(means, gaussian * 3, mask), _load_3(scales, gaussian * 3, mask), columns


@triton.jit(do_not_specialize=["count", "width", "height"])
def project(
    means, scales, rotations, opacities, features, pose, fx, fy, cx, cy, low_x, high_x, low_y, high_y, low_pass,
    width, height, count, records, depths, counts, CHANNELS: tl.constexpr, RECORD: tl.constexpr,
):  # fmt: skip
    """Fill ``records`` and ``depths`` of what is drawn, and ``counts`` (of tiles, 0: not drawn) of all."""
    gaussian = (tl.program_id(0) * GAUSSIANS + tl.arange(0, GAUSSIANS)).to(tl.int64)
    inside = gaussian < count
    point, scale, rotation = _load_gaussian(means, scales, rotations, gaussian, inside)
    opacity = tl.load(opacities + gaussian, mask=inside, other=0.0)
    rows = _camera_rows(pose)
    depth = _dot_3(rows[2], point) + rows[2][3]
    lens = (fx, fy, low_x, high_x, low_y, high_y)
    _, along_x, along_y, _, _, _, _, _, _, _, _, xx, xy, yy, determinant = _on_screen(
        point, scale, rotation, rows, lens, low_pass
    )
    mean_x, mean_y = fx * along_x + cx, fy * along_y + cy
    steep = tl.sqrt(xx * HALF_LOG2_E / determinant)
    slant = -steep * xy / xx
    curve = 1.0 / xx * -HALF_LOG2_E
    level = tl.log2(tl.maximum(opacity, ALPHA_MIN))
    reach = (level + LOG2_OF_255) / HALF_LOG2_E
    size = tl.abs(mean_x) + tl.abs(mean_y) + steep + tl.abs(slant) - curve + tl.abs(level) + depth
    size += tl.sqrt(reach * xx) + tl.sqrt(reach * yy)
    for c in tl.static_range(CHANNELS):
        size += tl.abs(tl.load(features + gaussian * CHANNELS + c, mask=inside, other=0.0))
    # False for what is not a number, too.
    drawn = inside & (depth >= NEAR) & (opacity >= ALPHA_MIN) & (size < LARGEST) & (determinant < 3e38)

    # What is not drawn takes part in the search for tiles with values that do no harm.
    mean_x, mean_y = tl.where(drawn, mean_x, 0.0), tl.where(drawn, mean_y, 0.0)
    curve, slant, steep = tl.where(drawn, curve, -1.0), tl.where(drawn, slant, 0.0), tl.where(drawn, steep, 1.0)
    level = tl.where(drawn, level, 0.0)
    top, bottom = rows_reached(mean_y, curve, slant, steep, level, height)
    tile_rows = tl.where(drawn & (bottom >= top), bottom // TILE - top // TILE + 1, 0)
    tiles = tl.zeros_like(tile_rows)
    tile_row, most = 0, tl.max(tile_rows)
    while tile_row < most:
        first, end = columns_reached(
            top // TILE + tile_row, top, bottom, mean_x, mean_y, curve, slant, steep, level, width
        )
        tiles += tl.where(tile_row < tile_rows, end - first, 0)
        tile_row += 1

    tl.store(counts + gaussian, tiles, mask=inside)
    tl.store(depths + gaussian, tl.where(drawn, depth, 0.0), mask=inside)
    listed = tiles > 0
    record = gaussian * RECORD
    store_quad(records, record, mean_x, mean_y, curve, slant, listed)
    feature = tl.load(features + gaussian * CHANNELS, mask=listed, other=0.0)
    store_quad(records, record + 4, steep, level, depth, feature, listed)
    for c in tl.static_range(1, CHANNELS):
        feature = tl.load(features + gaussian * CHANNELS + c, mask=listed, other=0.0)
        tl.store(records + record + 7 + c, feature, mask=listed)


@triton.jit
def _sums_of_entry(row_sums, offsets, mask, mean_x, mean_y, ratio, root):
    """Of one entry per lane the sums of s, s dx, s v, s dx^2, s dx v, s v^2 with v = root (dy - ratio dx).

    The rows hold moments about the centre of the tile, within which neither dx nor v changes by much; shifted to a mean
    far away they do not cancel, as all dx are then nearly the same.
    """
    one, x, y, xx = load_quad(row_sums, offsets, mask)
    xy, yy, center_x, center_y = load_quad(row_sums, offsets + 4, mask)
    shift_x = center_x - mean_x
    shift_v = root * ((center_y - mean_y) - ratio * shift_x)
    # v = shift_v + root (y - ratio x).
    v = root * (y - ratio * x)
    xv = root * (xy - ratio * xx)
    vv = root * root * (yy - ratio * (2.0 * xy - ratio * xx))
    return (
        one,
        x + shift_x * one,
        v + shift_v * one,
        xx + shift_x * (2.0 * x + shift_x * one),
        xv + shift_v * x + shift_x * (v + shift_v * one),
        vv + shift_v * (2.0 * v + shift_v * one),
    )


@triton.jit(do_not_specialize=["count"])
def project_backward(
    means, scales, rotations, opacities, pose, fx, fy, cx, cy, low_x, high_x, low_y, high_y, low_pass,
    count, first_entries, counts, seen, row_sums,
    to_means, to_scales, to_rotations, to_opacities, to_features, to_pose_parts,
    CHANNELS: tl.constexpr, SUMS: tl.constexpr, WANTS_POSE: tl.constexpr,
):  # fmt: skip
    """Gradients from the sums of each Gaussian's entries, added up in the order of its tiles.

    ``to_pose_parts`` gets the 12 gradients of the pose from this program's Gaussians, one row per program.
    """
    gaussian = (tl.program_id(0) * GAUSSIANS + tl.arange(0, GAUSSIANS)).to(tl.int64)
    inside = gaussian < count
    tiles = tl.load(counts + gaussian, mask=inside, other=0)
    listed = tiles > 0
    point, scale, rotation = _load_gaussian(means, scales, rotations, gaussian, listed)
    rows = _camera_rows(pose)
    column, row, forward = rows
    lens = (fx, fy, low_x, high_x, low_y, high_y)
    inverse, along_x, along_y, at_x, at_y, w, v, p, q, a, b, xx, xy, yy, determinant = _on_screen(
        point, scale, rotation, rows, lens, low_pass
    )
    mean_x, mean_y = fx * along_x + cx, fy * along_y + cy
    ratio, root = xy / xx, tl.sqrt(xx / determinant)

    first = tl.load(first_entries + gaussian, mask=listed, other=0).to(tl.int64)
    none = tl.zeros((GAUSSIANS,), tl.float32)
    s, s_x, s_v, s_xx, s_xv, s_vv, to_depth = none, none, none, none, none, none, none
    to_feature = (none,)
    for _ in tl.static_range(1, CHANNELS):
        to_feature = to_feature + (none,)
    entry, most = 0, tl.max(tiles)
    while entry < most:
        listed_here = entry < tiles
        # The rows of entries that the forward pass did not come to have never been written.
        here = listed_here & (tl.load(seen + first + entry, mask=listed_here, other=0) != 0)
        offsets = (first + entry) * SUMS
        more = _sums_of_entry(row_sums, offsets, here, mean_x, mean_y, ratio, root)
        s += more[0]
        s_x += more[1]
        s_v += more[2]
        s_xx += more[3]
        s_xv += more[4]
        s_vv += more[5]
        to_depth += tl.load(row_sums + offsets + 8, mask=here, other=0.0)
        total = ()
        for c in tl.static_range(CHANNELS):
            total = total + (to_feature[c] + tl.load(row_sums + offsets + 9 + c, mask=here, other=0.0),)
        to_feature = total
        entry += 1

    for c in tl.static_range(CHANNELS):
        tl.store(to_features + gaussian * CHANNELS + c, to_feature[c], mask=inside)
    opacity = tl.load(opacities + gaussian, mask=listed, other=1.0)
    tl.store(to_opacities + gaussian, s / opacity, mask=inside)

    # q = d^T K d = dx^2 / xx + v^2, so that K d = (dx / xx - ratio root v, root v): sums of products of the two terms.
    n_x, n_v = s_x / xx, s_v * root
    n_xx, n_xv, n_vv = s_xx / (xx * xx), s_xv / xx * root, s_vv * root * root
    to_x = fx * (n_x - ratio * n_v)
    to_y = fy * n_v
    # Twice the gradient by the covariance: sum of s (K d) (K d)^T.
    g_xx = n_xx - ratio * (2.0 * n_xv - ratio * n_vv)
    g_xy = n_xv - ratio * n_vv
    g_yy = n_vv
    to_a = (g_xx * a[0] + g_xy * b[0], g_xx * a[1] + g_xy * b[1], g_xx * a[2] + g_xy * b[2])
    to_b = (g_xy * a[0] + g_yy * b[0], g_xy * a[1] + g_yy * b[1], g_xy * a[2] + g_yy * b[2])
    _store_3(
        to_scales,
        gaussian * 3,
        _kept(listed, to_a[0] * p[0] + to_b[0] * q[0]),
        _kept(listed, to_a[1] * p[1] + to_b[1] * q[1]),
        _kept(listed, to_a[2] * p[2] + to_b[2] * q[2]),
        inside,
    )
    # By the columns of R, seen through either row of J W.
    jx, jy = fx * inverse, fy * inverse
    to_a = (jx * scale[0] * to_a[0], jx * scale[1] * to_a[1], jx * scale[2] * to_a[2])
    to_b = (jy * scale[0] * to_b[0], jy * scale[1] * to_b[1], jy * scale[2] * to_b[2])
    for axis in tl.static_range(3):
        _store_3(
            to_rotations,
            gaussian * 9 + 3 * axis,
            _kept(listed, to_a[0] * w[axis] + to_b[0] * v[axis]),
            _kept(listed, to_a[1] * w[axis] + to_b[1] * v[axis]),
            _kept(listed, to_a[2] * w[axis] + to_b[2] * v[axis]),
            inside,
        )
    # By w and v, the rows of J W times depth / focal length.
    to_w = (_by_row(to_a, rotation, 0), _by_row(to_a, rotation, 1), _by_row(to_a, rotation, 2))
    to_v = (_by_row(to_b, rotation, 0), _by_row(to_b, rotation, 1), _by_row(to_b, rotation, 2))
    # Where the direction is clamped it has no gradient.
    to_x -= tl.where(at_x == along_x, _dot_3(to_w, forward), 0.0)
    to_y -= tl.where(at_y == along_y, _dot_3(to_v, forward), 0.0)
    stretching = _dot_3(to_w, w) + _dot_3(to_v, v)
    to_z = _kept(listed, to_depth - inverse * (to_x * along_x + to_y * along_y + stretching))
    to_x, to_y = _kept(listed, to_x * inverse), _kept(listed, to_y * inverse)
    _store_3(
        to_means,
        gaussian * 3,
        column[0] * to_x + row[0] * to_y + forward[0] * to_z,
        column[1] * to_x + row[1] * to_y + forward[1] * to_z,
        column[2] * to_x + row[2] * to_y + forward[2] * to_z,
        inside,
    )
    if WANTS_POSE:
        part = to_pose_parts + tl.program_id(0) * 12
        for axis in tl.static_range(3):
            by_w, by_v = _kept(listed, to_w[axis]), _kept(listed, to_v[axis])
            tl.store(part + axis, tl.sum(to_x * point[axis] + by_w))
            tl.store(part + 4 + axis, tl.sum(to_y * point[axis] + by_v))
            tl.store(part + 8 + axis, tl.sum(to_z * point[axis] - _kept(listed, at_x * by_w + at_y * by_v)))
        tl.store(part + 3, tl.sum(to_x))
        tl.store(part + 7, tl.sum(to_y))
        tl.store(part + 11, tl.sum(to_z))


@triton.jit
def _kept(mask, value):
    """Zero where masked, also in place of what is not finite."""
    return tl.where(mask, value, 0.0)


@triton.jit
def _by_row(by_columns, columns, axis: tl.constexpr):
    """Entry ``axis`` of the product of a matrix, given by its columns, with a vector."""
    return by_columns[0] * columns[0][axis] + by_columns[1] * columns[1][axis] + by_columns[2] * columns[2][axis]
