"""From the light that was rendered to the photograph a camera would have written."""

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float32
from PIL import Image

from blender_captures.rigs import HEIGHT, WIDTH, Rig
from sculpt_framework.posed_images.distortion import Distortion, cv_matrix
from sculpt_framework.posed_images.lens import Pinhole


@dataclass(frozen=True, kw_only=True)
class Camera:
    """What a camera makes of the light."""

    stops: float
    """Exposure; more than 0 is over-exposed."""
    stops_spread: float = 0.0
    """Standard deviation over the photographs."""
    white_spread: float = 0.0
    """The same of the gains of red and blue."""
    shot_noise: float = 0.0
    """Variance of a linear value of 1."""
    read_noise: float = 0.0
    """Standard deviation at black."""
    quality: int = 95
    """JPEG's."""
    distortion: Distortion = field(default_factory=lambda: Distortion(coefficients=()))
    border: int = 0
    """Pixels to be rendered on each side beyond the image, for the lens to bend in."""


_HAND_HELD = Camera(
    stops=0.1,
    stops_spread=0.35,
    white_spread=0.07,
    shot_noise=4e-4,
    read_noise=2e-3,
    quality=88,
    distortion=Distortion(coefficients=(-0.07, 0.03, 0.0008, -0.0006)),
    border=28,
)
CAMERAS = {
    "lab": Camera(stops=-0.95, shot_noise=2e-5, read_noise=5e-4),
    "phone": _HAND_HELD,
    "forest": _HAND_HELD,
    "shelf": _HAND_HELD,
    "turntable": Camera(stops=-0.4, shot_noise=6e-5, read_noise=8e-4),
    "museum": Camera(stops=0.2, stops_spread=0.12, white_spread=0.02, shot_noise=2e-4, read_noise=1.5e-3, quality=92),
}


def photograph(light: Float32[np.ndarray, "h w 3"], camera: Camera, focal: float, index: int) -> bytes:
    """A JPEG of linear red, green and blue, with the camera's exposure, noise and lens."""
    chance = np.random.default_rng([51, index])
    stops = camera.stops + chance.normal(0, 1) * camera.stops_spread
    red, blue = 1 + camera.white_spread * chance.normal(0, 1, 2)
    linear = _bent(light, camera, focal) * (2.0**stops * np.array([red, 1, blue]))
    spread = np.sqrt(np.maximum(linear, 0) * camera.shot_noise + camera.read_noise**2)
    linear = np.clip(linear + spread * chance.normal(0, 1, linear.shape), 0, 1)
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    file = io.BytesIO()
    picture = Image.fromarray(np.round(encoded * 255).astype(np.uint8))
    picture.save(file, "JPEG", quality=camera.quality, subsampling=0)
    return file.getvalue()


def mask(covered: Float32[np.ndarray, "h w"], camera: Camera, focal: float) -> bytes:
    """A PNG of the share of each pixel that the object covers."""
    file = io.BytesIO()
    Image.fromarray(np.round(_bent(covered, camera, focal).clip(0, 1) * 255).astype(np.uint8)).save(file, "PNG")
    return file.getvalue()


def _bent(values: Float32[np.ndarray, "..."], camera: Camera, focal: float) -> np.ndarray:
    """As the lens bends it, without the border."""
    if camera.distortion.is_none:
        return values
    return cv2.remap(values, _origins(camera, focal), None, cv2.INTER_CUBIC)


@lru_cache(maxsize=1)
def _origins(camera: Camera, focal: float) -> Float32[np.ndarray, "h w 2"]:
    """Where each pixel comes from in what is rendered, as OpenCV counts; kept, as all photographs have one lens."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    lens = Pinhole(fx=focal, fy=focal, cx=WIDTH / 2, cy=HEIGHT / 2)
    pixels = np.stack([columns, rows], axis=2).reshape(-1, 1, 2) - 0.5
    ways = cv2.undistortPoints(pixels, cv_matrix(lens), np.array(camera.distortion.coefficients))[:, 0]
    middle = np.array([WIDTH / 2, HEIGHT / 2]) + camera.border - 0.5
    places = (focal * ways + middle).astype(np.float32).reshape(HEIGHT, WIDTH, 2)
    if places.min() < 0 or (places.reshape(-1, 2).max(axis=0) > 2 * middle).any():
        raise ValueError(f"the lens looks beyond a border of {camera.border} pixels")
    return places


def transforms(rig: Rig, camera: Camera, names: Sequence[str]) -> bytes:
    """transforms.json of nerfstudio's layout."""
    keys = ("k1", "k2", "p1", "p2")
    lens = {"fl_x": rig.focal, "fl_y": rig.focal, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT}
    if not camera.distortion.is_none:
        lens |= {"camera_model": "OPENCV", **dict(zip(keys, camera.distortion.coefficients, strict=True))}
    frames = [
        {
            "file_path": f"images/{name}.jpg",
            "mask_path": f"masks/{name}.png",
            "transform_matrix": shot.pose.tolist(),
        }
        for name, shot in zip(names, rig.shots, strict=True)
    ]
    return json.dumps({**lens, "frames": frames}, indent=1).encode()
