"""Gaussians in the PLY layout of 3DGS, which splat viewers open.

One row per Gaussian: x y z, nx ny nz, f_dc_0..2, f_rest_* (channel by channel: all bands of red, then green, then
blue), opacity (logit), scale_0..2 (natural logarithm of the standard deviations), rot_0..3 (unit quaternion w x y z of
the rotation whose columns the scales go along), and beyond the standard an integer ``face``, the face it is bound to.
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.errors import DataError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.ply import encode_ply, read_vertex_rows
from sculpt_framework.types import Gaussians

_OPACITY_MARGIN = 1e-6
"""Opacities are held this far from 0 and 1, where the logit is infinite."""
_SMALLEST_SCALE = 1e-12
"""Standard deviations are held above this: the logarithm of 0 is infinite."""


def write_gaussians_ply(path: Path, gaussians: Gaussians) -> None:
    """Write the Gaussians in the frame they come in. Normals are column 0 of the rotations, the faces' normals.

    Raises ValueError where the columns of ``rotations`` are not orthonormal, which a quaternion cannot say (see
    ``geometry.principal_axes``), and OutputError where the file cannot be written.
    """
    products = gaussians.rotations.transpose(1, 2) @ gaussians.rotations
    if not torch.allclose(products, torch.eye(3).to(products), atol=1e-3):
        raise ValueError("the axes of these Gaussians are not orthonormal; principal_axes makes them so")
    count, bands = len(gaussians), gaussians.sh.shape[1]
    opacity = gaussians.opacities.detach().double().clamp(_OPACITY_MARGIN, 1 - _OPACITY_MARGIN)
    columns = {
        "xyz": (("x", "y", "z"), gaussians.means),
        "normal": (("nx", "ny", "nz"), gaussians.rotations[:, :, 0]),
        "dc": (_numbered("f_dc", 3), gaussians.sh[:, 0]),
        "rest": (_numbered("f_rest", 3 * (bands - 1)), gaussians.sh[:, 1:].transpose(1, 2).reshape(count, -1)),
        "opacity": (("opacity",), opacity.logit()[:, None]),
        "scale": (_numbered("scale", 3), gaussians.scales.clamp_min(_SMALLEST_SCALE).log()),
        "rot": (_numbered("rot", 4), quaternions_from_rotations(gaussians.rotations)),
    }
    names = [name for group, _ in columns.values() for name in group]
    rows = np.zeros(count, dtype=[*((name, "<f4") for name in names), ("face", "<i4")])
    for group, values in columns.values():
        array = values.detach().cpu().numpy()
        for index, name in enumerate(group):
            rows[name] = array[:, index]
    rows["face"] = gaussians.face.cpu().numpy()
    write_atomically(path, encode_ply([("vertex", rows)]))


def read_gaussians_ply(path: Path) -> Gaussians:
    """Inverse of ``write_gaussians_ply``, to 32-bit precision; files of other programs get face -1.

    Raises DataError where the file is not of this layout.
    """
    rows = read_vertex_rows(path)
    present = rows.dtype.names or ()

    def columns(*names: str) -> Float[Tensor, "n c"]:
        missing = [name for name in names if name not in present]
        if missing:
            raise DataError(f"{path} is not a file of Gaussians: it has no property {', '.join(missing)}")
        return torch.from_numpy(np.stack([rows[name].astype(np.float32) for name in names], axis=1))

    rest_names = _numbered("f_rest", sum(name.startswith("f_rest_") for name in present))
    dc = columns(*_numbered("f_dc", 3))[:, None]
    if rest_names:
        dc = torch.cat([dc, columns(*rest_names).reshape(len(rows), 3, -1).transpose(1, 2)], dim=1)
    face = rows["face"].astype(np.int64) if "face" in present else np.full(len(rows), -1)
    return Gaussians(
        means=columns("x", "y", "z"),
        scales=columns(*_numbered("scale", 3)).exp(),
        rotations=rotations_from_quaternions(columns(*_numbered("rot", 4))),
        opacities=columns("opacity")[:, 0].sigmoid(),
        sh=dc,
        face=torch.from_numpy(face),
    )


def joined(first: Gaussians, second: Gaussians) -> Gaussians:
    """All of both; colours that have fewer bands have zeros in the others."""
    bands = max(first.sh.shape[1], second.sh.shape[1])
    sh = [torch.cat([g.sh, g.sh.new_zeros(len(g), bands - g.sh.shape[1], 3)], dim=1) for g in (first, second)]
    return Gaussians(
        means=torch.cat([first.means, second.means]),
        scales=torch.cat([first.scales, second.scales]),
        rotations=torch.cat([first.rotations, second.rotations]),
        opacities=torch.cat([first.opacities, second.opacities]),
        sh=torch.cat(sh),
        face=torch.cat([first.face, second.face]),
    )


def quaternions_from_rotations(rotations: Float[Tensor, "g 3 3"]) -> Float[Tensor, "g 4"]:
    """Unit quaternions (w, x, y, z) with w >= 0.

    A matrix with determinant -1 has its last column turned round first: a Gaussian looks the same from both ends of an
    axis. Of the four equivalent formulas each row takes the one that divides by the largest component.
    """
    m = rotations.detach().double()
    m = torch.cat([m[:, :, :2], m[:, :, 2:] * torch.linalg.det(m).sign()[:, None, None]], dim=2)
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    x_part, y_part, z_part = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    # Row k is the quaternion times four times its component k, so its entry k is that component's square times four.
    scaled = torch.stack(
        [
            torch.stack([1 + xx + yy + zz, x_part, y_part, z_part], dim=1),
            torch.stack([x_part, 1 + xx - yy - zz, xy, xz], dim=1),
            torch.stack([y_part, xy, 1 - xx + yy - zz, yz], dim=1),
            torch.stack([z_part, xz, yz, 1 - xx - yy + zz], dim=1),
        ],
        dim=1,
    )
    largest = scaled.diagonal(dim1=1, dim2=2).argmax(dim=1)
    quaternion = torch.nn.functional.normalize(scaled[torch.arange(len(m), device=m.device), largest], dim=1)
    return torch.where(quaternion[:, :1] < 0, -quaternion, quaternion).to(rotations.dtype)


def rotations_from_quaternions(quaternions: Float[Tensor, "g 4"]) -> Float[Tensor, "g 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z) of any length but 0."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(dim=1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
    ]
    return torch.stack(rows, dim=1)


def _numbered(prefix: str, count: int) -> tuple[str, ...]:
    return tuple(f"{prefix}_{index}" for index in range(count))
