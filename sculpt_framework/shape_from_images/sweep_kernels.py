"""Depth by agreement of colours: the loops, for the CPU."""

import numpy as np
from numba import njit, prange

# No "nnan" and "ninf": unknown depths are NaN, and places out of the question cost infinitely much.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_ONE, _HALF = np.float32(1), np.float32(0.5)
"""Not literals: with an integer, be it 1 or a loop's counter, numba makes a float64 of a float32."""
_WINDOW = 9
"""Pixels that are compared together: 3 x 3."""
_NEVER = np.float32(1.0)
"""Cost where a view cannot see the point: the largest difference of colours there is."""
_NEAR = np.float32(1e-3)
_GOOD = np.float32(0.02)
"""A difference of colours that sampling and noise explain: nothing deeper is looked for."""
_TIE = np.float32(1e-3)
"""Costs closer than this are alike."""
# Inlined by numba, not by LLVM as elsewhere: that takes seconds longer to compile, and a tenth less to run.


@njit(inline="always", **_OPTIONS)
def _ray(pose, lens, column, row):
    """The world displacement, per unit of depth, of the ray through an image point."""
    x, y = (column - lens[2]) / lens[0], (row - lens[3]) / lens[1]
    return (
        pose[0, 0] * x + pose[1, 0] * y + pose[2, 0],
        pose[0, 1] * x + pose[1, 1] * y + pose[2, 1],
        pose[0, 2] * x + pose[1, 2] * y + pose[2, 2],
    )


@njit(inline="always", **_OPTIONS)
def _difference(window, colors, lenses, view, point, across, down, enough):
    """Mean absolute difference between a window and its image in another view, given in that view's frame.

    ``point`` is the window's centre, ``across`` and ``down`` lead to its next pixels. Gives up above ``enough``.
    """
    last_column, last_row = np.float32(colors.shape[2] - 1), np.float32(colors.shape[1] - 1)
    fx, fy, cx, cy = lenses[view, 0], lenses[view, 1], lenses[view, 2] - _HALF, lenses[view, 3] - _HALF
    limit = enough * np.float32(3 * _WINDOW)
    total = np.float32(0)
    n = np.uintp(0)
    for a in (-_ONE, np.float32(0), _ONE):
        for b in (-_ONE, np.float32(0), _ONE):
            z = point[2] + a * down[2] + b * across[2]
            if z <= _NEAR:
                return _NEVER
            nearness = _ONE / z
            u = fx * (point[0] + a * down[0] + b * across[0]) * nearness + cx
            v = fy * (point[1] + a * down[1] + b * across[1]) * nearness + cy
            if not (0 <= u < last_column and 0 <= v < last_row):
                return _NEVER
            # Unsigned, so that no index is tested for counting from the end.
            column, row = np.uintp(u), np.uintp(v)
            right, below = u - np.float32(column), v - np.float32(row)
            left, above = _ONE - right, _ONE - below
            next_column, next_row = column + np.uintp(1), row + np.uintp(1)
            for c in range(3):
                upper = colors[view, row, column, c] * left + colors[view, row, next_column, c] * right
                lower = colors[view, next_row, column, c] * left + colors[view, next_row, next_column, c] * right
                total += abs(upper * above + lower * below - window[n, c])
            n += np.uintp(1)
        if total > limit:
            return _NEVER
    return total / np.float32(3 * _WINDOW)


@njit(inline="always", **_OPTIONS)
def _solid(solid, origin, cell, x, y, z):
    i, j, k = int((x - origin[0]) / cell), int((y - origin[1]) / cell), int((z - origin[2]) / cell)
    if x < origin[0] or y < origin[1] or z < origin[2]:
        return False
    if i >= solid.shape[0] or j >= solid.shape[1] or k >= solid.shape[2]:
        return False
    return solid[i, j, k]


@njit(inline="always", **_OPTIONS)
def _cut_window(colors, view, row, column, window):
    """Fill ``window`` with the 3 x 3 pixels around one of the view's."""
    n = 0
    for a in range(-1, 2):
        for b in range(-1, 2):
            for c in range(3):
                window[n, c] = colors[view, row + a, column + b, c]
            n += 1


@njit(inline="always", **_OPTIONS)
def _vertex(before, here, after):
    """Where between its neighbours a minimum lies, by a parabola, in steps; 0 where they do not tell."""
    bend = before + after - np.float32(2) * here
    if not np.float32(1e-6) < bend < np.float32(np.inf):
        return np.float32(0)
    return min(max(np.float32(0.5) * (before - after) / bend, np.float32(-0.5)), np.float32(0.5))


