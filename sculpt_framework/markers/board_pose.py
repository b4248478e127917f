"""Where a camera of known lens stands, from one photograph of a board."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from sculpt_framework.markers.calibration import BoardLens, are_on_a_line
from sculpt_framework.markers.detection import Sighting

_CORNERS = 8
_OUTSIDE, _SIGMA, _NOISE = 3.5, 1.4826, 0.5
_SHARE = 0.5
"""Of the points that must fit."""
_SURE = 0.5
"""Degrees of standard error of the orientation, beyond which a photograph is of no use."""
_TWOFOLD, _OTHER = 1.5, 3.0
"""A second pose that fits up to this factor as well, and is this many degrees away, cannot be told from the first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardPose:
    world_to_camera: Float64[np.ndarray, "4 4"]
    """From the board's frame, in metres, to OpenCV axes."""
    pixel_error: float
    """Root mean square distance, in pixels."""
    turn_error: float
    """Standard error of the orientation, in degrees."""
    points: int

    @property
    def position(self) -> Float64[np.ndarray, " 3"]:
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]


def pose_from_board(board: Float64[np.ndarray, "n 3"], sighting: Sighting, lens: BoardLens) -> BoardPose | str:
    """The pose, or in words why there is none. ``board`` are the points that a sighting names, in metres."""
    if len(sighting.points) < _CORNERS:
        if sighting.repeated:
            return f"shows {len(sighting.points)} points of the board once, others more than once"
        return f"shows {len(sighting.points)} points of the board; {_CORNERS} are needed"
    places, pixels = board[sighting.points], sighting.pixels - 0.5
    fits = _solutions(places, pixels, lens)
    if not fits:
        return "the points it shows lie on a line"
    away = fits[0].away
    kept = away <= _OUTSIDE * max(_SIGMA * float(np.median(away)), _NOISE)
    if kept.mean() < _SHARE:
        return f"does not fit the board: {fits[0].error:.1f} pixels off"
    if kept.sum() >= _CORNERS and not kept.all():
        places, pixels = places[kept], pixels[kept]
        fits = _solutions(places, pixels, lens) or fits
    best = fits[0]
    if best.error > lens.worst:
        return f"does not fit the board: {best.error:.1f} pixels off"
    second = next((fit for fit in fits[1:] if fit.error < _TWOFOLD * best.error and best.angle_to(fit) > _OTHER), None)
    if second is not None:
        return "the board is too small in it to tell which way it tilts"
    turn_error = best.turn_error(places, lens)
    if not turn_error <= _SURE:
        return f"shows too little of the board: its orientation is known to {turn_error:.1f} degrees only"
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = best.rotation(), best.shift.reshape(3)
    return BoardPose(world_to_camera=matrix, pixel_error=best.error, turn_error=turn_error, points=len(places))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    turn: np.ndarray
    shift: np.ndarray
    away: Float64[np.ndarray, " n"]
    """Distances in pixels."""

    @property
    def error(self) -> float:
        return float(np.sqrt((self.away**2).mean()))

    def rotation(self) -> Float64[np.ndarray, "3 3"]:
        return np.asarray(cv2.Rodrigues(self.turn)[0])

    def angle_to(self, other: "_Fit") -> float:
        """In degrees."""
        return float(np.degrees(np.linalg.norm(cv2.Rodrigues(self.rotation().T @ other.rotation())[0])))

    def turn_error(self, places: Float64[np.ndarray, "n 3"], lens: BoardLens) -> float:
        _, jacobian = cv2.projectPoints(places, self.turn, self.shift, lens.matrix(), lens.coefficients())
        slopes = np.asarray(jacobian)[:, :6]
        noise = max(self.error**2 / 2, 0.1**2)
        covariance = noise * np.linalg.pinv(slopes.T @ slopes)
        return float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])))


def _solutions(places: Float64[np.ndarray, "n 3"], pixels: Float64[np.ndarray, "n 2"], lens: BoardLens) -> list[_Fit]:
    """Both poses that a plane allows, each made as good as it gets, the better one first."""
    if are_on_a_line(places):
        return []
    matrix, coefficients = lens.matrix(), lens.coefficients()
    pixels = np.ascontiguousarray(pixels)
    _, turns, shifts, _ = cv2.solvePnPGeneric(places, pixels, matrix, coefficients, flags=cv2.SOLVEPNP_IPPE)
    fits = []
    for start in zip(turns, shifts, strict=True):
        turn, shift = (np.asarray(each).copy() for each in start)
        turn, shift = cv2.solvePnPRefineLM(places, pixels, matrix, coefficients, turn, shift)
        seen, _ = cv2.projectPoints(places, turn, shift, matrix, coefficients)
        away = np.linalg.norm(np.asarray(seen).reshape(-1, 2) - pixels, axis=1)
        if np.isfinite(away).all() and float(shift.reshape(3)[2]) > 0:
            fits.append(_Fit(turn=turn, shift=shift, away=away))
    return sorted(fits, key=lambda fit: fit.error)
