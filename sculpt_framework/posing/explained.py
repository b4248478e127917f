"""How many of the matches between photographs their cameras explain."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from sculpt_framework.posing.colmap import FEWEST_MATCHES

if TYPE_CHECKING:
    import pycolmap

_WITHIN_PX = 2.0
"""Of the epipolar line, in the first order (Sampson): what features are apart by when their cameras are right."""


@dataclass(frozen=True, kw_only=True)
class Explained:
    """Of each photograph, by its name in the database: its verified matches with others, and those of them that the
    model's cameras explain. A match with a photograph that has no camera is not explained."""

    matches: Mapping[str, int]
    explained: Mapping[str, int]

    @property
    def total(self) -> int:
        return sum(self.explained.values()) // 2

    def below(self, share: float) -> list[str]:
        """Photographs with a camera that explains less than this share of their matches, and those without one."""
        return [name for name, count in self.matches.items() if count and self.explained[name] < share * count]


def explained(model: "pycolmap.Reconstruction", database: Path) -> Explained:
    import pycolmap

    opened = pycolmap.Database.open(database)
    names = {image.image_id: image.name for image in opened.read_all_images()}
    placed = {number: image for number, image in model.images.items() if image.has_pose}
    poses = {number: image.cam_from_world().matrix() for number, image in placed.items()}
    lenses = {number: model.cameras[image.camera_id] for number, image in placed.items()}
    rays = {number: _rays(lens, opened.read_keypoints(number)) for number, lens in lenses.items()}
    matches, held = dict.fromkeys(names.values(), 0), dict.fromkeys(names.values(), 0)
    pairs, counts = opened.read_two_view_geometry_num_inliers()
    for pair, count in zip(pairs, counts, strict=True):
        if count < FEWEST_MATCHES:
            continue
        first, second = pycolmap.pair_id_to_image_pair(pair)
        right = 0
        if first in placed and second in placed:
            these, those = np.asarray(opened.read_two_view_geometry(first, second).inlier_matches).T
            focal = 0.5 * (lenses[first].mean_focal_length() + lenses[second].mean_focal_length())
            apart = epipolar_errors(rays[first][these], rays[second][those], poses[first], poses[second])
            right = int((focal * apart < _WITHIN_PX).sum())
        for number in (first, second):
            matches[names[number]] += int(count)
            held[names[number]] += right
    opened.close()
    return Explained(matches=matches, explained=held)


def epipolar_errors(
    first: Float64[np.ndarray, "n 2"],
    second: Float64[np.ndarray, "n 2"],
    first_pose: Float64[np.ndarray, "3 4"],
    second_pose: Float64[np.ndarray, "3 4"],
) -> Float64[np.ndarray, " n"]:
    """Sampson's distance of pairs of image points at depth 1, for world-to-camera poses; not a number where cameras
    stand in one place, which says nothing about their points."""
    turn = second_pose[:, :3] @ first_pose[:, :3].T
    x, y, z = second_pose[:, 3] - turn @ first_pose[:, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    ones = np.ones((len(first), 1))
    here, there = np.hstack([first, ones]), np.hstack([second, ones])
    lines, back = here @ essential.T, there @ essential
    slope = np.square(np.hstack([lines[:, :2], back[:, :2]])).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return np.abs((there * lines).sum(axis=1)) / np.sqrt(slope)


def _rays(lens: "pycolmap.Camera", keypoints: np.ndarray) -> Float64[np.ndarray, "n 2"]:
    """Image points at depth 1, without the lens's distortion."""
    return np.asarray(lens.cam_from_img(np.asarray(keypoints, np.float64)[:, :2]), np.float64).reshape(-1, 2)