@njit(inline="always", **_OPTIONS)
def _choose(costs, ambiguity):
    """(index, fraction, cost) of the first local minimum no worse than ``ambiguity`` times the best or than what is
    good enough; index -1: none."""
    best = np.float32(np.inf)
    for d in range(costs.shape[0]):
        best = min(best, costs[d])
    if not best < _NEVER:
        return -1, np.float32(0), best
    limit = max(best * ambiguity, _GOOD)
    for d in range(costs.shape[0]):
        here = costs[d]
        before = costs[d - 1] if d > 0 else np.float32(np.inf)
        after = costs[d + 1] if d + 1 < costs.shape[0] else np.float32(np.inf)
        if here <= limit and here <= before and here <= after:
            return d, _vertex(before, here, after), here
    return -1, np.float32(0), best


@njit(inline="always", **_OPTIONS)
def _nearest_minimum(costs, middle):
    """(index, fraction) of the local minimum nearest to the middle among those that are the best, to what noise may
    decide: on a plain surface that is the middle itself."""
    count = costs.shape[0]
    best = np.float32(np.inf)
    for d in range(count):
        best = min(best, costs[d])
    limit = best + _TIE
    for away in range(count):
        for side in range(-1, 2, 2):
            d = middle + side * away
            if not (0 <= d < count and costs[d] <= limit):
                continue
            before = costs[d - 1] if d > 0 else costs[d]
            after = costs[d + 1] if d + 1 < count else costs[d]
            if costs[d] <= before and costs[d] <= after:
                return d, _vertex(before, costs[d], after)
    return middle, np.float32(0)


@njit(inline="always", **_OPTIONS)
def _cost(window, colors, lenses, others, relative, x, y, depth, across, down, best):
    """Mean of the smallest differences to ``others`` that a place at ``depth`` (x, y: its ray at depth 1) would have.

    ``best`` is scratch, as long as the number of differences that count: the other views may not see the place.
    """
    last = best.shape[0] - 1
    best[:] = _NEVER
    right, below = depth * across, depth * down
    for q in range(others.shape[0]):
        cost = _difference(
            window,
            colors,
            lenses,
            np.uintp(others[q]),
            (
                depth * (relative[q, 0, 0] * x + relative[q, 0, 1] * y + relative[q, 0, 2]) + relative[q, 0, 3],
                depth * (relative[q, 1, 0] * x + relative[q, 1, 1] * y + relative[q, 1, 2]) + relative[q, 1, 3],
                depth * (relative[q, 2, 0] * x + relative[q, 2, 1] * y + relative[q, 2, 2]) + relative[q, 2, 3],
            ),
            (right * relative[q, 0, 0], right * relative[q, 1, 0], right * relative[q, 2, 0]),
            (below * relative[q, 0, 1], below * relative[q, 1, 1], below * relative[q, 2, 1]),
            best[last],
        )
        slot = last
        if cost < best[slot]:
            while slot > 0 and cost < best[slot - 1]:
                best[slot] = best[slot - 1]
                slot -= 1
            best[slot] = cost
    total = np.float32(0)
    for q in range(last + 1):
        total += best[q]
    return total / np.float32(last + 1)


@njit(parallel=True, **_OPTIONS)
def sweep(colors, inside, pose, position, lenses, view, others, relative, inverse_depths, solid, origin, cell, best_of, ambiguity, worst, depths):  # fmt: skip # noqa: E501
    """Fill ``depths`` [h, w] of one view: depth along the camera's axis, NaN where none can be told.

    A depth's cost is the mean of the ``best_of`` smallest differences to ``others``, into whose frames ``relative``
    leads. Only places that are ``solid`` come into question. Depths are tried in equal steps of their inverse, from the
    camera on, until one is good.
    """
    height, width = depths.shape
    lens = lenses[view]
    count = inverse_depths.shape[0]
    across, down = _ONE / lens[0], _ONE / lens[1]
    step = (inverse_depths[count - 1] - inverse_depths[0]) / np.float32(count - 1)
    for row in prange(height):
        window = np.empty((_WINDOW, 3), np.float32)
        costs = np.empty(count, np.float32)
        best = np.empty(best_of, np.float32)
        for column in range(width):
            depths[row, column] = np.nan
            if row < 1 or column < 1 or row >= height - 1 or column >= width - 1 or not inside[view, row, column]:
                continue
            _cut_window(colors, view, row, column, window)
            x = (np.float32(column + 0.5) - lens[2]) * across
            y = (np.float32(row + 0.5) - lens[3]) * down
            ray = _ray(pose, lens, np.float32(column + 0.5), np.float32(row + 0.5))
            costs[:] = np.inf
            for d in range(count):
                depth = _ONE / inverse_depths[d]
                place = position[0] + depth * ray[0], position[1] + depth * ray[1], position[2] + depth * ray[2]
                if _solid(solid, origin, cell, place[0], place[1], place[2]):
                    costs[d] = _cost(window, colors, lenses, others, relative, x, y, depth, across, down, best)
                if d > 0 and costs[d - 1] <= _GOOD and costs[d - 1] <= costs[d]:
                    break
            index, fraction, cost = _choose(costs, ambiguity)
            if index >= 0 and cost <= worst:
                depths[row, column] = _ONE / (inverse_depths[index] + fraction * step)


