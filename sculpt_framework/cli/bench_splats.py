"""The object that ``sculpt-bench`` renders: a bumpy sphere that fills two fifths of the image."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import torch
    from jaxtyping import Float64, Int32
    from torch import Tensor

    from sculpt_framework.types import Camera


def bumpy_sphere_camera(size: int, device: "torch.device") -> "Camera":
    """Square image of ``size`` pixels, the object 2.6 units away."""
    import torch

    from sculpt_framework.types import Camera

    pose = torch.eye(4, device=device)
    pose[2, 3] = 2.6
    return Camera(world_to_camera=pose, fx=1.1 * size, fy=1.1 * size, cx=size / 2, cy=size / 2, width=size, height=size)


def bumpy_sphere(faces: int) -> "tuple[Float64[np.ndarray, 'v 3'], Int32[np.ndarray, 'f 3']]":
    """Vertices and triangles, outward, of a star-shaped mesh with ``faces`` faces (an even number)."""
    import numpy as np
    from scipy.spatial import ConvexHull

    # Points evenly over the sphere by the golden angle; their hull is a triangulation of the sphere.
    count = faces // 2 + 2
    index = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * index / count, np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z * z)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    triangles = ConvexHull(points).simplices
    corners = points[triangles]
    inward = np.linalg.det(corners) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return points * (0.8 + 0.06 * np.sin(5.0 * points).prod(axis=1, keepdims=True)), triangles


def splats_on_bumpy_sphere(faces: int, per_face: int) -> "list[Tensor]":
    """Means, scales, rotations, opacities and colours of nearly opaque Gaussians on the mesh."""
    import numpy as np
    import torch

    points, triangles = bumpy_sphere(faces)
    corners = points[triangles]
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(along, across)
    doubled_area = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= doubled_area
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    frames = np.stack([normals, along, np.cross(normals, along)], axis=2)
    half_edges = 0.5 * np.sqrt(doubled_area * 2.0 / 3.0**0.5) / per_face**0.5
    generator = np.random.default_rng(0)
    weights = generator.dirichlet((3.0, 3.0, 3.0), size=(faces, per_face))
    arrays = (
        np.einsum("fkc,fcd->fkd", weights, corners).reshape(-1, 3),
        np.repeat(half_edges * (1e-2, 1.0, 1.0), per_face, axis=0),
        np.repeat(frames, per_face, axis=0),
        np.full(faces * per_face, 0.99),
        generator.random((faces * per_face, 3)),
    )
    return [torch.tensor(array, dtype=torch.float32) for array in arrays]
