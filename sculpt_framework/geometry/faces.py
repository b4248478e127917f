"""Geometry of triangles: pure functions of their corners, finite with finite gradients on every input.

A face counts as degenerate where its area cannot be told from rounding: twice the area is below ``16 eps`` times the
square of its longest side. Its normal and frame are then some orthonormal frame, constant (gradient 0) in the corners.
"""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor


def face_corners(vertices: Float[Tensor, "v 3"], faces: Int64[Tensor, "f 3"]) -> Float[Tensor, "f 3 3"]:
    """Positions of the corners: face, corner, coordinate."""
    return vertices.index_select(0, faces.reshape(-1)).reshape(-1, 3, 3)


def is_degenerate(corners: Float[Tensor, "f 3 3"]) -> Bool[Tensor, " f"]:
    """Whether a face has no area beyond rounding."""
    corners = corners.detach()
    limits = torch.finfo(corners.dtype)
    longest = (corners.roll(-1, dims=1) - corners).square().sum(dim=2).amax(dim=1)
    doubled_area = torch.linalg.vector_norm(_area_vectors(corners), dim=1)
    # Below the second bound the product of two sides underflows.
    return (doubled_area <= 16 * limits.eps * longest) | (longest <= limits.tiny**0.5)


def face_areas(corners: Float[Tensor, "f 3 3"]) -> Float[Tensor, " f"]:
    """Areas. The gradient of a degenerate face is 0."""
    degenerate = is_degenerate(corners)
    vector = torch.where(degenerate[:, None], _unit(corners, 2), _area_vectors(corners))
    return torch.where(degenerate, 0.0, 0.5 * torch.linalg.vector_norm(vector, dim=1))


def face_normals(corners: Float[Tensor, "f 3 3"]) -> Float[Tensor, "f 3"]:
    """Unit normals; counter-clockwise corners are seen from the side the normal points to."""
    return tangent_frame(corners)[:, :, 0]


def tangent_frame(corners: Float[Tensor, "f 3 3"]) -> Float[Tensor, "f 3 3"]:
    """Right-handed orthonormal frames; columns: normal, direction from corner 0 to 1, normal x that direction."""
    degenerate = is_degenerate(corners)[:, None]
    # Substituting before the division keeps the gradient of the branch that is not taken finite.
    area_vector = torch.where(degenerate, _unit(corners, 2), _area_vectors(corners))
    edge = torch.where(degenerate, _unit(corners, 0), corners[:, 1] - corners[:, 0])
    normal = area_vector / torch.linalg.vector_norm(area_vector, dim=1, keepdim=True)
    first = edge / torch.linalg.vector_norm(edge, dim=1, keepdim=True)
    frame = torch.stack([normal, first, torch.linalg.cross(normal, first)], dim=2)
    if not bool(degenerate.any()):
        return frame
    return torch.where(degenerate[..., None], _frame_along_longest_side(corners.detach()), frame)


def smallest_angles(
    squared_sides: Float[Tensor, "*faces 3"], doubled_areas: Float[Tensor, "*faces"]
) -> Float[Tensor, "*faces"]:
    """Smallest interior angle, in radians, of triangles given by their squared sides and twice their areas.

    0 where two corners coincide. A measure, not meant to be differentiated.
    """
    first, second, third = squared_sides.unbind(-1)
    shortest = torch.minimum(torch.minimum(first, second), third)
    # The smallest angle lies opposite the shortest side. atan2 of area and projection is accurate near 0, unlike acos.
    angle = torch.atan2(doubled_areas, 0.5 * (first + second + third) - shortest)
    return torch.where(shortest > 0, angle, 0.0)


def _area_vectors(corners: Float[Tensor, "f 3 3"]) -> Float[Tensor, "f 3"]:
    """Normals as long as twice the area."""
    return torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _unit(corners: Float[Tensor, "f 3 3"], axis: int) -> Float[Tensor, " 3"]:
    """The unit vector along an axis, in the dtype and on the device of the corners."""
    return torch.eye(3, dtype=corners.dtype, device=corners.device)[axis]


def _frame_along_longest_side(corners: Float[Tensor, "f 3 3"]) -> Float[Tensor, "f 3 3"]:
    """Some frame of each face with its second column along the longest side, if there is any side."""
    sides = corners.roll(-1, dims=1) - corners
    longest = sides.square().sum(dim=2).argmax(dim=1)
    side = sides[torch.arange(len(sides), device=sides.device), longest]
    # Scaling by the largest coordinate first keeps the norm of tiny sides from underflowing.
    largest = side.abs().amax(dim=1, keepdim=True)
    side = torch.where(largest > 0, side / torch.where(largest > 0, largest, 1.0), _unit(corners, 0))
    first = side / torch.linalg.vector_norm(side, dim=1, keepdim=True)
    # The axis least aligned with the side is never parallel to it.
    axis = torch.eye(3, dtype=corners.dtype, device=corners.device)[first.abs().argmin(dim=1)]
    normal = torch.linalg.cross(first, axis)
    normal = normal / torch.linalg.vector_norm(normal, dim=1, keepdim=True)
    return torch.stack([normal, first, torch.linalg.cross(normal, first)], dim=2)
