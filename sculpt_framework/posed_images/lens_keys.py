"""The distortion keys of a transforms file: k1 to k4, p1, p2, and which kind of lens they are of."""

from collections.abc import Mapping

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.distortion import Distortion
from sculpt_framework.posed_images.lens import DISTORTION_KEYS
from sculpt_framework.posed_images.reading import number

_PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")


def read_distortion(entries: Mapping[str, object], where: str) -> Distortion | None:
    """The distortion of a frame, from its own keys over those of the file; None for a pinhole.

    ``camera_model`` (nerfstudio) or ``is_fisheye`` (instant-ngp) say of which kind it is. Raises DataError for another
    kind, and for k4 of a perspective lens, which means different things to different programs.
    """
    fisheye = _is_fisheye(entries, where)
    values = {
        key: 0.0 if entries.get(key) is None else number(entries[key], f"{where}: {key}") for key in DISTORTION_KEYS
    }
    if fisheye:
        if values["p1"] or values["p2"]:
            raise DataError(f"{where}: p1 and p2 are not 0; a fisheye lens has k1 to k4 only.")
        return Distortion(coefficients=(values["k1"], values["k2"], values["k3"], values["k4"]), fisheye=True)
    if values["k4"]:
        raise DataError(f"{where}: k4 is not 0; it is read for camera_model OPENCV_FISHEYE only.")
    distortion = Distortion(
        coefficients=(values["k1"], values["k2"], values["p1"], values["p2"], values["k3"], 0.0, 0.0, 0.0)
    )
    return None if distortion.is_none else distortion


def _is_fisheye(entries: Mapping[str, object], where: str) -> bool:
    model = entries.get("camera_model")
    if model is None:
        return entries.get("is_fisheye") is True
    if model in _FISHEYE:
        return True
    if model in _PERSPECTIVE:
        return False
    raise DataError(f"{where}: camera_model is {model!r}; expected OPENCV, OPENCV_FISHEYE or PINHOLE.")
