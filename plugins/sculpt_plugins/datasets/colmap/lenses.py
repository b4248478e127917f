"""COLMAP's camera models, as a pinhole and OpenCV's distortion of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.distortion import Distortion
from sculpt_framework.posed_images.lens import FOCAL, Pinhole

Values = Sequence[float]


@dataclass(frozen=True, kw_only=True)
class Model:
    number: int
    """In binary files."""
    name: str
    """In text files."""
    parameters: int
    one_focal: bool
    distortion: Callable[[Values], Distortion | None] | None
    """From the parameters behind focal lengths and principal point; no function: OpenCV has no such lens."""


def _none(values: Values) -> None:
    return None


def _radial(values: Values) -> Distortion:
    k1, k2 = (*values, 0.0)[:2]
    return Distortion(coefficients=(k1, k2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def _opencv(values: Values) -> Distortion:
    # FULL_OPENCV has OpenCV's own order, k1 k2 p1 p2 k3 k4 k5 k6; OPENCV its first four.
    padded = (*values, *[0.0] * 8)
    return Distortion(coefficients=padded[:8])


def _fisheye(values: Values) -> Distortion:
    padded = (*values, *[0.0] * 4)
    return Distortion(coefficients=padded[:4], fisheye=True)


MODELS = (
    Model(number=0, name="SIMPLE_PINHOLE", parameters=3, one_focal=True, distortion=_none),
    Model(number=1, name="PINHOLE", parameters=4, one_focal=False, distortion=_none),
    Model(number=2, name="SIMPLE_RADIAL", parameters=4, one_focal=True, distortion=_radial),
    Model(number=3, name="RADIAL", parameters=5, one_focal=True, distortion=_radial),
    Model(number=4, name="OPENCV", parameters=8, one_focal=False, distortion=_opencv),
    Model(number=5, name="OPENCV_FISHEYE", parameters=8, one_focal=False, distortion=_fisheye),
    Model(number=6, name="FULL_OPENCV", parameters=12, one_focal=False, distortion=_opencv),
    Model(number=7, name="FOV", parameters=5, one_focal=False, distortion=None),
    Model(number=8, name="SIMPLE_RADIAL_FISHEYE", parameters=4, one_focal=True, distortion=_fisheye),
    Model(number=9, name="RADIAL_FISHEYE", parameters=5, one_focal=True, distortion=_fisheye),
    Model(number=10, name="THIN_PRISM_FISHEYE", parameters=12, one_focal=False, distortion=None),
)


def model_of(key: int | str, where: str) -> Model:
    """By its number or its name. Raises DataError for one that is not known or cannot be undistorted here."""
    model = next((model for model in MODELS if key in (model.number, model.name)), None)
    usable = ", ".join(model.name for model in MODELS if model.distortion is not None)
    if model is None:
        raise DataError(f"{where}: camera model {key!r} is not known; expected one of {usable}.")
    if model.distortion is None:
        raise DataError(
            f"{where}: camera model {model.name} is not read; run COLMAP with one of {usable}, or its "
            "image_undistorter."
        )
    return model


def lens_of(model: Model, values: Values, where: str) -> tuple[Pinhole, Distortion | None]:
    """The pinhole and its distortion, None where there is none. Raises DataError for what no camera has."""
    if model.distortion is None:
        raise ValueError(f"{model.name} has no distortion here")
    rest = 3 if model.one_focal else 4
    fx, fy = (values[0], values[0]) if model.one_focal else values[:2]
    least, most = FOCAL
    if not (least <= min(fx, fy) and max(fx, fy) <= most):
        wrong = min(fx, fy) if min(fx, fy) < least else max(fx, fy)
        raise DataError(f"{where}: the focal length is {wrong:g}; expected pixels, {least:g} to {most:g}.")
    cx, cy = values[rest - 2 : rest]
    if max(abs(cx), abs(cy)) > most:
        raise DataError(f"{where}: the principal point is {cx:g}, {cy:g}; expected pixels of the image.")
    return Pinhole(fx=fx, fy=fy, cx=cx, cy=cy), model.distortion(values[rest:])
