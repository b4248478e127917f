"""What a run directory has for an export: the mesh, the photographs, how the scene's frame lies in the world."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sculpt_framework.engine.output import CONFIG_NAME, MESH_NAME
from sculpt_framework.engine.planning import as_trained
from sculpt_framework.engine.run import read_config
from sculpt_framework.errors import CheckpointError, DataError
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.drawn_mesh import GREY
from sculpt_framework.export.mesh_files import Colors, Faces, Vertices, read_colored_mesh
from sculpt_framework.frame import FRAME_NAME, WorldFrame, read_frame
from sculpt_framework.types import Scene


@dataclass(frozen=True, kw_only=True, eq=False)
class ColoredMesh:
    vertices: Vertices
    faces: Faces
    colors: Colors | None
    """sRGB in [0, 1]; None where the file has none."""

    @property
    def shown_colors(self) -> Colors:
        return np.full(self.vertices.shape, GREY) if self.colors is None else self.colors


def result_file(run_dir: Path, name: str) -> Path:
    """A file of a finished run. Raises CheckpointError where it is not there."""
    path = run_dir / name
    if not path.is_file():
        raise CheckpointError(
            f"{run_dir} has no {name}: not a run directory, or a run that has not finished;"
            f" sculpt-train --resume {run_dir} goes on with it."
        )
    return path


def read_mesh(run_dir: Path) -> ColoredMesh:
    """The result, in the scene's frame. Raises CheckpointError where there is none, DataError where it is no mesh."""
    path = result_file(run_dir, MESH_NAME)
    vertices, faces, colors = read_colored_mesh(path)
    if len(faces) == 0:
        raise DataError(f"{path} has no triangles; there is nothing to export.")
    try:
        Mesh(vertices=vertices, faces=faces)
    except ValueError as error:
        raise DataError(f"{path} is not a valid mesh: {error}") from error
    return ColoredMesh(vertices=vertices, faces=faces, colors=colors)


def read_scene(run_dir: Path, data: str | None) -> Scene:
    """The run's photographs and cameras, from the folder ``data`` where they have moved.

    Raises CheckpointError where the run does not say which, DataError.
    """
    config = read_config(run_dir)
    try:
        return as_trained(config.dataset.build(data or config.data).load(), config)
    except DataError as error:
        if data is not None:
            raise
        raise DataError(f"{error} The run was made from {config.data}; --data DIR says where it is now.") from None


def frame_of_run(run_dir: Path) -> WorldFrame:
    """From frame.json of the run and, for what that leaves open, of the scene's folder. Raises DataError."""
    folders = [run_dir, *_scene_folder(run_dir)]
    found = [read_frame(folder / FRAME_NAME) for folder in folders if (folder / FRAME_NAME).is_file()]
    return WorldFrame(
        metres_per_unit=next((frame.metres_per_unit for frame in found if frame.metres_per_unit is not None), None),
        up=next((frame.up for frame in found if frame.up is not None), None),
    )


def _scene_folder(run_dir: Path) -> list[Path]:
    """Where the run was made from; nothing where it does not say. A config of another version serves, too."""
    try:
        data = json.loads((run_dir / CONFIG_NAME).read_text(encoding="utf-8"))["data"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [Path(data)] if isinstance(data, str) and data else []
