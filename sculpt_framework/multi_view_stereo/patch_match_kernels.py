"""PatchMatch: the loops over the pixels of one view, for the CPU.

A pixel's hypothesis is a plane: its depth along the camera's axis and its unit normal in the camera's frame, which
faces the camera. A depth of 0 stands for none. Costs are 1 - NCC, cut at 1: what is not correlated is as bad as can be.
"""

import numpy as np
from numba import njit

_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_ONE, _HALF, _ZERO, _TWO = np.float32(1), np.float32(0.5), np.float32(0), np.float32(2)
"""Not literals: with an integer, be it 1 or a loop's counter, numba makes a float64 of a float32."""
_HALF_SIDE = 2
"""Samples from the middle of the window to its last."""
_SAMPLES = (2 * _HALF_SIDE + 1) ** 2
_VALUE, _WEIGHT, _DOWN, _ACROSS, _RIGHT, _BELOW = range(6)
"""Rows of a window: of each sample its luminance, its weight, its offset in pixels, and in another view how far it is
from the pixel above and to the left."""
_NEXT = np.uintp(1)
_NEAR = np.float32(1e-4)
_NEVER = np.float32(1)
"""Cost of a place that a view cannot show, or where nothing correlates."""
_ALIKE = np.float32(0.08)
"""Difference of luminance at which a sample counts half: beyond an edge is often another surface."""
_PLAIN = np.float32(1.5 / 255) ** 2
"""Variance of luminance below which a window is plain: sampling and noise explain it."""
_GRAZING = np.float32(0.1)
"""Cosine between normal and line of sight below which a surface is seen too flat to be compared."""
_FARTHEST_PIXELS = np.float32(3)
"""Pixels of disagreement with another view's depth from which on more of it is no worse."""
_PER_PIXEL = np.float32(0.15)
"""Cost of a pixel of that disagreement."""


@njit(forceinline=True, **_OPTIONS)
def _draw(state):
    """The next state of a linear congruential generator (Knuth's constants) and a number from -1 to 1."""
    state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return state, np.float32(state >> np.uint64(40)) * np.float32(2.0**-23) - _ONE


@njit(forceinline=True, **_OPTIONS)
def _cut_window(luminance, inside, view, row, column, stride, window):
    """Fill the window around a pixel. Returns (sum of weights, weighted mean, variance).

    ``stride`` pixels lie between its samples. Those outside of the mask, or of another luminance than the middle,
    count little or nothing.
    """
    height, width = luminance.shape[1], luminance.shape[2]
    middle = luminance[view, row, column]
    total, first, second = _ZERO, _ZERO, _ZERO
    n = 0
    for p in range(-_HALF_SIDE, _HALF_SIDE + 1):
        for q in range(-_HALF_SIDE, _HALF_SIDE + 1):
            a, b = p * stride, q * stride
            i, j = row + a, column + b
            value, weight = middle, _ZERO
            if 0 <= i < height and 0 <= j < width and inside[view, i, j]:
                value = luminance[view, i, j]
                apart = (value - middle) / _ALIKE
                weight = _ONE / (_ONE + apart * apart)
            window[_VALUE, n], window[_WEIGHT, n] = value, weight
            window[_DOWN, n], window[_ACROSS, n] = np.float32(a), np.float32(b)
            total += weight
            first += weight * value
            second += weight * value * value
            n += 1
    mean = first / total
    return total, mean, second / total - mean * mean


