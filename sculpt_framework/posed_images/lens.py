"""Focal lengths and principal point, from whichever of the layout's keys are there."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.reading import nearest_key, number
from sculpt_framework.types import Camera

LENS_KEYS = ("camera_angle_x", "camera_angle_y", "fl_x", "fl_y", "cx", "cy", "w", "h")
DISTORTION_KEYS = ("k1", "k2", "k3", "k4", "p1", "p2")
ASPECT_TOLERANCE = 0.01
"""Aspect ratios of one image in two sizes differ by less, relative: sizes are whole pixels."""
FOCAL = (1e-3, 1e9)
"""Pixels; beyond, no camera is meant, and places of pixels overflow."""


@dataclass(frozen=True, kw_only=True)
class Pinhole:
    """In pixels of the image."""

    fx: float
    fy: float
    cx: float
    cy: float

    def camera(self, world_to_camera: Float[Tensor, "4 4"], width: int, height: int) -> Camera:
        """With this pinhole, at a pose (OpenCV axes), for images of this size."""
        return Camera(
            world_to_camera=world_to_camera,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            width=width,
            height=height,
        )


@dataclass(frozen=True, kw_only=True)
class Lens:
    """What the file says; None where it says nothing."""

    angle_x: float | None
    """Horizontal field of view, in radians."""
    angle_y: float | None
    focal_x: float | None
    """In pixels of an image of ``width`` x ``height``."""
    focal_y: float | None
    center_x: float | None
    center_y: float | None
    width: float | None
    height: float | None

    def at_size(self, width: int, height: int, image: Path) -> Pinhole:
        """In pixels of an image of this size, which may be a resized one.

        Raises DataError if the file speaks of an image of another shape, or of a focal length or principal
        point out of all proportion.
        """
        sx, sy = width / (self.width or width), height / (self.height or height)
        if abs(sx / sy - 1) > ASPECT_TOLERANCE:
            raise DataError(
                f"{image}: the image is {width}x{height} but w x h in the transforms is "
                f"{self.width:g}x{self.height:g}; expected the same size or the same shape."
                if self.width and self.height
                else f"{image}: the image is {width}x{height}, which does not fit w or h in the transforms."
            )
        if self.focal_x is not None:
            fx = self.focal_x * sx
        elif self.angle_x is not None:
            fx = 0.5 * width / math.tan(0.5 * self.angle_x)
        else:
            raise ValueError("a lens needs an angle or a focal length")
        if self.focal_y is not None:
            fy = self.focal_y * sy
        elif self.angle_y is not None and self.focal_x is None:
            fy = 0.5 * height / math.tan(0.5 * self.angle_y)
        else:
            fy = fx
        if not all(FOCAL[0] <= focal <= FOCAL[1] for focal in (fx, fy)):
            raise DataError(
                f"{image}: the focal length comes to {fx:g} x {fy:g} pixels; expected {FOCAL[0]:g} to {FOCAL[1]:g}. "
                "Check camera_angle_x or fl_x in the transforms."
            )
        cx = 0.5 * width if self.center_x is None else self.center_x * sx
        cy = 0.5 * height if self.center_y is None else self.center_y * sy
        if not max(abs(cx), abs(cy)) <= FOCAL[1]:
            raise DataError(
                f"{image}: the principal point comes to {cx:g}, {cy:g} pixels; expected at most {FOCAL[1]:g} to "
                "either side. Check cx and cy in the transforms."
            )
        return Pinhole(fx=fx, fy=fy, cx=cx, cy=cy)


def read_lens(entries: Mapping[str, object], where: str, *, distorted: bool = False) -> Lens:
    """The lens of a frame, from its own keys over those of the file.

    Raises DataError for values that are no lens, for a missing focal length, and for distortion unless ``distorted``
    says that it is read elsewhere.
    """
    values = {key: number(entries[key], f"{where}: {key}") for key in LENS_KEYS if entries.get(key) is not None}
    for key in ("camera_angle_x", "camera_angle_y"):
        if key in values and not 0 < values[key] < math.pi:
            hint = f" ({values[key]:g} degrees are {math.radians(values[key]):.4g})" if values[key] >= math.pi else ""
            raise DataError(f"{where}: {key} is {values[key]:g}; expected radians between 0 and pi{hint}.")
    for key in ("fl_x", "fl_y", "w", "h"):
        if key in values and not values[key] > 0:
            raise DataError(f"{where}: {key} is {values[key]:g}; expected pixels, more than 0.")
    if "camera_angle_x" not in values and "fl_x" not in values:
        close = nearest_key("camera_angle_x", entries) or nearest_key("fl_x", entries)
        hint = f" (did you mean this by '{close}'?)" if close else ""
        raise DataError(f"{where}: no focal length; expected camera_angle_x in radians or fl_x in pixels{hint}.")
    for key in () if distorted else DISTORTION_KEYS:
        if entries.get(key) is not None and number(entries[key], f"{where}: {key}") != 0:
            raise DataError(f"{where}: {key} is not 0; this layout has pinhole cameras only: undistort the images.")
    return Lens(
        angle_x=values.get("camera_angle_x"),
        angle_y=values.get("camera_angle_y"),
        focal_x=values.get("fl_x"),
        focal_y=values.get("fl_y"),
        center_x=values.get("cx"),
        center_y=values.get("cy"),
        width=values.get("w"),
        height=values.get("h"),
    )
