"""Gaussians in the 3DGS layout: properties by name as other readers see them, and the way back."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from sculpt_framework.errors import DataError
from sculpt_framework.export.gaussian_files import (
    quaternions_from_rotations,
    read_gaussians_ply,
    rotations_from_quaternions,
    write_gaussians_ply,
)
from sculpt_framework.types import Gaussians


def random_rotations(count: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return rotations_from_quaternions(torch.randn(count, 4, generator=generator, dtype=torch.float64)).float()


def random_gaussians(count: int = 50, bands: int = 9) -> Gaussians:
    generator = torch.Generator().manual_seed(1)
    return Gaussians(
        means=torch.randn(count, 3, generator=generator),
        scales=torch.rand(count, 3, generator=generator) * 0.1 + 1e-4,
        rotations=random_rotations(count),
        opacities=torch.rand(count, generator=generator) * 0.98 + 0.01,
        sh=torch.randn(count, bands, 3, generator=generator),
        face=torch.arange(count) // 3,
    )


def covariances(gaussians: Gaussians) -> torch.Tensor:
    scaled = gaussians.rotations * gaussians.scales[:, None, :]
    return scaled @ scaled.transpose(1, 2)


@pytest.mark.parametrize("bands", [1, 4, 16])
def test_round_trip(bands: int, tmp_path: Path):
    gaussians = random_gaussians(bands=bands)
    write_gaussians_ply(tmp_path / "gaussians.ply", gaussians)
    read = read_gaussians_ply(tmp_path / "gaussians.ply")
    torch.testing.assert_close(read.means, gaussians.means)
    torch.testing.assert_close(read.scales, gaussians.scales)
    torch.testing.assert_close(read.rotations, gaussians.rotations, atol=1e-5, rtol=0)
    torch.testing.assert_close(read.opacities, gaussians.opacities, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(read.sh, gaussians.sh)
    torch.testing.assert_close(read.face, gaussians.face)


def test_layout_as_another_reader_sees_it(tmp_path: Path):
    gaussians = random_gaussians(bands=4)
    write_gaussians_ply(tmp_path / "gaussians.ply", gaussians)
    raw = trimesh.load(tmp_path / "gaussians.ply", process=False).metadata["_ply_raw"]["vertex"]
    rows = raw["data"]
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(9))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "face"]
    assert list(raw["properties"]) == names
    np.testing.assert_allclose(rows["f_rest_1"].ravel(), gaussians.sh[:, 2, 0])
    np.testing.assert_allclose(rows["f_rest_3"].ravel(), gaussians.sh[:, 1, 1])
    np.testing.assert_allclose(rows["opacity"].ravel(), gaussians.opacities.logit(), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(np.exp(rows["scale_2"].ravel()), gaussians.scales[:, 2], rtol=1e-5)
    np.testing.assert_allclose(rows["ny"].ravel(), gaussians.rotations[:, 1, 0])
    np.testing.assert_array_equal(rows["face"].ravel(), gaussians.face)


def test_extreme_values_stay_finite(tmp_path: Path):
    extreme = Gaussians(
        means=torch.zeros(2, 3),
        scales=torch.zeros(2, 3),
        rotations=torch.eye(3).expand(2, 3, 3),
        opacities=torch.tensor([0.0, 1.0]),
        sh=torch.zeros(2, 1, 3),
        face=torch.zeros(2, dtype=torch.int64),
    )
    write_gaussians_ply(tmp_path / "gaussians.ply", extreme)
    rows = trimesh.load(tmp_path / "gaussians.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    for name in ("opacity", "scale_0", "rot_0"):
        assert np.isfinite(rows[name]).all()
    torch.testing.assert_close(
        read_gaussians_ply(tmp_path / "gaussians.ply").opacities, extreme.opacities, atol=1e-5, rtol=0
    )


def test_a_mirrored_frame_keeps_its_ellipsoid(tmp_path: Path):
    gaussians = random_gaussians()
    gaussians.rotations[:, :, 1] *= -1
    write_gaussians_ply(tmp_path / "gaussians.ply", gaussians)
    read = read_gaussians_ply(tmp_path / "gaussians.ply")
    torch.testing.assert_close(covariances(read), covariances(gaussians), atol=1e-7, rtol=1e-4)
    torch.testing.assert_close(read.rotations[:, :, 0], gaussians.rotations[:, :, 0], atol=1e-5, rtol=0)


def test_skew_axes_are_refused(tmp_path: Path):
    gaussians = random_gaussians()
    gaussians.rotations[:, :, 2] = gaussians.rotations[:, :, 1]
    with pytest.raises(ValueError, match="principal_axes"):
        write_gaussians_ply(tmp_path / "gaussians.ply", gaussians)


def test_quaternions_of_half_turns_and_of_everything_else():
    half_turns = torch.stack([torch.diag(torch.tensor(d)) for d in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])])
    torch.testing.assert_close(quaternions_from_rotations(half_turns), torch.eye(4)[1:])
    rotations = random_rotations(500)
    torch.testing.assert_close(
        rotations_from_quaternions(quaternions_from_rotations(rotations)), rotations, atol=2e-6, rtol=0
    )


def test_what_is_not_gaussians_is_refused(tmp_path: Path):
    path = tmp_path / "gaussians.ply"
    with pytest.raises(DataError, match="cannot read"):
        read_gaussians_ply(path)
    trimesh.creation.box().export(path)
    with pytest.raises(DataError, match="no property"):
        read_gaussians_ply(path)
    write_gaussians_ply(path, random_gaussians())
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(DataError, match="is cut"):
        read_gaussians_ply(path)
    path.write_bytes(b"not a ply")
    with pytest.raises(DataError, match="not a binary"):
        read_gaussians_ply(path)


def test_files_of_other_programs_without_faces(tmp_path: Path):
    gaussians = random_gaussians(3, bands=1)
    write_gaussians_ply(tmp_path / "ours.ply", gaussians)
    content = (tmp_path / "ours.ply").read_bytes()
    header, _, body = content.partition(b"end_header\n")
    row = len(body) // 3
    stripped = b"".join(body[i * row : (i + 1) * row - 4] for i in range(3))
    (tmp_path / "theirs.ply").write_bytes(header.replace(b"property int face\n", b"") + b"end_header\n" + stripped)
    read = read_gaussians_ply(tmp_path / "theirs.ply")
    torch.testing.assert_close(read.means, gaussians.means)
    assert (read.face == -1).all()
