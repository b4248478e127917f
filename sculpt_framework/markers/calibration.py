"""A camera's focal length, principal point and distortion from its photographs of a board."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from sculpt_framework.markers.detection import Sighting
from sculpt_framework.spread import spread

Points = Float64[np.ndarray, "n 3"]
_VIEWS = 40
"""Photographs that are used at most, spread evenly."""
_LEAST = 3
_CORNERS = 8
"""Points in a photograph at least."""
_FLATTEST = 0.01
"""Of the points' spread along the line that fits them, how much there is across it at the least."""
_OUTSIDE, _SIGMA, _NOISE = 3.5, 1.4826, 0.3
_SHARE = 0.7
"""Of the points that must fit."""
_GAIN = 20.0
"""By how much the information criterion must fall for a lens with more parameters to be taken. It takes corners for
independent; those of one marker err together."""
_SURE_FOCAL, _SURE_CENTER = 0.01, 0.005
"""Standard errors, of the focal length relative and of the principal point in lengths of the image's side, beyond which
they do not count as known."""
_WORST = (3.0, 0.003)
"""Pixels, and sides of the image, root mean square: what is farther off than both does not fit a flat board."""
_FOCAL = (0.2, 20.0)
"""In sides of the image; beyond, no lens is meant."""
_UNTOLD = "the board does not tell the focal length: it is seen from straight above, or too small"
_COVERED = 0.75
"""Of the way to the image's corners that points must reach for k2 to be fitted: beyond them it runs wild."""
_FIXED = (
    cv2.CALIB_USE_INTRINSIC_GUESS
    | cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K3
    | cv2.CALIB_FIX_K4
    | cv2.CALIB_FIX_K5
    | cv2.CALIB_FIX_K6
)
_CENTER, _K1, _K2 = cv2.CALIB_FIX_PRINCIPAL_POINT, cv2.CALIB_FIX_K1, cv2.CALIB_FIX_K2
_MODELS = ((1, _CENTER | _K1 | _K2), (2, _CENTER | _K2), (3, _CENTER), (4, _K2), (5, 0))
"""How many parameters each lens has, and what OpenCV keeps fixed for it: from the focal length alone to all of them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardLens:
    """In pixels of the stored image, pixel centres at halves."""

    focal: float
    center: tuple[float, float]
    k1: float = 0.0
    k2: float = 0.0
    said: str
    """Where it is from."""

    @property
    def worst(self) -> float:
        """Pixels by which a photograph of a board may be off, root mean square."""
        return _worst(2 * max(self.center))

    def matrix(self) -> Float64[np.ndarray, "3 3"]:
        """As OpenCV wants it: pixel centres at whole numbers."""
        x, y = self.center
        return np.array([[self.focal, 0, x - 0.5], [0, self.focal, y - 0.5], [0, 0, 1]])

    def coefficients(self) -> Float64[np.ndarray, " 5"]:
        return np.array([self.k1, self.k2, 0.0, 0.0, 0.0])


def known_lens(focal: float, width: int, height: int, said: str) -> BoardLens:
    """Of a given focal length in pixels, with the principal point in the middle and no distortion."""
    return BoardLens(focal=focal, center=(width / 2, height / 2), said=said)


def calibrate(
    board: Points, sightings: Sequence[Sighting], width: int, height: int, guess: float | None
) -> BoardLens | str:
    """The lens that explains the photographs best, with no more parameters than they tell apart; or in words why none
    does.

    ``guess`` is a focal length in pixels to start from.
    """
    good = [sighting for sighting in sightings if _is_enough(board, sighting)]
    if len(good) < _LEAST:
        return (
            f"{len(good)} photographs show {_CORNERS} points of the board or more that are not all on one line, "
            f"{_LEAST} are needed"
        )
    views = spread(good, _VIEWS)
    side = float(max(width, height))
    starts = [_matrix(start, width, height) for start in ([guess] if guess else [1.2 * side, 0.7 * side, 3.0 * side])]
    size = (width, height)
    tried = [fit for start in starts if (fit := _Fit.of(board, views, size, start, *_MODELS[1])) is not None]
    if not tried:
        return _UNTOLD
    first = min(tried, key=_Fit.criterion)
    seen = sum(len(view.points) for view in views)
    views = first.without_strays(board, views)
    if sum(len(view.points) for view in views) < _SHARE * seen:
        return _other_board(first.pixels())
    covered = _reach(views, width, height) >= _COVERED
    models = [(count, fixed) for count, fixed in _MODELS if covered or fixed & _K2]
    fits = [fit for model in models if (fit := _Fit.of(board, views, size, first.matrix, *model)) is not None]
    if not fits:
        return _UNTOLD
    best = fits[0]
    for fit in fits[1:]:
        if fit.is_told and fit.criterion() < best.criterion() - _GAIN and fit.center_error <= _SURE_CENTER * side:
            best = fit
    if not best.pixels() <= _worst(side):
        return _other_board(best.pixels())
    focal = float(best.matrix[0, 0])
    if not (best.is_told and _FOCAL[0] * side < focal < _FOCAL[1] * side):
        return _UNTOLD
    if not best.focal_error <= _SURE_FOCAL * focal:
        off = 100 * best.focal_error / focal
        return f"the board tells the focal length to {off:.1f} % only: it is seen from too steep above, or too small"
    return BoardLens(
        focal=focal,
        center=(float(best.matrix[0, 2]) + 0.5, float(best.matrix[1, 2]) + 0.5),
        k1=float(best.distortion[0]),
        k2=float(best.distortion[1]),
        said=f"calibrated on {len(views)} photographs, {best.pixels():.2g} pixels off (rms), focal length "
        f"{focal:.1f} +- {best.focal_error:.1f} pixels",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    matrix: Float64[np.ndarray, "3 3"]
    distortion: Float64[np.ndarray, " c"]
    poses: list[tuple[np.ndarray, np.ndarray]]
    squares: float
    """Sum over all coordinates."""
    count: int
    """Of coordinates."""
    parameters: int
    focal_error: float
    center_error: float
    is_told: bool
    """Whether the photographs determine it. Of singular equations OpenCV leaves out what they do not tell: it gives
    standard errors near 0, below those that would be left if all other parameters were known."""

    @classmethod
    def of(
        cls,
        board: Points,
        views: Sequence[Sighting],
        size: tuple[int, int],
        start: Float64[np.ndarray, "3 3"],
        parameters: int,
        fixed: int,
    ) -> "_Fit | None":
        """None where OpenCV gives up, or ends at no focal length."""
        places = [np.ascontiguousarray(board[view.points], np.float32) for view in views]
        pixels = [np.ascontiguousarray(view.pixels - 0.5, np.float32) for view in views]
        try:
            error, matrix, distortion, turns, shifts, errors, _, _ = cv2.calibrateCameraExtended(
                places, pixels, size, start.copy(), np.zeros(5), flags=_FIXED | fixed
            )
        except cv2.error:
            return None
        if not (np.isfinite(error) and np.isfinite(matrix).all() and matrix[0, 0] > 0):
            return None
        count = 2 * sum(len(view.points) for view in views)
        deviations = np.asarray(errors).reshape(-1)
        focal_error, center_error = float(deviations[:2].max()), float(deviations[2:4].max())
        # A point's derivative by the logarithm of the focal length is its place beside the principal point.
        beside = float(np.linalg.norm(np.concatenate(pixels) - np.asarray(matrix)[:2, 2]))
        noise = float(error) / np.sqrt(2)
        told = focal_error > matrix[0, 0] * noise / beside
        if not fixed & _CENTER:
            told = told and center_error > noise / np.sqrt(count / 2)
        return cls(
            matrix=np.asarray(matrix),
            distortion=np.asarray(distortion).reshape(-1),
            poses=list(zip(turns, shifts, strict=True)),
            squares=float(error) ** 2 * count / 2,
            count=count,
            parameters=parameters,
            focal_error=focal_error,
            center_error=center_error,
            is_told=bool(told),
        )

    def criterion(self) -> float:
        """Schwarz's, which a parameter that tells nothing raises."""
        noise = max(self.squares / self.count, 1e-8)
        return self.count * float(np.log(noise)) + self.parameters * float(np.log(self.count))

    def pixels(self) -> float:
        """Root mean square of the distances."""
        return float(np.sqrt(2 * self.squares / self.count))

    def without_strays(self, board: Points, views: Sequence[Sighting]) -> list[Sighting]:
        away = []
        for view, (turn, shift) in zip(views, self.poses, strict=True):
            seen, _ = cv2.projectPoints(board[view.points], turn, shift, self.matrix, self.distortion)
            away.append(np.linalg.norm(np.asarray(seen).reshape(-1, 2) + 0.5 - view.pixels, axis=1))
        limit = _OUTSIDE * max(_SIGMA * float(np.median(np.concatenate(away))), _NOISE)
        kept = [
            Sighting(points=v.points[a <= limit], pixels=v.pixels[a <= limit], markers=v.markers)
            for v, a in zip(views, away, strict=True)
        ]
        enough = [view for view in kept if _is_enough(board, view)]
        return enough if len(enough) >= _LEAST else list(views)


def are_on_a_line(places: Points) -> bool:
    """They tell no plane, and no pose of a board."""
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(spread[1] < _FLATTEST * spread[0])


def _is_enough(board: Points, view: Sighting) -> bool:
    return len(view.points) >= _CORNERS and not are_on_a_line(board[view.points])


def _worst(side: float) -> float:
    return max(_WORST[0], _WORST[1] * side)


def _other_board(pixels: float) -> str:
    return f"what it shows is {pixels:.1f} pixels off that board: was another one printed, or is it bent?"


def _reach(views: Sequence[Sighting], width: int, height: int) -> float:
    """How far from the image's middle points are seen, in distances of its corners."""
    away = np.linalg.norm(np.concatenate([view.pixels for view in views]) - (width / 2, height / 2), axis=1)
    return float(away.max() / np.hypot(width / 2, height / 2))


def _matrix(focal: float, width: int, height: int) -> Float64[np.ndarray, "3 3"]:
    return known_lens(focal, width, height, "").matrix()
