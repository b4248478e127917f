"""Views of surfaces of which everything is known, rendered by exact intersection."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps
from sculpt_framework.multi_view_stereo.stereo_views import StereoViews
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.types import Camera, View

Luminance = Callable[[np.ndarray], np.ndarray]
DISTANCE = 4.0
_SUPER = 3


class Surface(ABC):
    @abstractmethod
    def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """How many times a ray [n, 3] goes into the way to the surface; infinite where it misses."""

    @abstractmethod
    def normal(self, points: np.ndarray) -> np.ndarray:
        """Unit, [n, 3], outwards."""


@dataclass(frozen=True, kw_only=True)
class Plane(Surface):
    facing: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit normal; the plane goes through the origin."""

    def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        facing = np.array(self.facing)
        return -(origin @ facing) / (rays @ facing)

    def normal(self, points: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.array(self.facing), points.shape)


@dataclass(frozen=True, kw_only=True)
class Step(Surface):
    """Two planes that face +z, ``high`` above z = 0 where x is negative, as far below elsewhere, and a riser."""

    high: float

    def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        best = np.full(len(rays), np.inf)
        for z, side in ((self.high, -1), (-self.high, 1)):
            way = (z - origin[2]) / rays[:, 2]
            best = np.where(side * (origin[0] + way * rays[:, 0]) >= 0, np.minimum(best, way), best)
        way = -origin[0] / np.where(rays[:, 0] == 0, 1e-12, rays[:, 0])
        return np.where((way > 0) & (np.abs(origin[2] + way * rays[:, 2]) < self.high), np.minimum(best, way), best)

    def normal(self, points: np.ndarray) -> np.ndarray:
        riser = np.abs(points[:, 2]) < 0.99 * self.high
        return np.where(riser[:, None], np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, kw_only=True)
class DentedBall(Surface):
    """A ball around the origin without what lies in a smaller one, whose middle is on the z axis."""

    radius: float = 0.8
    dent: float = 0.45
    """Radius of the dent; 0 for none."""
    middle: float = 0.9

    def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        enters, leaves = _crossings(origin, rays, np.zeros(3), self.radius)
        dent = np.array([0.0, 0.0, self.middle])
        begins, ends = _crossings(origin, rays, dent, self.dent)
        dug = (begins <= enters) & (enters < ends)
        return np.where(dug, np.where(ends < leaves, ends, np.inf), enters)

    def normal(self, points: np.ndarray) -> np.ndarray:
        inwards = np.array([0.0, 0.0, self.middle]) - points
        in_dent = np.abs(np.linalg.norm(inwards, axis=1) - self.dent) < 1e-3
        normals = np.where(in_dent[:, None], inwards, points)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def distance(self, points: np.ndarray) -> np.ndarray:
        dug = self.dent - np.linalg.norm(points - np.array([0.0, 0.0, self.middle]), axis=1)
        return np.maximum(np.linalg.norm(points, axis=1) - self.radius, dug)


def _crossings(origin: np.ndarray, rays: np.ndarray, middle: np.ndarray, radius: float) -> tuple[np.ndarray, ...]:
    """Where rays enter a ball and where they leave it; infinite, and minus that, where they do not."""
    square, half = (rays**2).sum(axis=1), rays @ (origin - middle)
    inner = half**2 - square * ((origin - middle) @ (origin - middle) - radius**2)
    root = np.sqrt(np.maximum(inner, 0))
    hits = inner > 0
    return np.where(hits, (-half - root) / square, np.inf), np.where(hits, (-half + root) / square, -np.inf)


def waves(points: np.ndarray) -> np.ndarray:
    """A smooth pseudo-random luminance in (0, 1), with wavelengths from 0.14 to 0.5."""
    random = np.random.default_rng(5)
    total = np.zeros(len(points))
    for wavelength in np.geomspace(0.14, 0.5, 16):
        way = random.normal(size=3)
        way *= 2 * np.pi / wavelength / np.linalg.norm(way)
        total += np.sin(points @ way + random.uniform(0, 2 * np.pi))
    return 0.5 + 0.4 * np.tanh(0.3 * total)


def camera_at(direction: Sequence[float], side: int) -> Camera:
    """Of a square image, looking at the origin, where a unit is half its side wide."""
    position = DISTANCE * np.array(direction) / np.linalg.norm(direction)
    forward = -position / DISTANCE
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ position
    focal = DISTANCE * side / 2
    return Camera(
        world_to_camera=torch.from_numpy(pose), fx=focal, fy=focal, cx=side / 2, cy=side / 2, width=side, height=side
    )


