"""Pictures for people, as bytes: colours, differences, normals; and PNG to put them into a page."""

import base64

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

Picture = UInt8[np.ndarray, "h w 3"]

DIFFERENCE_SCALE = 0.25
"""The mean absolute difference over the channels that gets the strongest colour."""


def color_picture(rgb: Float[np.ndarray, "h w 3"]) -> Picture:
    """sRGB in [0, 1], clipped, as bytes."""
    return np.rint(rgb.clip(0, 1) * 255).astype(np.uint8)


def difference_picture(image: Float[np.ndarray, "h w 3"], target: Float[np.ndarray, "h w 3"]) -> Picture:
    """Mean absolute difference over the channels: white for none, over orange to black at ``DIFFERENCE_SCALE``."""
    share = np.abs(image - target).mean(axis=2) / DIFFERENCE_SCALE
    return np.rint(_heat(share, (255, 255, 255))).astype(np.uint8)


def error_colors(share: Float[np.ndarray, " n"]) -> Float32[np.ndarray, "n 3"]:
    """sRGB in [0, 1] for errors as shares of the largest that is told apart: light grey, over orange to black."""
    return (_heat(share, (225, 228, 232)) / 255).astype(np.float32)


def _heat(share: Float[np.ndarray, "*s"], none: tuple[int, int, int]) -> Float[np.ndarray, "*s 3"]:
    """Colours in 0 to 255 from ``none`` at 0 to nearly black at 1 and beyond."""
    stops = np.array([none, [253, 190, 133], [217, 71, 1], [60, 10, 0]], dtype=np.float64)
    places = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(share, places, stops[:, channel]) for channel in range(3)], axis=-1)


def normal_picture(normal: Float[np.ndarray, "h w 3"]) -> Picture:
    """Normals as colours: (n + 1) / 2 where there is one; a vector shorter than 1 fades to white, as alpha would."""
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    unit = normal / np.maximum(length, 1e-12)
    weight = length.clip(0, 1)
    return color_picture(weight * (0.5 + 0.5 * unit) + (1 - weight))


def png_data_uri(picture: Picture) -> str:
    """The picture as a PNG inside a ``data:`` address."""
    done, encoded = cv2.imencode(".png", picture[:, :, ::-1])
    if not done:
        raise ValueError("the picture cannot be encoded")
    return "data:image/png;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")
