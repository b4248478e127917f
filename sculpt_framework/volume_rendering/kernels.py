"""Stretches of rays and what they hide: the loops, for the CPU."""

import numpy as np
from numba import njit, prange

_OPTIONS = {"fastmath": {"nsz", "contract"}, "error_model": "numpy", "cache": True, "nogil": True}


@njit(**_OPTIONS)
def _is_kept(origin, direction, middle, occupied, low, per_unit):
    """Whether the cell at distance ``middle`` along the ray is occupied; places outside go to the nearest cell."""
    place = np.empty(3, np.int64)
    for axis in range(3):
        at = np.int64(np.floor((origin[axis] + middle * direction[axis] - low[axis]) * per_unit))
        place[axis] = min(max(at, 0), occupied.shape[axis] - 1)
    return occupied[place[0], place[1], place[2]]


@njit(parallel=True, **_OPTIONS)
def count_stretches(origins, directions, starts, numbers, step, occupied, low, per_unit, counts):
    """Fill ``counts`` [r] with how many of the ``numbers`` steps of each ray are kept."""
    half = np.float32(0.5)
    for ray in prange(len(origins)):
        count = 0
        for k in range(numbers[ray]):
            middle = starts[ray] + (np.float32(k) + half) * step
            count += _is_kept(origins[ray], directions[ray], middle, occupied, low, per_unit)
        counts[ray] = count


@njit(parallel=True, **_OPTIONS)
def place_stretches(origins, directions, starts, numbers, step, occupied, low, per_unit, offsets, ray_of, begins):
    """Fill ``ray_of`` and ``begins`` [n] with each kept step's ray and where it begins."""
    half = np.float32(0.5)
    for ray in prange(len(origins)):
        at = offsets[ray]
        for k in range(numbers[ray]):
            middle = starts[ray] + (np.float32(k) + half) * step
            if _is_kept(origins[ray], directions[ray], middle, occupied, low, per_unit):
                ray_of[at] = ray
                begins[at] = starts[ray] + np.float32(k) * step
                at += 1


@njit(parallel=True, **_OPTIONS)
def weigh(alphas, offsets, weights, through):
    """``weights`` [n] of stretches with these opacities, front to back, and what light comes ``through`` [r]."""
    for ray in prange(len(through)):
        light = alphas.dtype.type(1)
        for at in range(offsets[ray], offsets[ray + 1]):
            weights[at] = light * alphas[at]
            light *= 1 - alphas[at]
        through[ray] = light


@njit(parallel=True, **_OPTIONS)
def differentiate_weights(alphas, offsets, to_weights, to_through, light, to_alphas):
    """Fill ``to_alphas`` [n]. ``light`` [n] is for the kernel's own use.

    Back to front, with the slope of the result by the light that arrives behind each stretch. Nothing is divided by
    1 - alpha, so that an opaque stretch has a slope as well.
    """
    for ray in prange(len(to_through)):
        arriving = alphas.dtype.type(1)
        for at in range(offsets[ray], offsets[ray + 1]):
            light[at] = arriving
            arriving *= 1 - alphas[at]
        behind = to_through[ray]
        for at in range(offsets[ray + 1] - 1, offsets[ray] - 1, -1):
            to_alphas[at] = light[at] * (to_weights[at] - behind)
            behind = to_weights[at] * alphas[at] + behind * (1 - alphas[at])