def fan(side: int = 64) -> list[Camera]:
    """Nine cameras around +z, some 12 degrees apart, in uneven rows."""
    steps = np.random.default_rng(1).uniform(-0.04, 0.04, size=(9, 2))
    rows = [(0.21 * (i % 3 - 1) + dx, 0.21 * (i // 3 - 1) + dy) for i, (dx, dy) in enumerate(steps)]
    return [camera_at((x, y, 1.0), side) for x, y in rows]


def photograph(surface: Surface, camera: Camera, luminance: Luminance = waves, *, masked: bool = False) -> View:
    """A grey image: each pixel is the mean over a grid of rays, and its alpha their share of hits."""
    fine = camera.resized(_SUPER * camera.width, _SUPER * camera.height)
    pose = fine.world_to_camera.numpy()
    origin = camera.position.numpy()
    rays = _local(fine.height, fine.width, np.array([fine.fx, fine.fy, fine.cx, fine.cy])) @ pose[:3, :3]
    ways = surface.hit(origin, rays)
    hits = np.isfinite(ways)
    values = np.zeros(len(rays))
    values[hits] = luminance(origin + ways[hits, None] * rays[hits])
    shape = (camera.height, _SUPER, camera.width, _SUPER)
    alpha = hits.reshape(shape).mean(axis=(1, 3))
    grey = values.reshape(shape).mean(axis=(1, 3)) / np.maximum(alpha, 1e-9)
    rgb = torch.from_numpy(np.repeat(grey[..., None], 3, axis=2).astype(np.float32))
    coverage = torch.from_numpy(alpha.astype(np.float32)) if masked else None
    return View(name="", camera=camera, rgb=rgb, alpha=coverage)


def box(half_side: float = 1.0, cells: int = 32) -> Volume:
    """All of a cube is solid."""
    values = np.full((cells,) * 3, -1, np.float32)
    return Volume(values=values, origin=(-half_side, -half_side, -half_side), cell=2 * half_side / cells)


def ball(radius: float, cells: int = 40) -> Volume:
    """The signed distance of a ball around the origin."""
    x, y, z = np.meshgrid(*[np.linspace(-1, 1, cells + 1)] * 3, indexing="ij")
    values = np.sqrt(x**2 + y**2 + z**2) - radius
    start = -1 - 1 / cells
    return Volume(values=values.astype(np.float32), origin=(start, start, start), cell=2 / cells)


def _local(height: int, width: int, lens: np.ndarray) -> np.ndarray:
    """Rays through the pixels' middles, of depth 1, in the camera's frame."""
    rows, columns = np.indices((height, width)).reshape(2, -1) + 0.5
    return np.stack([(columns - lens[2]) / lens[0], (rows - lens[3]) / lens[1], np.ones(rows.size)], axis=1)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """At the pixels of a stack; depth 0 beside the surface and outside of the masks."""

    depths: np.ndarray
    normals: np.ndarray
    """In the cameras' frames."""
    points: np.ndarray


def truth_of(surface: Surface, stack: StereoViews) -> Truth:
    shape = stack.luminance.shape
    depths, points = np.zeros(shape, np.float32), np.zeros((*shape, 3))
    normals = np.zeros((*shape, 3), np.float32)
    for i in range(len(stack)):
        turn, origin = stack.poses[i, :, :3].astype(float), stack.positions[i].astype(float)
        rays = _local(shape[1], shape[2], stack.lenses[i].astype(float)) @ turn
        ways = surface.hit(origin, rays).reshape(shape[1:])
        hits = np.isfinite(ways) & stack.inside[i]
        points[i][hits] = origin + ways[hits][:, None] * rays.reshape(*shape[1:], 3)[hits]
        normals[i][hits] = surface.normal(points[i][hits]) @ turn.T
        depths[i] = np.where(hits, ways, 0)
    return Truth(depths=depths, normals=normals, points=points)


def exact_maps(surface: Surface, stack: StereoViews) -> DepthMaps:
    truth = truth_of(surface, stack)
    confidence = (truth.depths > 0).astype(np.float32)
    return DepthMaps(views=stack, depths=truth.depths, normals=truth.normals, confidence=confidence)


def off_by(maps: DepthMaps, truth: Truth) -> np.ndarray:
    """Errors of the known depths in pixels of a view 12 degrees away; infinite where there is no surface."""
    known = maps.depths > 0
    true = truth.depths[known]
    pixel = DISTANCE**2 / (float(np.median(maps.views.lenses[:, 0])) * DISTANCE * np.sin(np.radians(12)))
    return np.where(true > 0, np.abs(maps.depths[known] - true) / pixel, np.inf)
