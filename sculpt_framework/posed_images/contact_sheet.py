"""A picture of a scene: where its cameras stand, the box, and its photographs with their masks and the box in them."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from sculpt_framework.posed_images.projected_box import box_edges
from sculpt_framework.spread import spread
from sculpt_framework.types import Box, Scene, View

Picture = UInt8[np.ndarray, "h w 3"]
_THUMB = 150
_COLUMNS = 8
_MOST = 40
_MAP = 4 * _THUMB
_INK, _BOX, _CAMERA, _TEST, _OUTLINE = (40, 44, 52), (46, 125, 50), (25, 90, 170), (200, 110, 20), (230, 30, 120)
_EDGE = (0, 190, 60)
"""sRGB."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def contact_sheet(scene: Scene) -> Picture:
    """Two plans, from above (z up) and from the side, and up to 40 train views, spread evenly over all of them.

    What is outside a mask is faded, the outline drawn; views without a mask are shown as they are. The box's edges are
    drawn into all of them.
    """
    thumbs = [thumbnail(view, scene.box) for view in spread(scene.train, _MOST)]
    plans = np.hstack([_plan(scene, (0, 1), "x to the right, y up"), _plan(scene, (0, 2), "x to the right, z up")])
    width = _COLUMNS * _THUMB
    rows = [plans]
    for start in range(0, len(thumbs), _COLUMNS):
        row = np.hstack(thumbs[start : start + _COLUMNS])
        rows.append(np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255))
    return np.ascontiguousarray(np.vstack(rows))


def thumbnail(view: View, box: Box) -> Picture:
    """A view at the size of the sheet, named, with its mask and the edges of the box."""
    pixels = with_box(view, box, _THUMB - 6)
    out = np.full((_THUMB, _THUMB, 3), 255, np.uint8)
    out[3 : 3 + pixels.shape[0], 3 : 3 + pixels.shape[1]] = pixels
    label = view.name[-20:]
    cv2.putText(out, label, (5, _THUMB - 6), _FONT, 0.35, (255, 255, 255), 3, cv2.LINE_AA)
    cv2.putText(out, label, (5, _THUMB - 6), _FONT, 0.35, _INK, 1, cv2.LINE_AA)
    return out


def with_box(view: View, box: Box, side: int) -> Picture:
    """A view, its longer side so many pixels, with its mask and the edges of the box."""
    factor = side / max(view.camera.width, view.camera.height)
    size = max(1, round(view.camera.width * factor)), max(1, round(view.camera.height * factor))
    image = np.asarray(cv2.resize(view.rgb.numpy(), size, interpolation=cv2.INTER_AREA)).clip(0, 1)
    pixels = np.rint(image * 255).astype(np.uint8)
    if view.alpha is not None:
        alpha = np.asarray(cv2.resize(view.alpha.numpy(), size, interpolation=cv2.INTER_AREA))[..., None]
        pixels = np.rint(pixels * alpha + (0.25 * pixels + 0.75 * 235) * (1 - alpha)).astype(np.uint8)
        outlines, _ = cv2.findContours((alpha[..., 0] > 0.5).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(pixels, outlines, -1, _OUTLINE, 1)
    _draw_edges(pixels, box_edges(view.camera.resized(*size), box))
    return pixels


def _draw_edges(pixels: Picture, edges: Float64[np.ndarray, "n 2 2"]) -> None:
    height, width = pixels.shape[:2]
    # A pixel's centre is half a pixel from its corner, and at a whole number where lines are drawn.
    for start, end in np.rint(edges - 0.5).astype(np.int64).tolist():
        meets, first, last = cv2.clipLine((0, 0, width, height), start, end)
        if meets:
            cv2.line(pixels, first, last, _EDGE, 1)


def _plan(scene: Scene, axes: tuple[int, int], title: str) -> Picture:
    """The cameras and the box along two axes of the world."""
    out = np.full((_MAP, _MAP, 3), 250, np.uint8)
    low, high = scene.box.minimum.double().numpy(), scene.box.maximum.double().numpy()
    train, test = _centers(scene.train), _centers(scene.test)
    everything = np.concatenate([train, test, low[None], high[None]])[:, axes]
    middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    scale = 0.42 * _MAP / max(float(np.ptp(everything, axis=0).max()) / 2, 1e-12)

    def place(point: Float64[np.ndarray, " 3"]) -> tuple[int, int]:
        right, up = (point[list(axes)] - middle) * scale
        return round(_MAP / 2 + right), round(_MAP / 2 - up)

    length = 0.12 * float(np.ptp(everything, axis=0).max())
    for views, color in ((scene.train, _CAMERA), (scene.test, _TEST)):
        for view in views:
            pose = view.camera.world_to_camera.double().numpy()
            center = view.camera.position.double().numpy()
            cv2.line(out, place(center), place(center + length * pose[2, :3]), color, 1, cv2.LINE_AA)
            cv2.circle(out, place(center), 3, color, -1, cv2.LINE_AA)
    cv2.rectangle(out, place(low), place(high), _BOX, 2)
    words = f"{title}; box green, train blue" + (", test orange" if scene.test else "")
    cv2.putText(out, words, (12, 22), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
    cv2.putText(out, f"box {np.ptp([low, high], axis=0).max():.3g} wide", (12, 42), _FONT, 0.5, _INK, 1, cv2.LINE_AA)
    return out


def _centers(views: Sequence[View]) -> Float64[np.ndarray, "n 3"]:
    return np.array([view.camera.position.double().numpy() for view in views], np.float64).reshape(-1, 3)
