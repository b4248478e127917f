"""Photographs of a printed board by known cameras: the sheet, warped to what a pinhole sees of it, with noise."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from sculpt_framework.markers.boards import Board
from sculpt_framework.markers.sheets import PIXELS, draw_sheet
from sculpt_framework.types import Box, Camera, Scene, View

WIDTH, HEIGHT, FOCAL = 640, 480, 620.0
AWAY = 0.5
"""Metres of the cameras from the board's middle."""
BALL = 0.035
"""Radius of the plain ball that stands on the board, in metres."""
_SHRUNK = 4
SCALE, SHIFT = 3.7, np.array([1.0, 2.0, -0.5])
TURN = np.asarray(cv2.Rodrigues(np.array([0.5, -1.1, 0.3]))[0])
"""From the board's frame to the world: x_world = SCALE TURN x + SHIFT."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PrintedBoard:
    pixels: np.ndarray
    to_board: np.ndarray
    """From the sheet's pixels to metres on the board."""


def printed(board: Board, size: float = 1.0) -> PrintedBoard:
    """A sheet, printed at so many times its size."""
    sheet = draw_sheet(board, "a4")
    small = cv2.resize(sheet.pixels, None, fx=1 / _SHRUNK, fy=1 / _SHRUNK, interpolation=cv2.INTER_AREA)
    metre = 1e-3 * size * _SHRUNK / PIXELS
    x, y = sheet.origin[0] / _SHRUNK, sheet.origin[1] / _SHRUNK
    return PrintedBoard(pixels=small, to_board=np.array([[metre, 0, -x * metre], [0, -metre, y * metre], [0, 0, 1]]))


def around(count: int, *, low: float = 32, high: float = 62, seed: int = 0) -> list[np.ndarray]:
    """Poses, board to camera, on a ring around the board, at elevations between these degrees."""
    heights = np.radians(np.random.default_rng(seed).uniform(low, high, count))
    poses = []
    for turn, height in zip(np.arange(count) * (2 * math.pi / count), heights, strict=True):
        place = AWAY * np.array([np.cos(turn) * np.cos(height), np.sin(turn) * np.cos(height), np.sin(height)])
        forward = -place / AWAY
        right = np.cross(forward, (0, 0, 1.0))
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ place
        poses.append(pose)
    return poses


def photograph(
    boards: Sequence[tuple[PrintedBoard, np.ndarray]], pose: np.ndarray, *, seed: int, ball: bool = True
) -> np.ndarray:
    """Grey, 8 bit. Each board lies where its own matrix puts it in the frame of ``pose``."""
    image = np.full((2 * HEIGHT, 2 * WIDTH), 115, np.uint8)
    lens = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    for board, place in boards:
        whole = lens @ (pose @ place)[:3, [0, 1, 3]] @ board.to_board
        matrix = np.linalg.inv(half) @ np.diag([2.0, 2.0, 1.0]) @ whole @ half
        cv2.warpPerspective(
            board.pixels, matrix, (2 * WIDTH, 2 * HEIGHT), image, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT
        )
    image = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    if ball:
        center = pose[:3, :3] @ (0, 0, BALL) + pose[:3, 3]
        columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        ways = np.stack([(columns - WIDTH / 2) / FOCAL, (rows - HEIGHT / 2) / FOCAL, np.ones((HEIGHT, WIDTH))], axis=-1)
        along = ways @ center / np.linalg.norm(ways, axis=-1)
        image = np.where(center @ center - along**2 < BALL**2, 128, image)
    noise = np.random.default_rng(seed).normal(0, 3, image.shape)
    return (0.8 * image + 20 + noise).clip(0, 255).astype(np.uint8)


def photographs(board: Board, poses: Sequence[np.ndarray], *, size: float = 1.0) -> list[np.ndarray]:
    sheet = [(printed(board, size), np.eye(4))]
    return [photograph(sheet, pose, seed=index) for index, pose in enumerate(poses)]


def scene_of(images: Sequence[np.ndarray], poses: Sequence[np.ndarray]) -> Scene:
    """As a reader hands it over, in a world of other units and axes than the board's."""
    views = []
    for index, (image, pose) in enumerate(zip(images, poses, strict=True)):
        matrix = np.eye(4)
        matrix[:3, :3] = pose[:3, :3] @ TURN.T
        matrix[:3, 3] = SCALE * pose[:3, 3] - matrix[:3, :3] @ SHIFT
        camera = Camera(
            world_to_camera=torch.from_numpy(matrix),
            fx=FOCAL,
            fy=FOCAL,
            cx=WIDTH / 2,
            cy=HEIGHT / 2,
            width=WIDTH,
            height=HEIGHT,
        )
        rgb = torch.from_numpy(np.repeat(image[..., None], 3, axis=2).astype(np.float32) / 255)
        views.append(View(name=f"images/p{index}", camera=camera, rgb=rgb, alpha=None))
    box = Box(minimum=torch.zeros(3), maximum=torch.ones(3))
    return Scene(name="board", train=tuple(views), test=(), box=box)


def write_images(folder: Path, images: Sequence[np.ndarray]) -> Path:
    folder.mkdir(parents=True)
    for index, image in enumerate(images):
        assert cv2.imwrite(str(folder / f"p{index:02d}.png"), image)
    return folder


def degrees_between(first: Sequence[float] | np.ndarray, second: Sequence[float] | np.ndarray) -> float:
    return math.degrees(math.acos(float(np.clip(np.dot(first, second), -1, 1))))
