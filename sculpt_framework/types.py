"""The values that travel between stages. Immutable; tensors in them are never written in place.

Frames of reference
    world    the frame of the input poses and of everything written to disk; right-handed.
    object   what the optimiser works in: ``(world - scene.box.center) / scene.box.scale``, so that the longest
             half-side of the box is 1 whatever the units of the input. Fields, surfaces, Gaussians and the cameras
             given to a rasteriser are in the object frame unless a docstring says otherwise.
    camera   OpenCV: x right, y down, z forward. Pixel (column, row) has its centre at (column + 0.5, row + 0.5).

Axis names in shape strings: v vertices, f faces, g Gaussians, k Gaussians of a face, b spherical-harmonic bands,
c channels, h rows, w columns, n points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera.

    ``world_to_camera`` maps homogeneous points of the surrounding frame to the OpenCV camera frame. Focal lengths and
    principal point are in pixels of this camera's own image.
    """

    world_to_camera: Float[Tensor, "4 4"]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def position(self) -> Float[Tensor, " 3"]:
        """The camera centre in the surrounding frame."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -rotation.T @ translation

    def local(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Points of the surrounding frame in the camera frame."""
        pose = self.world_to_camera.double().cpu().numpy()
        local = points @ pose[:3, :3].T
        # Axis by axis, here and below: numpy takes four times as long to add a row to rows so short.
        for axis in range(3):
            local[:, axis] += pose[axis, 3]
        return local

    def pixels(self, local: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Column and row of points in the camera frame; NaN of points that are not in front of the camera."""
        depth = np.where(local[:, 2] > 0, local[:, 2], np.nan)
        pixels = np.empty((len(local), 2))
        for axis, (focal, center) in enumerate(((self.fx, self.cx), (self.fy, self.cy))):
            pixels[:, axis] = local[:, axis] / depth * focal + center
        return pixels

    def project(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Column and row of points of the surrounding frame; NaN of points that are not in front of the camera.

        A point on the image's upper left corner is at (0, 0), one on its lower right at (width, height).
        """
        return self.pixels(self.local(points))

    def shows(self, pixels: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Which of them are in the image, its border included; NaN is not."""
        return np.all((pixels >= 0) & (pixels <= (self.width, self.height)), axis=1)

    def crop(self, x0: int, y0: int, width: int, height: int) -> "Camera":
        """The camera of the window whose upper left pixel is (column x0, row y0)."""
        return replace(self, cx=self.cx - x0, cy=self.cy - y0, width=width, height=height)

    def resized(self, width: int, height: int) -> "Camera":
        """The same view sampled with ``width`` x ``height`` pixels."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy, width=width, height=height
        )

    def to(self, device: torch.device, dtype: torch.dtype) -> "Camera":
        return replace(self, world_to_camera=self.world_to_camera.to(device=device, dtype=dtype))


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """One posed image: colour is sRGB in [0, 1] with straight alpha (not multiplied), the camera is in world frame."""

    name: str
    camera: Camera
    rgb: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"] | None
    """Coverage in [0, 1]; None where the data say nothing about it."""
    source: Path | None = None
    """The file the image was read from; None if it was not."""

    @property
    def shows_object(self) -> bool:
        """Whether more than half of any pixel is covered; always where nothing is known of coverage."""
        return self.alpha is None or bool((self.alpha > 0.5).any())


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """An axis-aligned box, in the frame that its owner says. That of a scene is in world frame and holds the object.

    The object frame, which some methods here go to and from, is that of the scene's box.
    """

    minimum: Float[Tensor, " 3"]
    maximum: Float[Tensor, " 3"]

    @staticmethod
    def between(
        low: Sequence[float] | Float64[np.ndarray, " 3"], high: Sequence[float] | Float64[np.ndarray, " 3"]
    ) -> "Box":
        """The box with these corners, in float64."""
        return Box(minimum=torch.tensor(low, dtype=torch.float64), maximum=torch.tensor(high, dtype=torch.float64))

    @property
    def center(self) -> Float[Tensor, " 3"]:
        return 0.5 * (self.minimum + self.maximum)

    @property
    def scale(self) -> float:
        """Half of the longest side: one unit of the object frame in world units."""
        return 0.5 * float((self.maximum - self.minimum).max())

    @property
    def half_sides(self) -> Float[Tensor, " 3"]:
        """Half sides in the object frame; the largest is 1."""
        return 0.5 * (self.maximum - self.minimum) / self.scale

    def depth(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Distance to the nearest wall, positive inside, negative outside (there a lower bound in size)."""
        low, high = self.minimum.to(points), self.maximum.to(points)
        return torch.minimum(points - low, high - points).amin(dim=1)

    def to_object(self, points: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
        return (points - self.center.to(points)) / self.scale

    def to_world(self, points: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
        return points * self.scale + self.center.to(points)

    def camera_to_object(self, camera: Camera) -> Camera:
        """The camera as seen from the object frame. Its distances are in object units; the pixels are the same."""
        pose = camera.world_to_camera.double()
        moved = pose.clone()
        moved[:3, 3] = (pose[:3, :3] @ self.center.double() + pose[:3, 3]) / self.scale
        return replace(camera, world_to_camera=moved.to(camera.world_to_camera.dtype))


@dataclass(frozen=True, kw_only=True)
class Support:
    """A plane that the object stands on, or before. Nothing of the object lies behind it."""

    normal: tuple[float, float, float]
    """Unit, to the side the object is on."""
    offset: float
    """Product of the normal with any point of the plane; larger in front of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What a dataset hands over. Cameras and box in world frame."""

    name: str
    train: tuple[View, ...]
    test: tuple[View, ...]
    box: Box
    reference_mesh: Path | None = None
    """A mesh file in world frame the result may be compared with; never used for training or selection."""
    notes: tuple[str, ...] = ()
    """One line each for whatever was unusual in the input and what is done about it."""
    up: tuple[float, float, float] | None = None
    """The side that the plane the object stands on faces, unit, where that was found in the photographs."""
    supports: tuple[Support, ...] = ()
    """What the object stands on and before, world frame, where that was found in the photographs."""
    points: Float64[np.ndarray, "n 3"] | None = None
    """Places that photographs show, of the object and of what is around it, world frame; None where none are known."""
    data: str = ""
    """Where it was read from, as ``--data`` says it; empty for one that was built by hand."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A triangle mesh with names that outlive a re-extraction.

    Faces turn counter-clockwise seen from outside. ``face_keys`` are distinct; a face that is extracted again at the
    same place of the grid has the same key and the same order of vertices.
    """

    vertices: Float[Tensor, "v 3"]
    faces: Int64[Tensor, "f 3"]
    face_keys: Int64[Tensor, " f"]

    def detach(self) -> "Surface":
        return replace(self, vertices=self.vertices.detach())


@dataclass(frozen=True, kw_only=True, eq=False)
class Gaussians:
    """Anisotropic Gaussians: covariance = A A^T with A = ``rotations`` times diag(``scales``).

    The columns of ``rotations`` are unit vectors. Column 0 is the outward normal of the face the Gaussian lies on; the
    other two span its plane but need not be orthogonal (a binder may use conjugate radii). ``sh`` are coefficients of
    real spherical harmonics as in 3DGS: colour = 0.5 + sum_b sh_b Y_b(direction from camera), clamped at 0 from below.
    """

    means: Float[Tensor, "g 3"]
    scales: Float[Tensor, "g 3"]
    rotations: Float[Tensor, "g 3 3"]
    opacities: Float[Tensor, " g"]
    sh: Float[Tensor, "g b 3"]
    face: Int64[Tensor, " g"]

    def __len__(self) -> int:
        return self.means.shape[0]

    def to(self, device: torch.device) -> "Gaussians":
        return Gaussians(**{field.name: getattr(self, field.name).to(device) for field in fields(self)})


@dataclass(frozen=True, kw_only=True, eq=False)
class Rendering:
    """What a rasteriser makes of Gaussians. w_i are the compositing weights of the Gaussians at a pixel.

    rgb = sum_i w_i c_i + (1 - alpha) background; alpha = sum_i w_i; depth = sum_i w_i z_i (camera z, not divided by
    alpha); normal = sum_i w_i n_i in the frame of the Gaussians, None where it was not asked for.
    """

    rgb: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"]
    depth: Float[Tensor, "h w"]
    normal: Float[Tensor, "h w 3"] | None = None