@njit(forceinline=True, **_OPTIONS)
def _difference(luminance, inside, lenses, view, relative, n, ray, normal, offset, pixel, window, places, moments):
    """1 - NCC of a window and its image in another view through a plane; ``offset`` is normal . point.

    The homography is linearised at the window's middle: the window is a few pixels wide.
    """
    height, width = luminance.shape[1], luminance.shape[2]
    # R + t n^T / (n . X) applied to the ray, and its derivatives to column and row.
    scale = (normal[0] * ray[0] + normal[1] * ray[1] + normal[2]) / offset
    right, below = normal[0] / offset * pixel[0], normal[1] / offset * pixel[1]
    tx, ty, tz = relative[n, 0, 3], relative[n, 1, 3], relative[n, 2, 3]
    z = relative[n, 2, 0] * ray[0] + relative[n, 2, 1] * ray[1] + relative[n, 2, 2] + tz * scale
    if not z > _NEAR:
        return _NEVER
    nearness = _ONE / z
    x = (relative[n, 0, 0] * ray[0] + relative[n, 0, 1] * ray[1] + relative[n, 0, 2] + tx * scale) * nearness
    y = (relative[n, 1, 0] * ray[0] + relative[n, 1, 1] * ray[1] + relative[n, 1, 2] + ty * scale) * nearness
    fx, fy = lenses[view, 0], lenses[view, 1]
    u, v = fx * x + lenses[view, 2] - _HALF, fy * y + lenses[view, 3] - _HALF
    za, zd = relative[n, 2, 0] * pixel[0] + tz * right, relative[n, 2, 1] * pixel[1] + tz * below
    ua = fx * (relative[n, 0, 0] * pixel[0] + tx * right - x * za) * nearness
    va = fy * (relative[n, 1, 0] * pixel[0] + ty * right - y * za) * nearness
    ud = fx * (relative[n, 0, 1] * pixel[1] + tx * below - x * zd) * nearness
    vd = fy * (relative[n, 1, 1] * pixel[1] + ty * below - y * zd) * nearness
    reach = window[_DOWN, _SAMPLES - 1]
    most_u, most_v = reach * (abs(ua) + abs(ud)), reach * (abs(va) + abs(vd))
    if not (u >= most_u and v >= most_v and u + most_u < width - 1 and v + most_v < height - 1):
        return _NEVER
    if not inside[view, np.int32(v + _HALF), np.int32(u + _HALF)]:
        return _NEVER
    # In two loops, the first of which is vectorised.
    stride = np.int32(width)
    for k in range(_SAMPLES):
        p = u + window[_DOWN, k] * ud + window[_ACROSS, k] * ua
        q = v + window[_DOWN, k] * vd + window[_ACROSS, k] * va
        column, row = np.int32(p), np.int32(q)
        window[_RIGHT, k], window[_BELOW, k] = p - np.float32(column), q - np.float32(row)
        places[k] = row * stride + column
    image = luminance[view].reshape(-1)
    first, second, mixed = _ZERO, _ZERO, _ZERO
    for k in range(_SAMPLES):
        # Unsigned, so that no index is tested for counting from the end.
        above = np.uintp(places[k])
        under = above + np.uintp(stride)
        upper = image[above] + window[_RIGHT, k] * (image[above + _NEXT] - image[above])
        lower = image[under] + window[_RIGHT, k] * (image[under + _NEXT] - image[under])
        value = upper + window[_BELOW, k] * (lower - upper)
        weighted = window[_WEIGHT, k] * value
        first += weighted
        second += weighted * value
        mixed += weighted * window[_VALUE, k]
    total, mean, variance = moments
    first, second, mixed = first / total, second / total, mixed / total
    others_variance = second - first * first
    if not others_variance > _PLAIN:
        return _NEVER
    return min(_ONE - (mixed - first * mean) / np.sqrt(variance * others_variance), _NEVER)


@njit(forceinline=True, **_OPTIONS)
def _disagreement(depths, lenses, own, view, relative, n, x, y, z, column, row):
    """Pixels between a pixel and where the depth that another view has at its point leads back to."""
    r = relative[n]
    far = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + r[2, 3]
    if not far > _NEAR:
        return _FARTHEST_PIXELS
    p = (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + r[0, 3]) / far
    q = (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + r[1, 3]) / far
    u, v = lenses[view, 0] * p + lenses[view, 2], lenses[view, 1] * q + lenses[view, 3]
    if not (u >= 0 and v >= 0 and u < depths.shape[2] and v < depths.shape[1]):
        return _FARTHEST_PIXELS
    seen = depths[view, np.int32(v), np.int32(u)]
    if not seen > 0:
        return _FARTHEST_PIXELS
    dx, dy, dz = seen * p - r[0, 3], seen * q - r[1, 3], seen - r[2, 3]
    back = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
    if not back > _NEAR:
        return _FARTHEST_PIXELS
    du = lenses[own, 0] * (r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz) / back + lenses[own, 2] - column
    dv = lenses[own, 1] * (r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz) / back + lenses[own, 3] - row
    return min(np.sqrt(du * du + dv * dv), _FARTHEST_PIXELS)


