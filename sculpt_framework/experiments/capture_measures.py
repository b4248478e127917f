"""The meshes that runs leave of captures, and those other programs made, all measured by the same photographs."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, cast

import numpy as np

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.errors import ConfigError, DataError, SculptError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.consistency import CURVE_PAIRS, CURVE_PIXELS, EVALUATION_PIXELS, PosedImages
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.evaluation.visibility import Observed, seen_by, visible_distances
from sculpt_framework.experiments.matrix import Cell, Matrix
from sculpt_framework.experiments.runner import ended_as, run_folder
from sculpt_framework.experiments.suites import Suite
from sculpt_framework.export.atomic import make_folder, write_atomically
from sculpt_framework.export.json_text import json_text
from sculpt_framework.types import Scene

FOLDER = "measures"
_SCHEMA = 4
"""Of the figures that are kept; those of another are measured anew."""
_SAMPLES = 200_000
_SEEING = 3
"""Cameras from which on a place is well seen: its depth can be measured, and checked."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A mesh that is to be measured, and where its figures are kept."""

    data: str
    """Folder of the capture."""
    mesh: Path
    kept: Path


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Figures of a mesh by name, in scene units where they are lengths; None where not known. Or why there are none."""

    values: Mapping[str, Any]
    error: str | None = None


class Capture:
    """A capture made ready once: all pairs of its photographs with the masks it has, and the true surface if known."""

    def __init__(self, data: str):
        """Raises DataError where the photographs, or the true mesh beside them, cannot be read."""
        scene: Scene = cast(DatasetConfig, registry.default("dataset", "auto")).build(data).load()
        center = scene.box.center.double().numpy()
        self._images = PosedImages(scene.train, center, pixels_at_most=EVALUATION_PIXELS)
        self._curve = PosedImages(scene.train, center, pairs_at_most=CURVE_PAIRS, pixels_at_most=CURVE_PIXELS)
        self._truth, self.radius = None, scene.box.scale
        if scene.reference_mesh is not None:
            truth = load_mesh(scene.reference_mesh)
            if not truth.areas.sum() > 0:
                raise DataError(f"{scene.reference_mesh} cannot be compared with: all its faces have area 0.")
            self._truth = MeasuredMesh(truth, _SAMPLES)
            cameras = [view.camera for view in scene.train]
            self._asked = {
                least: (seen_by(self._truth, cameras, least), Observed(cameras=cameras, box=scene.box, least=least))
                for least in (1, _SEEING)
            }
            self.radius = radius_of(truth)

    def measure(self, mesh: Mesh) -> Mapping[str, Any]:
        """``mesh`` is in world frame. Raises DataError for one without area."""
        if not mesh.areas.sum() > 0:
            raise DataError("the mesh has no area.")
        out = {"radius": self.radius, **self._images.measure(mesh).values()}
        out["curve_residual_px"] = self._curve.measure(mesh).residual_px
        certificate = certify(mesh.vertices, mesh.faces)
        out |= {"faces": len(mesh.faces), "watertight": certificate.watertight}
        if self._truth is not None:
            names = {
                "point_to_surface": "distance", "median": "distance_median", "normal_error": "normal_error",
                "accuracy": "accuracy", "completeness": "completeness", "seen_share": "seen_share",
            }  # fmt: skip
            for least, (seen, observed) in self._asked.items():
                distances = asdict(visible_distances(mesh, self._truth, seen, observed=observed))
                after = "" if least == 1 else "_well_seen"
                for key, name in names.items():
                    # Infinitely far is a mesh that has nothing where the truth is seen.
                    out[name + after] = distances[key] if np.isfinite(distances[key]) else None
            out["chamfer_ps"] = chamfer(mesh, self._truth, samples=_SAMPLES, point_to_point=False).point_to_surface
        return out


def radius_of(truth: Mesh) -> float:
    """Half of the longest side of a surface's bounding box, scene units."""
    return 0.5 * float(np.ptp(truth.corners.reshape(-1, 3), axis=0).max())


def check_external(words: Sequence[str], suite: Suite) -> None:
    """Raise ConfigError where a word is no file's name, or no capture has a file of that name."""
    for word in words:
        if Path(word).name != word:
            raise ConfigError(f"--against {word}: expected a file's name in the captures' folders, as openmvs.ply.")
        if not any((Path(scene.data) / word).is_file() for scene in suite.scenes):
            raise ConfigError(f"--against {word}: no capture has a file of that name in its folder.")


def measure_all(
    matrix: Matrix, suite: Suite, against: Sequence[str], folder: Path, told: Callable[[str], None]
) -> None:
    """Measure what has not been measured yet, and keep the figures in ``folder``/measures.

    A capture or a mesh that cannot be read is told of, and is tried again the next time.
    """
    waiting = [task for task in _tasks(matrix, suite, against, folder) if _kept(task).error is not None]
    for data, group in groupby(waiting, lambda task: task.data):
        tasks = list(group)
        told(f"measuring {len(tasks)} meshes of {Path(data).name}")
        try:
            capture = Capture(data)
        except SculptError as error:
            for task in tasks:
                _keep(task, Measured(values={}, error=str(error)))
            continue
        for task in tasks:
            _keep(task, _measured(capture, task))


def measured_run(plan_folder: Path, cell: Cell, data: str) -> Measured:
    """The figures that are kept of a run's mesh."""
    return _kept(_task_of(plan_folder, cell, data))


def measured_external(plan_folder: Path, data: str, name: str) -> Measured | None:
    """The same of another program's mesh; None where the capture has none of that name."""
    task = _external(plan_folder, data, name)
    return _kept(task) if task.mesh.is_file() else None


def _tasks(matrix: Matrix, suite: Suite, against: Sequence[str], folder: Path) -> Iterator[Task]:
    """Capture by capture, so that each is made ready once."""
    data_of = {scene.label: scene.data for scene in suite.scenes}
    for data in dict.fromkeys(data_of.values()):
        for cell in matrix.cells:
            if data_of[cell.scene] == data and ended_as(run_folder(folder, cell)) == "finished":
                yield _task_of(folder, cell, data)
        for name in against:
            if (task := _external(folder, data, name)).mesh.is_file():
                yield task


def _task_of(folder: Path, cell: Cell, data: str) -> Task:
    return Task(data=data, mesh=run_folder(folder, cell) / "mesh.ply", kept=folder / FOLDER / f"{cell.name}.json")


def _external(folder: Path, data: str, name: str) -> Task:
    # With the ending: two of them may differ in it alone. Runs lie one folder deeper.
    return Task(data=data, mesh=Path(data) / name, kept=folder / FOLDER / Path(data).name / f"{name}.json")


def _measured(capture: Capture, task: Task) -> Measured:
    try:
        return Measured(values=capture.measure(load_mesh(task.mesh)))
    except SculptError as error:
        return Measured(values={}, error=str(error))


def _keep(task: Task, measured: Measured) -> None:
    document = {"schema": _SCHEMA, "mesh": _digest(task.mesh), **asdict(measured)}
    make_folder(task.kept.parent)
    write_atomically(task.kept, (json_text(document, indent=1) + "\n").encode())


def _kept(task: Task) -> Measured:
    """What is kept of the mesh as it is now."""
    try:
        document = json.loads(task.kept.read_text(encoding="utf-8"))
        if document["schema"] == _SCHEMA and document["mesh"] == _digest(task.mesh):
            return Measured(values=document["values"], error=document["error"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return Measured(values={}, error="not measured yet")


def _digest(path: Path) -> str | None:
    """None where there is no such file."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
