"""Distorted lenses: images are resampled once, when they are read, to what a pinhole would have seen.

The polynomials are OpenCV's. OpenCV puts pixel centres at whole numbers, this project at halves; ``cv_matrix`` is the
one place where that half pixel is taken off.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.lens import Pinhole

_STEEPEST = 1.3
"""Tangent of the largest angle to the axis that is kept (52 degrees): beyond, a pinhole image is mostly stretch."""
_NEWTON_STEPS = 20
_FOLDED = 0.05
"""Pixels by which a border point may miss itself on its way through the lens and back."""
_BENT = (0.2, 1.6)
"""Distance of a border point from the principal point over what it would be without the distortion. Lenses of 100
degrees and more come to a half; nothing magnifies its border by a half."""
_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE_NAMES = ("k1", "k2", "k3", "k4")


@dataclass(frozen=True, kw_only=True)
class Distortion:
    """Bends the rays of a pinhole."""

    coefficients: tuple[float, ...]
    """k1 k2 p1 p2 k3 k4 k5 k6 of the perspective model, the last three in the denominator; k1 k2 k3 k4 of the fisheye's
    polynomial in the angle."""
    fisheye: bool = False

    @property
    def is_none(self) -> bool:
        """A fisheye with no coefficients still is one: its radius is the angle, not the tangent."""
        return not self.fisheye and not any(self.coefficients)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rectification:
    """How to make a pinhole image out of a distorted one."""

    pinhole: Pinhole
    """Of the new image; focal lengths are the lens's own, so that the middle keeps its resolution."""
    width: int
    height: int
    columns: Float32[np.ndarray, "h w"]
    """Where each new pixel comes from, as OpenCV counts: whole numbers at pixel centres."""
    rows: Float32[np.ndarray, "h w"]


def cv_matrix(pinhole: Pinhole) -> Float64[np.ndarray, "3 3"]:
    """The camera matrix as OpenCV wants it."""
    return np.array([[pinhole.fx, 0, pinhole.cx - 0.5], [0, pinhole.fy, pinhole.cy - 0.5], [0, 0, 1.0]])


def distorted_pixels(
    directions: Float64[np.ndarray, "n 3"], pinhole: Pinhole, distortion: Distortion
) -> Float64[np.ndarray, "n 2"]:
    """Columns and rows at which rays in the camera frame meet the distorted image; pixel centres at halves."""
    points = np.ascontiguousarray(directions, dtype=np.float64)[:, None]
    matrix, zero = cv_matrix(pinhole), np.zeros(3)
    coefficients = np.array(distortion.coefficients)
    if distortion.fisheye:
        pixels, _ = cv2.fisheye.projectPoints(points, zero, zero, matrix, coefficients)
    else:
        pixels, _ = cv2.projectPoints(points, zero, zero, matrix, coefficients)
    return np.asarray(pixels, np.float64).reshape(-1, 2) + 0.5


def straightened(
    pixels: Float64[np.ndarray, "n 2"], pinhole: Pinhole, distortion: Distortion
) -> Float64[np.ndarray, "n 2"]:
    """The inverse of ``distorted_pixels``: x/z and y/z of the rays through pixels of the distorted image.

    Infinite for rays of a fisheye that go sideways or back.
    """
    bent = (pixels - (pinhole.cx, pinhole.cy)) / (pinhole.fx, pinhole.fy)
    if distortion.fisheye:
        return _from_angles(bent, np.array(distortion.coefficients))
    lens = Pinhole(fx=1.0, fy=1.0, cx=0.5, cy=0.5)

    def bend(ways: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        return distorted_pixels(np.concatenate([ways, np.ones((len(ways), 1))], axis=1), lens, distortion) - 0.5

    # Newton's method, the slopes from differences.
    ways, step = bent.copy(), 1e-6
    for _ in range(_NEWTON_STEPS):
        error = bend(ways) - bent
        slopes = [(bend(ways + e) - bend(ways - e)) / (2 * step) for e in step * np.eye(2)]
        jacobian = np.stack(slopes, axis=2)
        determinant = np.linalg.det(jacobian)
        jacobian[np.abs(determinant) < 1e-9] = np.eye(2)
        ways = ways - np.linalg.solve(jacobian, error[..., None])[..., 0].clip(-0.5, 0.5)
    return ways


def _from_angles(bent: Float64[np.ndarray, "n 2"], k: Float64[np.ndarray, " 4"]) -> Float64[np.ndarray, "n 2"]:
    """Fisheye: the radius in the image is t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) of the angle t to the axis."""
    radius = np.linalg.norm(bent, axis=1)
    angle = radius.copy()
    for _ in range(_NEWTON_STEPS):
        square = angle * angle
        value = angle * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3]))))
        slope = 1 + square * (3 * k[0] + square * (5 * k[1] + square * (7 * k[2] + square * 9 * k[3])))
        angle = angle - ((value - radius) / np.where(np.abs(slope) < 1e-9, 1.0, slope)).clip(-0.5, 0.5)
    tangent = np.where(np.abs(angle) < 1.5, np.tan(np.clip(angle, -1.5, 1.5)), np.inf)
    away = bent / np.where(radius > 0, radius, 1.0)[:, None]
    return np.where(radius[:, None] > 0, tangent[:, None] * np.where(away == 0, 1e-300, away), 0.0)