@njit(parallel=True, **_OPTIONS)
def refine(colors, inside, lenses, view, others, relative, known, known_lens, step, reach, best_of, worst, depths, coarse):  # fmt: skip # noqa: E501
    """Fill ``depths`` [h, w] of one view from ``known`` [h2, w2], its depths at a lower resolution, here ``coarse``.

    Each depth known within a pixel around, of the lower resolution, is tried, and ``reach`` steps to both sides;
    ``step`` is of the inverse depth. The one of smallest cost is taken, NaN where none costs less than ``worst``.
    """
    height, width = depths.shape
    lens = lenses[view]
    count = 2 * reach + 1
    across, down = _ONE / lens[0], _ONE / lens[1]
    for row in prange(height):
        window = np.empty((_WINDOW, 3), np.float32)
        costs = np.empty(count, np.float32)
        best = np.empty(best_of, np.float32)
        tried = np.empty(9, np.float32)
        for column in range(width):
            depths[row, column] = np.nan
            if row < 1 or column < 1 or row >= height - 1 or column >= width - 1 or not inside[view, row, column]:
                continue
            x = (np.float32(column + 0.5) - lens[2]) * across
            y = (np.float32(row + 0.5) - lens[3]) * down
            u, v = int(x * known_lens[0] + known_lens[2]), int(y * known_lens[1] + known_lens[3])
            if 0 <= v < known.shape[0] and 0 <= u < known.shape[1]:
                coarse[row, column] = known[v, u]
            _cut_window(colors, view, row, column, window)
            starts = 0
            least = np.float32(worst)
            # The middle first: what its neighbours know is often the same.
            for n in range(9):
                m = (n + 4) % 9
                p, q = v + m // 3 - 1, u + m % 3 - 1
                if not (0 <= p < known.shape[0] and 0 <= q < known.shape[1]):
                    continue
                start = _ONE / known[p, q]
                if not start > 0:
                    continue
                fresh = True
                for other in range(starts):
                    fresh &= abs(tried[other] - start) > step * np.float32(0.75 * reach)
                if not fresh:
                    continue
                tried[starts] = start
                starts += 1
                for d in range(count):
                    depth = _ONE / (start + np.float32(d - reach) * step)
                    costs[d] = _cost(window, colors, lenses, others, relative, x, y, depth, across, down, best)
                index, fraction = _nearest_minimum(costs, reach)
                if costs[index] < least:
                    least = costs[index]
                    depths[row, column] = _ONE / (start + (np.float32(index - reach) + fraction) * step)
                if least <= _GOOD:
                    break


@njit(parallel=True, **_OPTIONS)
def witness(depths, poses, lenses, positions, tolerance, agreeing, contradicting):
    """Per depth, how many points of other views fall on it, and how many on its way, where it should see through.

    A point counts as in the way only if it is in front of the pixels around too: on an outline it may be either's.
    """
    views, height, width = depths.shape
    for i in prange(views):
        for j in range(views):
            if j == i:
                continue
            for row in range(height):
                for column in range(width):
                    depth = depths[j, row, column]
                    if not depth > 0:
                        continue
                    ray = _ray(poses[j], lenses[j], np.float32(column + 0.5), np.float32(row + 0.5))
                    x = positions[j, 0] + depth * ray[0]
                    y = positions[j, 1] + depth * ray[1]
                    z = positions[j, 2] + depth * ray[2]
                    u, v, far = _project(poses, lenses, i, x, y, z)
                    if not (far > _NEAR and 0 <= u < width and 0 <= v < height):
                        continue
                    p, q = int(v), int(u)
                    seen = depths[i, p, q]
                    if abs(seen - far) <= tolerance:
                        agreeing[i, p, q] += 1
                    elif seen > far:
                        through = True
                        for a in range(max(p - 1, 0), min(p + 2, height)):
                            for b in range(max(q - 1, 0), min(q + 2, width)):
                                through &= not depths[i, a, b] <= far + tolerance
                        contradicting[i, p, q] += through


