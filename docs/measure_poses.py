"""How well photographs are posed, against cameras that are known.

    python docs/measure_poses.py KNOWN POSED ...

KNOWN is a scene with cameras, POSED one that ``sculpt-data pose`` made of the same photographs; any number of such
pairs. Photographs are matched by the last part of their names. The positions are laid over the known ones by the best
similarity (Umeyama 1991). Then: the share of the known photographs that have a camera; medians and worst values of the
angle between rotations, in degrees, and of the distance between positions, as a share of the mean distance of the known
cameras to what they look at; the reprojection error and the seconds that the posing reports, where it does. Where both
scenes have a ``frame.json``: how far off its size is, in per cent, and its up, in degrees.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float64

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.frame import FRAME_NAME, read_frame
from sculpt_framework.posing.outcome import NAME as OUTCOME_NAME
from sculpt_framework.posing.outcome import read_outcome
from sculpt_framework.posing.upright import centers, looked_at

Poses = dict[str, Float64[np.ndarray, "4 4"]]
"""World to camera, OpenCV axes, by the photograph's name."""


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """x -> scale * rotation @ x + shift."""

    scale: float
    rotation: Float64[np.ndarray, "3 3"]
    shift: Float64[np.ndarray, " 3"]


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    degrees: Float64[np.ndarray, " n"]
    """Angle between the rotations of each photograph."""
    shares: Float64[np.ndarray, " n"]
    """Distance between the positions over the mean distance of the known cameras to what they look at."""
    fit: Similarity
    """From the posed world to the known one."""


def main() -> None:
    words = sys.argv[1:]
    if len(words) < 2 or len(words) % 2:
        sys.exit("usage: python docs/measure_poses.py KNOWN POSED [KNOWN POSED ...]")
    titles = ("scene", "posed", "degrees", "worst", "position %", "worst", "px", "seconds", "size %", "up")
    print("{:20} {:>8} {:>8} {:>8} {:>11} {:>8} {:>6} {:>8} {:>8} {:>8}".format(*titles), flush=True)
    for known_folder, posed_folder in zip(words[::2], words[1::2], strict=True):
        known, posed = read_poses(known_folder), read_poses(posed_folder)
        errors = pose_errors(known, posed)
        degrees, shares = errors.degrees, 100 * errors.shares
        print(
            f"{Path(known_folder).resolve().name:20} {len(degrees):>3} / {len(known):<2} {np.median(degrees):8.3f} "
            f"{degrees.max():8.3f} {np.median(shares):11.3f} {shares.max():8.3f} {_reported(Path(posed_folder))} "
            f"{_frame_errors(Path(known_folder), Path(posed_folder), errors.fit)}",
            flush=True,
        )


def _reported(folder: Path) -> str:
    """Boards pose photographs without a report."""
    if not (folder / OUTCOME_NAME).is_file():
        return f"{'–':>6} {'–':>8}"
    said = read_outcome(folder)
    return f"{said.error_px:6.2f} {said.seconds:8.0f}"


def _frame_errors(known: Path, posed: Path, fit: Similarity) -> str:
    if not ((known / FRAME_NAME).is_file() and (posed / FRAME_NAME).is_file()):
        return f"{'–':>8} {'–':>8}"
    true, found = read_frame(known / FRAME_NAME), read_frame(posed / FRAME_NAME)
    size = up = "–"
    if true.metres_per_unit is not None and found.metres_per_unit is not None:
        size = f"{100 * (found.metres_per_unit / (fit.scale * true.metres_per_unit) - 1):+.3f}"
    if true.up is not None and found.up is not None:
        turned = fit.rotation @ np.array(found.up)
        up = f"{np.degrees(np.arctan2(np.linalg.norm(np.cross(turned, true.up)), turned @ np.array(true.up))):.3f}"
    return f"{size:>8} {up:>8}"


def read_poses(folder: str) -> Poses:
    """Of all views of a scene. Raises DataError."""
    usual = cast(DatasetConfig, registry.default("dataset", "auto"))
    # The cameras are all that is asked for: no masks are looked for, and small images do.
    scene = replace(usual, **{"masks": "none", "downscale": 4}).build(folder).load()
    views = (*scene.train, *scene.test)
    return {Path(view.name).name: view.camera.world_to_camera.double().numpy() for view in views}


def pose_errors(known: Poses, posed: Poses) -> PoseErrors:
    """Raises ValueError where fewer than three photographs are in both."""
    names = sorted(known.keys() & posed.keys())
    if len(names) < 3:
        raise ValueError(f"{len(names)} photographs are in both scenes; expected three or more")
    true, found = (np.array([poses[name] for name in names]) for poses in (known, posed))
    true_places, found_places = centers(true), centers(found)
    fit = similarity(found_places, true_places)
    placed = fit.scale * found_places @ fit.rotation.T + fit.shift
    # A camera's rotation takes the world's axes to its own; those of the fitted world are turned first.
    between = np.einsum("nij,jk,nlk->nil", found[:, :3, :3], fit.rotation.T, true[:, :3, :3])
    # From the antisymmetric part: the cosine alone keeps no digits of a small angle.
    sines = np.stack([between[:, 2, 1] - between[:, 1, 2], between[:, 0, 2] - between[:, 2, 0]], axis=1)
    sines = np.concatenate([sines, (between[:, 1, 0] - between[:, 0, 1])[:, None]], axis=1)
    angles = np.arctan2(np.linalg.norm(sines, axis=1), np.trace(between, axis1=1, axis2=2) - 1)
    far = np.linalg.norm(true_places - looked_at(np.array(list(known.values()))), axis=1).mean()
    return PoseErrors(degrees=np.degrees(angles), shares=np.linalg.norm(placed - true_places, axis=1) / far, fit=fit)


def similarity(source: Float64[np.ndarray, "n 3"], target: Float64[np.ndarray, "n 3"]) -> Similarity:
    """The one that brings ``source`` nearest to ``target``, by least squares (Umeyama 1991)."""
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    left, values, right = np.linalg.svd((target - goal).T @ (source - middle))
    turned = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = left @ np.diag(turned) @ right
    scale = float((values * turned).sum() / ((source - middle) ** 2).sum())
    return Similarity(scale=scale, rotation=rotation, shift=goal - scale * rotation @ middle)


if __name__ == "__main__":
    main()
