"""Pictures of an analytic object by sphere tracing.

One ray per pixel finds surface and colour; pixels on an outline, at a jump in depth, or that a thin part may cross
unseen, are traced again with a grid of rays, whose share of hits is their coverage.
"""

from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sculpt_framework.demo_scenes.distance import Points, Values
from sculpt_framework.demo_scenes.objects import DemoObject
from sculpt_framework.types import Camera

Distance = Callable[[Points], Values]
Origin = Float[np.ndarray, " 3"]

BOUND = 1.02
"""Objects lie within this distance of the origin."""
_STEP = 6e-3  # Shortest step, in world units: a pixel, but along the ray.
_HALVINGS = 6  # To a hundredth of a pixel.
_PATIENCE = 24  # Steps after which the shortest step grows, for the few rays that run along the surface.
_STEPS = 130  # Enough to cross the ball by shortest steps.
FINEST = 240  # Images with fewer pixels along a side are rendered larger and reduced: their texture would alias.
_SAMPLES = 4  # Rays along each side of a pixel that is traced again.
_DEPTH_JUMP = 0.04
_LIGHT = (0.36, -0.48, 0.8)
_LAMPS = ((0.36, -0.48, 0.8), (-0.8, 0.1, 0.6), (0.5, 0.8, 0.3), (-0.3, -0.8, -0.4))
_SHARPNESS = 24  # Phong's exponent: highlights some 30 degrees wide.