@njit(forceinline=True, **_OPTIONS)
def _cost(luminance, inside, lenses, own, others, asked, judges, relative, before, geometric, counted, ray, place, normal, depth, pixel, window, places, moments, best, order, limit):  # fmt: skip # noqa: E501
    """Mean of the ``counted`` smallest differences that a plane has in the first ``judges`` views of those ``asked``:
    the rest may not see the place. Differences are sorted in ``best``, and whose they are in ``order``.

    Gives up where the mean cannot fall below ``limit``.
    """
    best[:] = _NEVER + _PER_PIXEL * _FARTHEST_PIXELS
    order[:] = asked
    offset = depth * (normal[0] * ray[0] + normal[1] * ray[1] + normal[2])
    for m in range(judges):
        n = asked[m]
        view = others[n]
        cost = _difference(luminance, inside, lenses, view, relative, n, ray, normal, offset, pixel, window, places, moments)  # fmt: skip # noqa: E501
        if geometric:
            x, y = depth * ray[0], depth * ray[1]
            cost += _PER_PIXEL * _disagreement(before, lenses, own, view, relative, n, x, y, depth, place[0], place[1])
        slot = m
        while slot > 0 and cost < best[slot - 1]:
            best[slot], order[slot] = best[slot - 1], order[slot - 1]
            slot -= 1
        best[slot], order[slot] = cost, n
        # Those to come may cost nothing.
        sure = counted - (judges - 1 - m)
        if sure > 0:
            bound = _ZERO
            for k in range(sure):
                bound += best[k]
            if bound >= limit * np.float32(counted):
                return limit
    total = _ZERO
    for k in range(counted):
        total += best[k]
    return total / np.float32(counted)


@njit(**_OPTIONS)
def improve(luminance, inside, lenses, view, others, relative, before, geometric, nearest, farthest, counted, asked, stride, sweeps, span, tries, fresh, seed, depths, normals, costs):  # fmt: skip # noqa: E501
    """Sweep over one view's pixels, each trying the planes of its two neighbours behind it, and some near its own.

    ``depths`` [h, w], ``normals`` [h, w, 3] and ``costs`` [h, w] are changed in place. ``before`` are depths of all
    views [v, h, w], for costs that are ``geometric``. ``nearest`` and ``farthest`` [h, w] bound the depths; a pixel
    whose farthest is 0 is left without a depth, and so are plain ones. A cost is the mean of the ``counted`` smallest
    among the ``asked`` views that see a pixel's present plane best, over windows with ``stride`` pixels between their
    samples. Of the ``tries`` per sweep the first is up to ``span`` pixels away in a view at the median distance, each
    later one a quarter of that. ``fresh`` also tries planes at random.
    """
    height, width = depths.shape
    lens = lenses[view]
    window, places = np.empty((6, _SAMPLES), np.float32), np.empty(_SAMPLES, np.int32)
    ray, place, pixel = np.empty(2, np.float32), np.empty(2, np.float32), np.empty(2, np.float32)
    pixel[0], pixel[1] = _ONE / lens[0], _ONE / lens[1]
    own, tried = np.empty(3, np.float32), np.empty(3, np.float32)
    everyone = np.arange(others.shape[0])
    best, order, spare = np.empty(others.shape[0], np.float32), everyone.copy(), everyone.copy()
    state = np.uint64(seed)
    # Inverse depth that moves the image in a view at the median distance by a pixel.
    baselines = np.sort(np.sqrt((relative[:, :, 3] ** 2).sum(axis=1)))
    per_pixel = _ONE / (baselines[baselines.shape[0] // 2] * lens[0])
    count = 2 + tries + (1 if fresh else 0)
    for sweep in range(sweeps):
        forth = sweep % 2 == 0
        towards = -1 if forth else 1
        for r in range(height):
            row = r if forth else height - 1 - r
            for c in range(width):
                column = c if forth else width - 1 - c
                near, far = nearest[row, column], farthest[row, column]
                if not far > 0:
                    depths[row, column] = _ZERO
                    continue
                moments = _cut_window(luminance, inside, view, row, column, stride, window)
                if not moments[2] > _PLAIN:
                    depths[row, column], costs[row, column] = _ZERO, _NEVER
                    continue
                place[0], place[1] = np.float32(column) + _HALF, np.float32(row) + _HALF
                ray[0], ray[1] = (place[0] - lens[2]) * pixel[0], (place[1] - lens[3]) * pixel[1]
                length = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1] + _ONE)
                depth, least = depths[row, column], np.float32(10)
                own[:] = normals[row, column]
                known = depth > 0
                order[:] = everyone
                for n in range(-1, count):
                    if n == -1:
                        # The present plane first; the views that see it best judge the others.
                        if not known:
                            continue
                        tried[:] = own
                        guess = depth
                    elif n < 2:
                        i, j = (row, column + towards) if n == 0 else (row + towards, column)
                        if not (0 <= i < height and 0 <= j < width and depths[i, j] > 0):
                            continue
                        tried[:] = normals[i, j]
                        across = (np.float32(j) + _HALF - lens[2]) * pixel[0]
                        down = (np.float32(i) + _HALF - lens[3]) * pixel[1]
                        plane = depths[i, j] * (tried[0] * across + tried[1] * down + tried[2])
                        guess = plane / min(tried[0] * ray[0] + tried[1] * ray[1] + tried[2], -_NEAR)
                    elif n < 2 + tries:
                        if not depth > 0:
                            continue
                        share = np.float32(0.25) ** np.float32(n - 2)
                        state, a = _draw(state)
                        state, x = _draw(state)
                        state, y = _draw(state)
                        state, z = _draw(state)
                        guess = _ONE / max(_ONE / depth + a * share * span * per_pixel, _NEAR)
                        wide = share * np.float32(0.7)
                        tried[0], tried[1], tried[2] = own[0] + wide * x, own[1] + wide * y, own[2] + wide * z
                    else:
                        state, a = _draw(state)
                        state, x = _draw(state)
                        state, y = _draw(state)
                        part = _HALF * (a + _ONE)
                        guess = _ONE / (part / near + (_ONE - part) / far)
                        tried[0], tried[1], tried[2] = x - ray[0] / length, y - ray[1] / length, -_ONE / length
                    if not near <= guess <= far:
                        continue
                    norm = np.sqrt(tried[0] * tried[0] + tried[1] * tried[1] + tried[2] * tried[2])
                    tried[0], tried[1], tried[2] = tried[0] / norm, tried[1] / norm, tried[2] / norm
                    if not tried[0] * ray[0] + tried[1] * ray[1] + tried[2] < -_GRAZING * length:
                        continue
                    judges = others.shape[0] if n == -1 or not known else asked
                    cost = _cost(luminance, inside, lenses, view, others, order, judges, relative, before, geometric, counted, ray, place, tried, guess, pixel, window, places, moments, best, spare, least)  # fmt: skip # noqa: E501
                    if n == -1:
                        order[:] = spare
                    if cost < least:
                        least, depth = cost, guess
                        own[:] = tried
                depths[row, column] = depth
                normals[row, column] = own
                costs[row, column] = least


