"""Cameras from a board that turns with the object: nothing has to be seen on the object itself."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.markers.board_in_space import check_sightings, find_in_all
from sculpt_framework.markers.board_pose import BoardPose, pose_from_board
from sculpt_framework.markers.boards import MILLIMETRE, Board
from sculpt_framework.markers.calibration import BoardLens, calibrate, known_lens
from sculpt_framework.markers.detection import Sighting
from sculpt_framework.markers.photographs import Photograph, read_grey

_LEAST = 3
"""Photographs with a pose that make a scene."""
_OFF = 0.1
"""A calibrated focal length that is this far from EXIF's, relative, is told."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedPhotograph:
    photograph: Photograph
    lens: BoardLens
    pose: BoardPose


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedByBoard:
    posed: list[PosedPhotograph]
    lines: list[str] = field(default_factory=list)


def pose_by_board(
    photographs: Sequence[Photograph], board: Board, focal: float | None, progress: Callable[[float], None]
) -> PosedByBoard:
    """Cameras in the board's frame, in metres, z up. ``focal`` is a focal length in pixels, where the user knows it.

    Raises ConfigError for single markers, DataError where fewer than three photographs get a pose or no lens is found.
    """
    if board.kind == "single":
        raise ConfigError(f"--board {board.name}: single markers lie anywhere; give a charuco or a ring board.")
    sightings = find_in_all(len(photographs), lambda at: read_grey(photographs[at]), board, progress)
    check_sightings(board, sightings)
    points = board.points()
    posed, left_out, lines, failures = [], {}, [], []
    for camera in sorted({photograph.camera for photograph in photographs}):
        own = [at for at, photograph in enumerate(photographs) if photograph.camera == camera]
        lens = _lens(points, [sightings[at] for at in own], photographs[own[0]], focal)
        if isinstance(lens, str):
            failures.append(f"{camera}: {lens}")
            left_out |= {photographs[at].name: lens for at in own}
            continue
        lines.append(f"{camera}: {lens.said}")
        by_exif = photographs[own[0]].focal
        if by_exif is not None and abs(lens.focal / by_exif - 1) > _OFF:
            lines.append(f"note: EXIF says {by_exif:.0f} pixels; were the photographs cropped or resized?")
        for at in own:
            pose = pose_from_board(points, sightings[at], lens)
            if isinstance(pose, str):
                left_out[photographs[at].name] = pose
            else:
                posed.append(PosedPhotograph(photograph=photographs[at], lens=lens, pose=pose))
    if len(posed) < _LEAST:
        why = "; ".join(failures) or "; ".join(f"{name}: {reason}" for name, reason in list(left_out.items())[:3])
        raise DataError(
            f"{board.name}: {len(posed)} of {len(photographs)} photographs get a camera from the board, {_LEAST} are "
            f"needed ({why}). Show more of the board, from 30 to 60 degrees above it, or give --focal PIXELS."
        )
    posed.sort(key=lambda item: item.photograph.name)
    return PosedByBoard(posed=posed, lines=[*lines, *_in_words(posed, left_out, len(photographs))])


def _lens(
    points: np.ndarray, sightings: Sequence[Sighting], photograph: Photograph, focal: float | None
) -> BoardLens | str:
    """As the user says, else calibrated, else by EXIF."""
    size = (photograph.width, photograph.height)
    if focal is not None:
        return known_lens(focal, *size, "the focal length given")
    lens = calibrate(points, sightings, *size, photograph.focal)
    if isinstance(lens, str) and photograph.focal is not None:
        said = f"focal length {photograph.focal:.0f} pixels by EXIF, as {lens}"
        return known_lens(photograph.focal, *size, said)
    return lens


def _in_words(posed: Sequence[PosedPhotograph], left_out: Mapping[str, str], count: int) -> list[str]:
    pixels = float(np.median([item.pose.pixel_error for item in posed]))
    turn = float(np.median([item.pose.turn_error for item in posed]))
    away = np.array([np.linalg.norm(item.pose.position) for item in posed]) / MILLIMETRE
    lines = [
        f"{len(posed)} of {count} photographs have a camera: {pixels:.2g} pixels off (median), orientation to "
        f"{turn:.2g} degrees, {away.min():.0f} to {away.max():.0f} mm from the board's middle"
    ]
    return lines + [f"left out: {name}: {reason}" for name, reason in sorted(left_out.items())]
