"""Pieces of a mapping that overlap become one."""

from pathlib import Path

import numpy as np
import pytest
from mapped_box import mapped_box

from sculpt_framework.posing import colmap
from sculpt_framework.posing.joining import join

pycolmap = pytest.importorskip("pycolmap")


@pytest.mark.slow
def test_pieces_that_share_photographs_are_laid_over_each_other(tmp_path: Path):
    box = mapped_box(tmp_path)
    names, database, images, whole = box.names, box.database, box.images, box.model

    first, second, third = (colmap.without(whole, these) for these in (names[6:], names[:2], names[1:]))
    turned = pycolmap.Rotation3d(np.array([0.1, 0.2, 0.3, 0.9]) / np.linalg.norm([0.1, 0.2, 0.3, 0.9]))
    second.transform(pycolmap.Sim3d(2.0, turned, np.array([1.0, 2.0, 3.0])))
    third.delete_all_points2D_and_points3D()  # Nothing to lay it by.
    joined, apart = join([first, second, third], database, images, tmp_path / "joined")
    assert apart is third
    found, known = colmap.world_to_cameras(joined), colmap.world_to_cameras(whole)
    assert found.keys() == known.keys()
    for name, pose in known.items():
        assert found[name] == pytest.approx(pose, abs=0.05)
    assert joined.compute_mean_reprojection_error() < 1.3 * whole.compute_mean_reprojection_error()
    assert [each.num_reg_images() for each in join([first], database, images, tmp_path / "one")] == [6]