@njit(inline="always", **_OPTIONS)
def _project(poses, lenses, view, x, y, z):
    far = poses[view, 2, 0] * x + poses[view, 2, 1] * y + poses[view, 2, 2] * z + poses[view, 2, 3]
    nearness = _ONE / far
    across = poses[view, 0, 0] * x + poses[view, 0, 1] * y + poses[view, 0, 2] * z + poses[view, 0, 3]
    down = poses[view, 1, 0] * x + poses[view, 1, 1] * y + poses[view, 1, 2] * z + poses[view, 1, 3]
    u, v = lenses[view, 0] * across * nearness, lenses[view, 1] * down * nearness
    return u + lenses[view, 2], v + lenses[view, 3], far


@njit(inline="always", **_OPTIONS)
def _between(depths, view, u, v, jump):
    """Depth at (u, v), in pixels from the middle of the first: interpolated where the four around are of one surface,
    that of the nearest surface where they are not. NaN if none of them is known, or outside of the image."""
    height, width = depths.shape[1], depths.shape[2]
    if not (0 <= u < np.float32(width - 1) and 0 <= v < np.float32(height - 1)):
        return np.float32(np.nan)
    column, row = np.uintp(u), np.uintp(v)
    right, below = u - np.float32(column), v - np.float32(row)
    nearest, furthest = np.float32(np.inf), np.float32(-np.inf)
    total, weight = np.float32(0), np.float32(0)
    for a in range(2):
        for b in range(2):
            depth = depths[view, row + np.uintp(a), column + np.uintp(b)]
            if depth > 0:
                share = (below if a == 1 else _ONE - below) * (right if b == 1 else _ONE - right)
                total += share * depth
                weight += share
                nearest, furthest = min(nearest, depth), max(furthest, depth)
    if not weight > 0:
        return np.float32(np.nan)
    return total / weight if furthest - nearest < jump else nearest


@njit(inline="always", **_OPTIONS)
def _clear(solid, origin, cell, x, y, z, camera):
    """Whether no solid cell lies between a place and a camera, but for the two cells next to the place."""
    dx, dy, dz = camera[0] - x, camera[1] - y, camera[2] - z
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    di, dj, dk = dx / length, dy / length, dz / length
    i, j, k = (x - origin[0]) / cell, (y - origin[1]) / cell, (z - origin[2]) / cell
    i, j, k = i + 2 * di, j + 2 * dj, k + 2 * dk
    left = length / cell - 2
    # What is behind a camera within the volume hides nothing from it.
    while left > 0 and 0 <= i < solid.shape[0] and 0 <= j < solid.shape[1] and 0 <= k < solid.shape[2]:
        if solid[int(i), int(j), int(k)]:
            return False
        i, j, k, left = i + di, j + dj, k + dk, left - 1
    return True


@njit(parallel=True, **_OPTIONS)
def fuse(points, wanted, depths, telling, poses, lenses, positions, truncation, solid, origin, cell, total, count, told, through):  # fmt: skip # noqa: E501
    """Per ``wanted`` point, the sum over views of how far in front of the seen surface it lies, the number of such
    views, the sum of what their images are ``telling`` there, and whether one sees ``through`` it. Other points keep
    what they have.

    Cut at ``truncation`` in front; a view says nothing about what lies deeper than that behind what it sees, nor that a
    place is empty which it would have to see through what is ``solid``.
    """
    for n in prange(points.shape[0]):
        if not wanted[n]:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        total[n], count[n], told[n], through[n] = np.float32(0), np.float32(0), np.float32(0), False
        for i in range(depths.shape[0]):
            u, v, far = _project(poses, lenses, i, x, y, z)
            if not far > _NEAR:
                continue
            ahead = _between(depths, i, u - _HALF, v - _HALF, truncation) - far
            if not ahead >= -truncation:
                continue
            if ahead > truncation:
                through[n] = True
                if not _clear(solid, origin, cell, x, y, z, positions[i]):
                    continue
            total[n] += min(ahead, truncation)
            count[n] += _ONE
            # The depth is known there, so the place is within the image.
            told[n] += telling[i, np.uintp(v), np.uintp(u)]


@njit(parallel=True, **_OPTIONS)
def relax(phi, wanted, share, pull, out):
    """One sweep of Jacobi: ``out`` is ``share`` of (``wanted`` and ``pull`` times the sum of the six neighbours).

    The volume goes on beyond its walls as it is there.
    """
    depth, height, width = phi.shape
    for i in prange(depth):
        back, front = phi[max(i - 1, 0)], phi[min(i + 1, depth - 1)]
        for j in range(height):
            up, down, row = phi[i, max(j - 1, 0)], phi[i, min(j + 1, height - 1)], phi[i, j]
            above, below = back[j], front[j]
            for k in range(width):
                around = above[k] + below[k] + up[k] + down[k] + row[max(k - 1, 0)] + row[min(k + 1, width - 1)]
                out[i, j, k] = (pull * around + wanted[i, j, k]) * share[i, j, k]
