"""Where the K Gaussians of a face start.

Coincident Gaussians never separate (equal gradients), so each K has a table of distinct barycentric coordinates,
symmetric under the triangle's rotations as far as K allows.
"""

import torch
from jaxtyping import Float
from torch import Tensor

MAX_PER_FACE = 12
_THIRD = 1.0 / 3.0


def _ring(towards: float) -> list[tuple[float, float, float]]:
    """Three points on the medians; ``towards`` is the weight of the corner each is nearest to (or farthest from)."""
    rest = 0.5 * (1.0 - towards)
    return [(towards, rest, rest), (rest, towards, rest), (rest, rest, towards)]


def _pair_ring(first: float, second: float) -> list[tuple[float, float, float]]:
    """Six points: all orders of (first, second, rest)."""
    third = 1.0 - first - second
    weights = (first, second, third)
    orders = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
    return [(weights[i], weights[j], weights[k]) for i, j, k in orders]


_CENTER = [(_THIRD, _THIRD, _THIRD)]
_TABLES: dict[int, list[tuple[float, float, float]]] = {
    1: _CENTER,
    2: [(0.5, 0.25, 0.25), (0.2, 0.4, 0.4)],
    3: _ring(2.0 / 3.0),
    4: _ring(0.7) + _CENTER,
    5: [*_ring(0.74), (0.14, 0.43, 0.43), (0.42, 0.29, 0.29)],
    6: _ring(0.78) + _ring(0.12),
    7: _ring(0.8) + _ring(0.1) + _CENTER,
    8: _ring(0.82) + _ring(0.08) + [(0.46, 0.27, 0.27), (0.22, 0.39, 0.39)],
    9: _ring(0.82) + _pair_ring(0.58, 0.32),
    10: _ring(0.82) + _pair_ring(0.58, 0.34) + _CENTER,
    11: _ring(0.84) + _pair_ring(0.6, 0.33) + [(0.44, 0.28, 0.28), (0.24, 0.38, 0.38)],
    12: _ring(0.84) + _pair_ring(0.6, 0.34) + _ring(0.2),
}


def placement(gaussians_per_face: int) -> Float[Tensor, "k 3"]:
    """Distinct barycentric coordinates, positive, each summing to one.

    Raises ValueError outside 1 to 12.
    """
    if gaussians_per_face not in _TABLES:
        raise ValueError(f"Gaussians per face must be 1 to {MAX_PER_FACE}, not {gaussians_per_face}")
    return torch.tensor(_TABLES[gaussians_per_face], dtype=torch.float64)
