"""Where the demo cameras stand: at distances 3.8 to 4.2 from the object, looking at it."""

from typing import Literal

import numpy as np
import torch
from jaxtyping import Float

from sculpt_framework.types import Camera

FIELD_OF_VIEW = 0.6911
"""Horizontal, in radians."""
_GOLDEN = 0.6180339887498949

Placement = Literal["around", "above", "front"]
"""Seen from all sides, 70 % of the cameras above the equator; only from above it; only from azimuths within 75 degrees
of +x, above and below."""

_BELOW: dict[Placement, float] = {"around": 0.3, "above": 0.0, "front": 0.3}
_FRONT = 75 / 360


def demo_cameras(count: int, resolution: int, offset: int = 0, placement: Placement = "around") -> tuple[Camera, ...]:
    """``count`` cameras of square images; another ``offset`` gives others.

    Places follow a low-discrepancy sequence, so that any number of them is spread evenly, and every tenth too.
    """
    return tuple(_camera(_position(offset + index, placement), resolution) for index in range(count))


def _position(index: int, placement: Placement) -> Float[np.ndarray, " 3"]:
    turn = (index * _GOLDEN) % 1
    azimuth = 2 * np.pi * (_FRONT * (2 * turn - 1) if placement == "front" else turn)
    level, below = _van_der_corput(index, 2), _BELOW[placement]
    # The sine of the elevation, for even density on the sphere; the poles are left out as no up direction exists there.
    height = 0.97 * (level - below) / (1 - below) if level > below else -0.9 * level / below
    distance = 3.8 + 0.4 * _van_der_corput(index, 3)
    wide = np.sqrt(1 - height * height)
    return distance * np.array([wide * np.cos(azimuth), wide * np.sin(azimuth), height])


def _van_der_corput(index: int, base: int) -> float:
    """The digits of ``index + 1`` mirrored at the point."""
    index, value, step = index + 1, 0.0, 1.0
    while index:
        step /= base
        index, digit = divmod(index, base)
        value += digit * step
    return value


def _camera(position: Float[np.ndarray, " 3"], resolution: int) -> Camera:
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation
    world_to_camera[:3, 3] = -rotation @ position
    focal = 0.5 * resolution / np.tan(0.5 * FIELD_OF_VIEW)
    middle = 0.5 * resolution
    return Camera(
        world_to_camera=torch.from_numpy(world_to_camera),
        fx=float(focal),
        fy=float(focal),
        cx=middle,
        cy=middle,
        width=resolution,
        height=resolution,
    )