def rectify(pinhole: Pinhole, distortion: Distortion, width: int, height: int, where: str) -> Rectification:
    """The pinhole image that is covered whole by a distorted image of ``width`` x ``height``.

    The largest upright rectangle between the bent borders, at most ``_STEEPEST`` from the axis. Raises DataError,
    beginning with ``where``, for a lens that folds the image over itself or bends it as no lens does.
    """
    try:
        return _rectification(pinhole, distortion, width, height)
    except _FoldedError as error:
        names = _FISHEYE_NAMES if distortion.fisheye else _NAMES
        numbers = ", ".join(f"{n} {value:g}" for n, value in zip(names, distortion.coefficients, strict=False) if value)
        raise DataError(
            f"{where}: the calibration diverged: {error} ({numbers}, focal length {pinhole.fx:.4g} x {pinhole.fy:.4g} "
            f"pixels, image {width}x{height}); calibrate again, with one camera for all images or a simpler model."
        ) from None


class _FoldedError(Exception):
    """A lens that makes no image; the message says why."""


# Photographs of one camera share a lens, so the last ones are kept: making the maps takes longer than using them.
@lru_cache(maxsize=2)
def _rectification(pinhole: Pinhole, distortion: Distortion, width: int, height: int) -> Rectification:
    left, right, top, bottom = _borders(pinhole, distortion, width, height)
    low = np.array([left, top]).clip(-_STEEPEST, _STEEPEST)
    high = np.array([right, bottom]).clip(-_STEEPEST, _STEEPEST)
    focal = np.array([pinhole.fx, pinhole.fy])
    size = np.floor((high - low) * focal + 1e-6).astype(int)
    if (size < 1).any():
        raise _FoldedError("the lens's distortion leaves no image")
    shift = -low * focal
    straight = Pinhole(fx=pinhole.fx, fy=pinhole.fy, cx=float(shift[0]), cy=float(shift[1]))
    make = cv2.fisheye.initUndistortRectifyMap if distortion.fisheye else cv2.initUndistortRectifyMap
    columns, rows = make(
        cv_matrix(pinhole),
        np.array(distortion.coefficients),
        np.eye(3),
        cv_matrix(straight),
        (int(size[0]), int(size[1])),
        cv2.CV_32FC1,
    )
    return Rectification(
        pinhole=straight, width=int(size[0]), height=int(size[1]), columns=np.asarray(columns), rows=np.asarray(rows)
    )


def resample(image: Float32[np.ndarray, "h w *c"], rectification: Rectification) -> Float32[np.ndarray, "h2 w2 *c"]:
    """The image as the pinhole sees it, bilinear."""
    border = cv2.BORDER_REPLICATE
    return cv2.remap(image, rectification.columns, rectification.rows, cv2.INTER_LINEAR, borderMode=border)


def _borders(pinhole: Pinhole, distortion: Distortion, width: int, height: int) -> tuple[float, float, float, float]:
    """x/z of the left and right, y/z of the upper and lower side of the rectangle inside the bent borders."""
    along, down = np.linspace(0, width, 65), np.linspace(0, height, 65)
    sides = (
        np.stack([np.zeros(65), down], axis=1),
        np.stack([np.full(65, float(width)), down], axis=1),
        np.stack([along, np.zeros(65)], axis=1),
        np.stack([along, np.full(65, float(height))], axis=1),
    )
    rays = [_checked(side, pinhole, distortion) for side in sides]
    left, right = rays[0][:, 0].max(), rays[1][:, 0].min()
    return float(left), float(right), float(rays[2][:, 1].max()), float(rays[3][:, 1].min())


def _checked(pixels: Float64[np.ndarray, "n 2"], pinhole: Pinhole, distortion: Distortion) -> Float[np.ndarray, "n 2"]:
    rays = straightened(pixels, pinhole, distortion)
    # A fisheye sees to the side and behind, where no pinhole does: such points bound nothing.
    steep = ~np.isfinite(rays).all(axis=1) | (np.abs(rays).max(axis=1) > 2 * _STEEPEST)
    if distortion.fisheye:
        outward = np.sign(pixels - [pinhole.cx, pinhole.cy])
        rays = np.where(steep[:, None], outward * 2 * _STEEPEST, rays)
        checked = ~steep
    else:
        checked = np.ones(len(rays), bool)
    directions = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)[checked]
    back = distorted_pixels(directions, pinhole, distortion) if checked.any() else np.zeros((0, 2))
    error = np.abs(back - pixels[checked]).max(initial=0.0)
    if not error < _FOLDED:
        raise _FoldedError("the lens's distortion folds the image over itself before its border")
    _require_a_lens(pixels[checked], rays[checked], pinhole, distortion)
    return rays


def _require_a_lens(
    pixels: Float64[np.ndarray, "n 2"], rays: Float[np.ndarray, "n 2"], pinhole: Pinhole, distortion: Distortion
) -> None:
    """Raises _FoldedError where rays are bent to much more or less of their way from the middle."""
    straight = np.linalg.norm(rays, axis=1)
    straight = np.arctan(straight) if distortion.fisheye else straight
    bent = np.linalg.norm((pixels - (pinhole.cx, pinhole.cy)) / (pinhole.fx, pinhole.fy), axis=1)
    factors = bent[straight > 0] / straight[straight > 0]
    if len(factors) and not (_BENT[0] <= factors.min() and factors.max() <= _BENT[1]):
        worst = max(factors.max(), 1 / factors.min())
        raise _FoldedError(f"the lens's distortion moves the image's border by a factor of {worst:.3g}")