def render(item: DemoObject, camera: Camera) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """sRGB colour (straight) and coverage of every pixel; colour is 0 where coverage is."""
    factor = -(-FINEST // max(camera.width, camera.height))
    if factor > 1:
        rgb, alpha = render(item, camera.resized(camera.width * factor, camera.height * factor))
        return _reduce(rgb, alpha, factor)
    shape = (camera.height, camera.width)
    rows, columns = np.indices(shape, dtype=np.float32).reshape(2, -1) + np.float32(0.5)
    origin, directions = _rays(camera, columns, rows)
    # Half a pixel's diagonal, with something to spare: the ball around a ray's point that holds the pixel's other rays.
    spread = 0.75 / min(camera.fx, camera.fy)
    depth, clear = trace(item.distance, origin, directions, np.zeros_like(rows), spread)
    hit = np.isfinite(depth)
    rgb, alpha = np.zeros((rows.size, 3), np.float32), hit.astype(np.float32)
    rgb[hit] = _shade(item, origin, directions[:, hit], depth[hit])
    again = np.isfinite(clear) & (~hit | _outlines(depth.reshape(shape)).ravel())
    rgb[again], alpha[again] = _supersample(item, camera, columns[again], rows[again], clear[again])
    return rgb.reshape(*shape, 3), alpha.reshape(shape)


def trace(
    distance: Distance, origin: Origin, directions: Points, start: Values, spread: float = 0.0
) -> tuple[Values, Values]:
    """Walk along unit rays from the distances ``start``: distance to the surface, and how far a cone around is clear.

    The first is infinite where a ray misses. The second is how far a cone of half angle ``spread`` radians, small,
    around the ray is known to be empty; infinite if it is so to the end.
    """
    dtype = directions.dtype.type
    total = directions.shape[1]
    before, after = np.zeros(total, dtype), np.full(total, np.inf, dtype)
    clear = np.full(total, np.inf, dtype)
    along = -np.einsum("i,in->n", origin, directions)
    discriminant = along * along - (origin @ origin - dtype(BOUND * BOUND))
    live = np.flatnonzero(discriminant > 0)
    root = np.sqrt(discriminant[live])
    t, end = np.maximum(along[live] - root, start[live]), along[live] + root
    ray = np.ascontiguousarray(directions[:, live])
    last = t
    for count in range(_STEPS):
        gap = distance(origin[:, None] + t * ray)
        touched = (gap <= dtype(spread) * t) & np.isinf(clear[live])
        clear[live[touched]] = last[touched]
        inside = gap < 0
        before[live[inside]], after[live[inside]] = last[inside], t[inside]
        keep = ~(inside | (t > end))
        live, last, end, ray = live[keep], t[keep], end[keep], np.compress(keep, ray, axis=1)
        if live.size == 0:
            break
        # Never less than _STEP, or rays along the surface would take forever; a chord that short is no depth at all.
        t = last + np.maximum(gap[keep], dtype(_STEP * max(1, count / _PATIENCE)))
    hit = np.flatnonzero(np.isfinite(after))
    depth = np.full(total, np.inf, dtype)
    depth[hit] = _bisect(distance, origin, np.compress(np.isfinite(after), directions, axis=1), before[hit], after[hit])
    return depth, clear


def _bisect(distance: Distance, origin: Origin, ray: Points, before: Values, after: Values) -> Values:
    """Where rays enter, between a point outside and one inside."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (before + after)
        outside = distance(origin[:, None] + middle * ray) >= 0
        before, after = np.where(outside, middle, before), np.where(outside, after, middle)
    return 0.5 * (before + after)


def surface_normal(distance: Distance, points: Points, step: float) -> Float[np.ndarray, "3 n"]:
    """Unit gradient of the distance by central differences."""
    gradient = np.empty_like(points)
    for axis in range(3):
        offset = np.zeros((3, 1), points.dtype)
        offset[axis] = step
        gradient[axis] = distance(points + offset) - distance(points - offset)
    return gradient / np.maximum(np.sqrt((gradient * gradient).sum(axis=0)), 1e-12)


def surface_color(item: DemoObject, points: Points) -> Float[np.ndarray, "n 3"]:
    """Texture under a fixed soft light, the same from every side: what a photograph of a matt object shows."""
    normal = surface_normal(item.distance, points, 2e-3)
    light = 0.8 + 0.2 * np.einsum("i,in->n", np.array(_LIGHT, points.dtype), normal)
    return np.ascontiguousarray((item.texture(points) * light).T)


def _shade(item: DemoObject, origin: Origin, directions: Points, depth: Values) -> Float[np.ndarray, "n 3"]:
    points = origin[:, None] + depth * directions
    color = surface_color(item, points)
    if item.gloss == 0:
        return color
    normal = surface_normal(item.distance, points, 2e-3)
    mirrored = directions - 2 * np.einsum("in,in->n", directions, normal) * normal
    lamps = np.array(_LAMPS, points.dtype) / np.linalg.norm(_LAMPS, axis=1, keepdims=True).astype(points.dtype)
    highlight = np.maximum(np.einsum("ki,in->kn", lamps, mirrored), 0) ** _SHARPNESS
    return np.minimum(color + item.gloss * highlight.sum(axis=0)[:, None], 1)


def _rays(camera: Camera, columns: Values, rows: Values) -> tuple[Origin, Points]:
    """Origin and unit directions in world of rays through image points, in pixels."""
    rotation = camera.world_to_camera[:3, :3].numpy().astype(np.float32)
    local = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)])
    # Not matmul: it wakes a pool of threads for a few multiplications, while all cores already render.
    directions = np.einsum("ij,in->jn", rotation, local.astype(np.float32))
    return camera.position.numpy().astype(np.float32), directions / np.linalg.norm(directions, axis=0)


def _outlines(depth: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels whose 3x3 surroundings are not one piece of surface, or of background."""
    finite = np.where(np.isfinite(depth), depth, np.float32(100))
    kernel = np.ones((3, 3), np.uint8)
    return cv2.dilate(finite, kernel) - cv2.erode(finite, kernel) > _DEPTH_JUMP


def _supersample(
    item: DemoObject, camera: Camera, columns: Values, rows: Values, clear: Values
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    steps = ((np.arange(_SAMPLES, dtype=np.float32) + 0.5) / _SAMPLES - 0.5)[None, :, None]
    shape = (columns.size, _SAMPLES, _SAMPLES)
    x = np.broadcast_to(columns[:, None, None] + steps, shape).ravel()
    y = np.broadcast_to(rows[:, None, None] + steps.transpose(0, 2, 1), shape).ravel()
    origin, directions = _rays(camera, x, y)
    # Where a pixel's middle ray is still clear its others are: most of the way need not be walked again.
    start = np.repeat(np.where(np.isfinite(clear), clear, 0), _SAMPLES * _SAMPLES).astype(np.float32)
    depth, _ = trace(item.distance, origin, directions, start)
    hit = np.isfinite(depth)
    rgb = np.zeros((depth.size, 3), np.float32)
    rgb[hit] = _shade(item, origin, directions[:, hit], depth[hit])
    share = hit.reshape(columns.size, -1).mean(axis=1, dtype=np.float32)
    total = rgb.reshape(columns.size, -1, 3).mean(axis=1)
    return total / np.maximum(share, 1e-6)[:, None], share


def _reduce(
    rgb: Float[np.ndarray, "h w 3"], alpha: Float[np.ndarray, "h w"], factor: int
) -> tuple[Float[np.ndarray, "h2 w2 3"], Float[np.ndarray, "h2 w2"]]:
    """Mean over blocks, colour weighted by coverage."""
    height, width = alpha.shape[0] // factor, alpha.shape[1] // factor
    covered = (rgb * alpha[..., None]).reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    share = alpha.reshape(height, factor, width, factor).mean(axis=(1, 3))
    return covered / np.maximum(share, 1e-6)[..., None], share
