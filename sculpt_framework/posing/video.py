"""Frames of a video: sharp ones, spread evenly over the way the camera went."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from sculpt_framework.errors import DataError
from sculpt_framework.export.atomic import write_atomically

_WIDTH = 480
"""Pixels of the longer side at which frames are looked at."""
_CORNERS = 200
_QUALITY = 95


@dataclass(frozen=True, kw_only=True, eq=False)
class Footage:
    """What is known of each frame of a video."""

    sharpness: Float64[np.ndarray, " n"]
    """Variance of the Laplacian over that of the picture: 0 where nothing is sharp, whatever the contrast."""
    motion: Float64[np.ndarray, " n"]
    """Median displacement of features since the frame before, as a share of the frame's longer side."""


def look_through(video: Path, tell: Callable[[int, int], None]) -> Footage:
    """Decode a video once. ``tell`` is told how many of how many frames are done. Raises DataError."""
    capture = _open(video)
    announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    sharpness, motion = [], []
    before: UInt8[np.ndarray, "h w"] | None = None
    while True:
        there, frame = capture.read()
        if not there:
            break
        grey = _small(frame)
        sharpness.append(_sharpness(grey))
        motion.append(0.0 if before is None else _displacement(before, grey))
        before = grey
        tell(len(sharpness), max(announced, len(sharpness)))
    capture.release()
    if not sharpness:
        raise DataError(f"{video}: no frame can be decoded; convert the video to MP4 (H.264), or give photographs.")
    return Footage(sharpness=np.array(sharpness), motion=np.array(motion))


def choose_frames(footage: Footage, count: int) -> Int64[np.ndarray, " m"]:
    """Indices of at most ``count`` frames, ascending.

    The way that features have moved is cut into ``count`` equal parts, and the sharpest frame of each part is taken:
    standing still gives one frame, a fast pan many. Parts that no frame falls into give none.
    """
    way = np.cumsum(footage.motion)
    if way[-1] <= 0:  # Nothing moves, so time has to do.
        way = np.arange(len(way), dtype=np.float64)
    # The last frame belongs to the last part.
    part = np.minimum((way / max(way[-1], 1e-12) * count).astype(int), count - 1)
    return np.array([np.flatnonzero(part == p)[footage.sharpness[part == p].argmax()] for p in np.unique(part)])


def write_frames(
    video: Path, chosen: Int64[np.ndarray, " m"], folder: Path, tell: Callable[[int, int], None]
) -> list[str]:
    """The chosen frames as JPEGs, numbered as in the video; names below ``folder``. Raises DataError, OutputError."""
    folder.mkdir(parents=True, exist_ok=True)
    capture, names, index = _open(video), [], -1
    for wanted in chosen.tolist():
        while index < wanted and capture.grab():
            index += 1
        there, frame = capture.retrieve()
        if index < wanted or not there:
            raise DataError(f"{video}: frame {wanted} cannot be decoded a second time.")
        names.append(f"frame_{wanted:06}.jpg")
        _, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        write_atomically(folder / names[-1], data.tobytes())
        tell(len(names), len(chosen))
    capture.release()
    return names


def _open(video: Path) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(str(video))
    if not capture.isOpened():
        raise DataError(f"{video}: cannot be opened as a video; convert it to MP4 (H.264), or give photographs.")
    return capture


def _small(frame: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h2 w2"]:
    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    factor = _WIDTH / max(grey.shape)
    if factor < 1:
        grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return np.asarray(grey, np.uint8)


def _sharpness(grey: UInt8[np.ndarray, "h w"]) -> float:
    return float(cv2.Laplacian(grey, cv2.CV_64F).var() / (grey.astype(np.float64).var() + 1.0))


def _displacement(before: UInt8[np.ndarray, "h w"], after: UInt8[np.ndarray, "h w"]) -> float:
    corners = cv2.goodFeaturesToTrack(before, _CORNERS, 0.01, 8)
    if corners is None:
        return 0.0
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, np.empty_like(corners))
    steps = np.linalg.norm((moved - corners).reshape(-1, 2), axis=1)[found.reshape(-1) == 1]
    return float(np.median(steps)) / max(before.shape) if len(steps) else 0.0
