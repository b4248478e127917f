"""A picture of a posing: cameras and points from above and from the side."""

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from sculpt_framework.posing.upright import centers

_SIDE = 700
_INK, _CAMERA = (40, 44, 52), (25, 90, 170)
"""sRGB."""
_SPAN = 1.15
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_posing(
    poses: Float64[np.ndarray, "n 4 4"], points: Float64[np.ndarray, "p 3"], colors: UInt8[np.ndarray, "p 3"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Two plans of a scene whose z is up, sRGB. ``poses`` are from world to camera; points beyond the cameras'
    surroundings are left out."""
    plans = [
        _plan(poses, points, colors, axes, title)
        for axes, title in (((0, 1), "from above: x right, y up"), ((0, 2), "from the side: x right, z up"))
    ]
    return np.hstack(plans)


def _plan(
    poses: Float64[np.ndarray, "n 4 4"],
    points: Float64[np.ndarray, "p 3"],
    colors: UInt8[np.ndarray, "p 3"],
    axes: tuple[int, int],
    title: str,
) -> UInt8[np.ndarray, "h w 3"]:
    out = np.full((_SIDE, _SIDE, 3), 250, np.uint8)
    places = centers(poses)
    # The origin is what the cameras look at.
    half = _SPAN * max(float(np.abs(places).max()), 1e-12)

    def place(where: Float64[np.ndarray, "m 3"]) -> list[list[int]]:
        return np.rint(_SIDE / 2 * (1 + where[:, axes] / half * (1, -1))).astype(np.int64).tolist()

    inside = (np.abs(points) < half).all(axis=1)
    for (column, row), color in zip(place(points[inside]), colors[inside].tolist(), strict=True):
        cv2.circle(out, (column, row), 1, color, -1)
    ahead = places + 0.08 * half * poses[:, 2, :3]
    for start, end in zip(place(places), place(ahead), strict=True):
        cv2.line(out, start, end, _CAMERA, 1, cv2.LINE_AA)
        cv2.circle(out, start, 3, _CAMERA, -1, cv2.LINE_AA)
    cv2.putText(out, f"{title}; {len(poses)} cameras", (12, 22), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
    return out
