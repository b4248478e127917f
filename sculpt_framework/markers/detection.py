"""Boards in photographs: which of their points are seen, and where."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from sculpt_framework.markers.boards import Board, dictionary_of
from sculpt_framework.markers.edges import corners_from_edges

_WINDOW = (4, 400)
"""Corners are refined in a window of so many pixels to each side at least, or of this fraction of the image's side."""
_MIRRORED = 3
"""So many markers that are seen in the mirror image alone are no accident."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """What one photograph shows of a board."""

    points: Int64[np.ndarray, " n"]
    """Rows of the board's points, ascending."""
    pixels: Float64[np.ndarray, "n 2"]
    """Column and row of each; pixel centres at halves."""
    markers: int
    """That are seen."""
    repeated: tuple[int, ...] = ()
    """Numbers that are seen more than once, and not used."""
    mirrored: bool = False
    """The markers are seen in the mirror image alone."""


def find_board(grey: UInt8[np.ndarray, "h w"], board: Board) -> Sighting:
    """The board's points in a photograph; none where it is hidden, blurred, too small or mirrored."""
    sighting = _find(grey, board)
    if sighting.markers == 0 and not sighting.repeated:
        mirrored = _find(np.ascontiguousarray(grey[:, ::-1]), board).markers >= _MIRRORED
        return Sighting(points=sighting.points, pixels=sighting.pixels, markers=0, mirrored=mirrored)
    return sighting


def _find(grey: UInt8[np.ndarray, "h w"], board: Board) -> Sighting:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = max(_WINDOW[0], round(max(grey.shape) / _WINDOW[1]))
    dictionary = dictionary_of(board.dictionary)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    found = np.zeros(0, np.int64) if numbers is None else np.asarray(numbers).reshape(-1).astype(np.int64)
    places = np.asarray(corners, np.float32).reshape(-1, 4, 2)
    kept, times = np.unique(found, return_counts=True)
    repeated = kept[(times > 1) & np.isin(kept, board.ids)]
    own = np.isin(found, board.ids) & ~np.isin(found, repeated)
    found, places = found[own], places[own]
    if board.kind == "charuco":
        points, pixels = _chess_corners(grey, board, parameters, found, places)
    else:
        points = (4 * (found - board.first)[:, None] + np.arange(4)).reshape(-1)
        pixels = corners_from_edges(grey, places, dictionary.markerSize + 2).reshape(-1, 2)
    order = np.argsort(points)
    return Sighting(
        points=points[order],
        pixels=pixels[order].astype(np.float64) + 0.5,
        markers=len(found),
        repeated=tuple(int(number) for number in repeated),
    )


def _chess_corners(
    grey: UInt8[np.ndarray, "h w"],
    board: Board,
    parameters: cv2.aruco.DetectorParameters,
    numbers: Int64[np.ndarray, " m"],
    places: np.ndarray,
) -> tuple[Int64[np.ndarray, " n"], np.ndarray]:
    """The inner corners between markers that are seen, row by row as the board's points are."""
    if len(numbers) == 0:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    size, dictionary = (board.columns, board.rows), dictionary_of(board.dictionary)
    chart = cv2.aruco.CharucoBoard(size, board.side, board.marker, dictionary, board.ids.astype(np.int32))
    detector = cv2.aruco.CharucoDetector(chart, cv2.aruco.CharucoParameters(), parameters)
    given = [place[None] for place in places]
    pixels, points, _, _ = detector.detectBoard(grey, markerCorners=given, markerIds=numbers[:, None].astype(np.int32))
    if points is None or len(points) == 0:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    return np.asarray(points).reshape(-1).astype(np.int64), np.asarray(pixels).reshape(-1, 2)
