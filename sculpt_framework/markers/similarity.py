"""The similarity that takes a board, in metres, to the points found of it in the world."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

_ROUNDS = 5
_OUTSIDE, _SIGMA = 3.5, 1.4826
_FLAT = 0.05
"""How wide the points must be across their longest direction, in lengths along it: else they are a line."""
_LEAST = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Similarity:
    """world = scale * rotation @ board + translation."""

    scale: float
    """World units per metre."""
    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, " 3"]
    used: Bool[np.ndarray, " n"]
    """The points that fit."""
    residual: float
    """Root mean square distance of those, in metres."""
    scale_error: float
    """Standard error of the scale, relative, from how well the points fit together."""
    tilt_error: float
    """Standard error of the board's normal, in degrees."""


def fit_similarity(board: Float64[np.ndarray, "n 3"], world: Float64[np.ndarray, "n 3"]) -> Similarity | None:
    """Least squares (Umeyama 1991) without the points that do not fit; rows with NaN are not used.

    None where fewer than four points are left or they lie on a line.
    """
    there = np.asarray(np.isfinite(world).all(axis=1))
    used = there.copy()
    for _ in range(_ROUNDS):
        if used.sum() < _LEAST or not _wide(board[used]):
            return None
        scale, rotation, translation = _umeyama(board[used], world[used])
        if not scale > 0:
            return None
        away = np.linalg.norm(world - (scale * board @ rotation.T + translation), axis=1)
        usual = _SIGMA * float(np.median(away[there]))
        inside = there & (away <= _OUTSIDE * max(usual, 1e-4 * scale * float(np.ptp(board, axis=0).max())))
        if (inside == used).all():
            break
        used = inside
    if used.sum() < _LEAST or not _wide(board[used]):
        return None
    scale, rotation, translation = _umeyama(board[used], world[used])
    rest = (world[used] - (scale * board[used] @ rotation.T + translation)) / scale
    sigma = float(np.sqrt((rest**2).sum() / (3 * len(rest) - 7)))
    spread = board[used] - board[used].mean(axis=0)
    narrow = np.linalg.svd(spread, compute_uv=False)[1]
    return Similarity(
        scale=scale,
        rotation=rotation,
        translation=translation,
        used=used,
        residual=float(np.sqrt((rest**2).sum(axis=1).mean())),
        scale_error=sigma / float(np.linalg.norm(spread)),
        tilt_error=float(np.degrees(sigma / narrow)),
    )


def _wide(points: Float64[np.ndarray, "n 3"]) -> bool:
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(sizes[1] > _FLAT * sizes[0])


def _umeyama(
    board: Float64[np.ndarray, "n 3"], world: Float64[np.ndarray, "n 3"]
) -> tuple[float, Float64[np.ndarray, "3 3"], Float64[np.ndarray, " 3"]]:
    middle, center = board.mean(axis=0), world.mean(axis=0)
    left, sizes, right = np.linalg.svd((world - center).T @ (board - middle))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = left @ np.diag(signs) @ right
    scale = float((sizes * signs).sum() / ((board - middle) ** 2).sum())
    return scale, rotation, center - scale * rotation @ middle
