"""Photographs of a box on a floor, both with texture, from places that are known."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

FOCAL = 1.1
"""Of the image's longer side."""
_FACES = (
    # Corners of the floor, then of the faces of a box on it, counter-clockwise as seen from outside.
    ((-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)),
    ((-0.6, -0.6, 1), (0.6, -0.6, 1), (0.6, 0.6, 1), (-0.6, 0.6, 1)),
    ((-0.6, -0.6, 0), (0.6, -0.6, 0), (0.6, -0.6, 1), (-0.6, -0.6, 1)),
    ((0.6, -0.6, 0), (0.6, 0.6, 0), (0.6, 0.6, 1), (0.6, -0.6, 1)),
    ((0.6, 0.6, 0), (-0.6, 0.6, 0), (-0.6, 0.6, 1), (0.6, 0.6, 1)),
    ((-0.6, 0.6, 0), (-0.6, -0.6, 0), (-0.6, -0.6, 1), (-0.6, 0.6, 1)),
)
_CELLS = 512


@dataclass(frozen=True, kw_only=True, eq=False)
class Photograph:
    image: np.ndarray
    """BGR."""
    world_to_camera: np.ndarray
    """4x4, OpenCV axes."""


def photographs(
    angles: Sequence[float], width: int = 320, height: int = 240, *, above: float = 2.2
) -> list[Photograph]:
    """From a ring, 4 from the axis and so far ``above`` the floor, at these angles in degrees."""
    generator = np.random.default_rng(5)
    textures = [_texture(generator, 8 if index == 0 else 3) for index in range(len(_FACES))]
    return [_photograph(np.deg2rad(angle), above, width, height, textures) for angle in angles]


def save(shots: Sequence[Photograph], folder: Path) -> list[str]:
    """As JPEGs with names in their order; the names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"view {index:02}.jpg" for index in range(len(shots))]
    for name, shot in zip(names, shots, strict=True):
        assert cv2.imwrite(str(folder / name), shot.image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return names


def _photograph(angle: float, above: float, width: int, height: int, textures: Sequence[np.ndarray]) -> Photograph:
    place = np.array([4 * np.cos(angle), 4 * np.sin(angle), above])
    ahead = np.array([0, 0, 0.4]) - place
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ place
    focal = FOCAL * max(width, height)
    lens = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    image = np.full((height, width, 3), 200, np.uint8)
    for corners, texture in zip(np.array(_FACES, float), textures, strict=True):
        outward = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        if outward @ (place - corners[0]) <= 0:
            continue
        seen = (corners @ pose[:3, :3].T + pose[:3, 3]) @ lens.T
        # A pixel's centre is half a pixel from its corner, and at a whole number where images are warped.
        pixels = (seen[:, :2] / seen[:, 2:] - 0.5).astype(np.float32)
        square = np.array([[0, 0], [_CELLS, 0], [_CELLS, _CELLS], [0, _CELLS]], np.float32) - 0.5
        warp = cv2.getPerspectiveTransform(square.astype(np.float32), pixels)
        drawn = cv2.warpPerspective(texture, warp, (width, height), flags=cv2.INTER_AREA)
        inside = cv2.warpPerspective(np.full((_CELLS, _CELLS), 255, np.uint8), warp, (width, height)) > 127
        image[inside] = drawn[inside]
    return Photograph(image=image, world_to_camera=pose)


def _texture(generator: np.random.Generator, finest: int) -> np.ndarray:
    out = np.zeros((_CELLS, _CELLS, 3), np.float32)
    for cells in (finest * 4, finest * 8, finest * 16):
        noise = generator.uniform(0, 1, (cells, cells, 3)).astype(np.float32)
        out += cv2.resize(noise, (_CELLS, _CELLS), interpolation=cv2.INTER_CUBIC)
    return np.rint(cv2.normalize(out, np.empty_like(out), 10, 245, cv2.NORM_MINMAX)).astype(np.uint8)