@njit(**_OPTIONS)
def agree(lenses, view, others, relative, depths, normals, pixels, share, near, cosine, agreeing, against):
    """Count per pixel of one view the ``others`` whose depth and normal say the same, and those that say otherwise.

    The same: a point comes back within ``pixels``, its depth within a ``share``, which grows with the depth from
    ``near`` on, the normals within a ``cosine``.
    Otherwise: the other view sees through the point.
    """
    height, width = depths.shape[1], depths.shape[2]
    lens = lenses[view]
    for row in range(height):
        for column in range(width):
            agreeing[row, column], against[row, column] = 0, 0
            depth = depths[view, row, column]
            if not depth > 0:
                continue
            u0, v0 = np.float32(column) + _HALF, np.float32(row) + _HALF
            x, y = depth * (u0 - lens[2]) / lens[0], depth * (v0 - lens[3]) / lens[1]
            for n in range(others.shape[0]):
                other = np.uintp(others[n])
                turn, shift = relative[n, :, :3], relative[n, :, 3]
                far = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * depth + shift[2]
                if not far > _NEAR:
                    continue
                p = (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * depth + shift[0]) / far
                q = (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * depth + shift[1]) / far
                u, v = lenses[other, 0] * p + lenses[other, 2], lenses[other, 1] * q + lenses[other, 3]
                if not (0 <= u < width and 0 <= v < height):
                    continue
                i, j = np.uintp(v), np.uintp(u)
                seen = depths[other, i, j]
                if not seen > 0:
                    continue
                allowed = share * max(far, far * far / near)
                if seen > far + _TWO * allowed:
                    against[row, column] += 1
                    continue
                back = _disagreement(depths, lenses, view, other, relative, n, x, y, depth, u0, v0)
                if back > pixels or abs(seen - far) > allowed:
                    continue
                alike = _ZERO
                for k in range(3):
                    turned = turn[k, 0] * normals[view, row, column, 0] + turn[k, 1] * normals[view, row, column, 1] + turn[k, 2] * normals[view, row, column, 2]  # fmt: skip # noqa: E501
                    alike += turned * normals[other, i, j, k]
                if alike >= cosine:
                    agreeing[row, column] += 1
