"""Metres and up in a scene's world frame: ``frame.json`` beside the data, and a copy of it in each run.

Nothing is turned or scaled by it: the world frame stays that of the cameras.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from sculpt_framework.errors import DataError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.json_text import json_text
from sculpt_framework.posed_images.reading import number, read_json
from sculpt_framework.spread import spread
from sculpt_framework.types import Scene, View

FRAME_NAME = "frame.json"
_REMEMBERED = 5
"""So many cameras are written down, by which a frame that is of other cameras is told."""
_AWAY = 1e-3
"""How far these may be away, in distances between them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WorldFrame:
    metres_per_unit: float | None
    """Length of a world unit; None where it is not known."""
    up: tuple[float, float, float] | None
    """Unit, in world axes; None where it is not known."""
    evidence: Mapping[str, Any] = field(default_factory=dict)
    """Where it is from and how sure it is, for people."""

    def in_words(self) -> str:
        metres = "unknown" if self.metres_per_unit is None else f"{self.metres_per_unit:.4g}"
        up = "unknown" if self.up is None else f"({' '.join(f'{value:.3g}' for value in self.up)})"
        return f"metres per unit: {metres}; up: {up}"


def write_frame(frame: WorldFrame, folder: Path) -> Path:
    """Raises OutputError where it cannot be written."""
    path = folder / FRAME_NAME
    document = {"metres_per_unit": frame.metres_per_unit, "up": frame.up, **frame.evidence}
    write_atomically(path, json_text(document, indent=1).encode() + b"\n")
    return path


def cameras_told(views: Sequence[View]) -> dict[str, list[float]]:
    """Positions of a few cameras, by which ``frame_of`` sees whether a frame is of the same ones."""
    return {view.name: view.camera.position.double().tolist() for view in spread(views, _REMEMBERED)}


def read_frame(path: Path) -> WorldFrame:
    """Raises DataError where the file is damaged or holds no frame."""
    document = read_json(path, "metres_per_unit and up")
    metres, up = document.get("metres_per_unit"), document.get("up")
    scale = None if metres is None else number(metres, f"{path}: metres_per_unit")
    if scale is not None and not scale > 0:
        raise DataError(f"{path}: metres_per_unit is {scale:g}; expected more than 0, or null.")
    axis = None
    if up is not None:
        values = [number(each, f"{path}: up") for each in up] if isinstance(up, list) else []
        if len(values) != 3 or not np.linalg.norm(values) > 0:
            raise DataError(f"{path}: up is {up}; expected three numbers that are not all 0, or null.")
        x, y, z = (np.array(values) / np.linalg.norm(values)).tolist()
        axis = (x, y, z)
    evidence = {key: value for key, value in document.items() if key not in ("metres_per_unit", "up")}
    return WorldFrame(metres_per_unit=scale, up=axis, evidence=evidence)


def frame_of(scene: Scene, data: str) -> WorldFrame | None:
    """What is known of a scene's world frame: what ``frame.json`` in the folder ``data`` says, else the side its
    support faces; None where neither is there.

    Raises DataError for a file that is damaged or was made for other cameras.
    """
    path = Path(data) / FRAME_NAME
    if path.is_file():
        frame = read_frame(path)
        told = frame.evidence.get("cameras")
        if isinstance(told, dict) and not _same_cameras(told, (*scene.train, *scene.test), str(path)):
            raise DataError(
                f"{path}: was made for other cameras than those of the scene now; make it again with sculpt-data "
                "scale, or remove it."
            )
        return frame
    if scene.up is None:
        return None
    return WorldFrame(metres_per_unit=None, up=scene.up, evidence={"up_from": "the plane the object stands on"})


def _same_cameras(told: Mapping[str, Any], views: Sequence[View], where: str) -> bool:
    """Whether those of them that are still there are where they were."""
    places = {view.name: view.camera.position.double().numpy() for view in views}
    names = [name for name in told if name in places]
    if not names:
        return False
    before = np.array([[number(v, f"{where}: cameras") for v in told[name]] for name in names], np.float64)
    now = np.array([places[name] for name in names])
    return bool(np.abs(before - now).max() <= _AWAY * max(_extent(now), 1e-9 * float(np.abs(now).max())))


def _extent(places: Float64[np.ndarray, "n 3"]) -> float:
    """The length that differences are measured by; of one camera, its distance from the origin."""
    return float(np.ptp(places, axis=0).max()) or float(np.linalg.norm(places[0]))
