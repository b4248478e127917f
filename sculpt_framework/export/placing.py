"""From a run's mesh to the mesh in a file: simplified, cut flat, turned upright, scaled, moved."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.export.decimation import LEAST_FACES, carry_over, decimate
from sculpt_framework.export.flat_base import cut_below
from sculpt_framework.export.mesh_files import Colors, Faces, Vertices
from sculpt_framework.export.options import METRES, MeshExporterConfig, Unit, parse_length, parse_up
from sculpt_framework.export.run_results import ColoredMesh, frame_of_run, read_mesh
from sculpt_framework.frame import WorldFrame
from sculpt_framework.geometry.coincident import separate

_BASE_METRES = 0.0005
_BASE_SHARE = 0.005
"""How deep ``--flat-base`` cuts: where a real size is known, and of the height where not."""
_TRIES = 8


@dataclass(frozen=True, kw_only=True)
class FileFrame:
    """What the readers of a format expect."""

    up: Literal["y", "z"]
    unit: Unit | None = None
    """Of the file's numbers, where a real size is known; None: the scene's own numbers."""
    turned: bool = True
    """Turned so that ``up`` is up; if not, only where an option speaks of up."""
    needs_size: bool = False
    """Its readers make something as large as the numbers say."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Base:
    """Where a mesh is cut flat; scene's frame."""

    up: Float64[np.ndarray, " 3"]
    depth: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedMesh:
    """A mesh as it goes into a file."""

    world: ColoredMesh
    """The same in the scene's frame, where its photographs are."""
    vertices: Vertices
    """In the file's frame; no two at the same place."""
    unit: Unit | None
    """Of the file's numbers; None where no real size is known."""
    notes: Sequence[str]

    @property
    def faces(self) -> Faces:
        return self.world.faces

    @property
    def colors(self) -> Colors | None:
        return self.world.colors

    def facts(self) -> list[str]:
        """Lines for the user: what is in the file, and what to know of it."""
        found = certify(self.vertices, self.faces)
        sides = " x ".join(f"{side:.4g}" for side in np.ptp(self.vertices[self.faces].reshape(-1, 3), axis=0))
        if found.watertight_merged and found.outward:
            closed = "watertight"
        elif found.watertight_merged:
            closed = "closed, but not turned outwards"
        elif found.watertight:
            closed = f"{found.coincident_vertices} vertices coincide in 32-bit floats; try --origin bottom-center"
        else:
            closed = f"not watertight: {found.boundary_edges} edges with one face"
        if found.components > 1:
            closed = f"{closed}, {found.components} pieces"
        unit = "scene units" if self.unit is None else self.unit
        return [f"{found.faces} faces, {sides} {unit}, {closed}", *self.notes]


def place(run_dir: Path, config: MeshExporterConfig, frame: FileFrame, unit: Unit | None = None) -> PlacedMesh:
    """The mesh of a run as a file of the given kind has it; ``unit`` is what the user asks for.

    Raises CheckpointError where the run has no mesh, ConfigError where no real size is known for a unit, DataError
    where the mesh cannot be simplified or cut and stay closed.
    """
    given, mesh = frame_of_run(run_dir), read_mesh(run_dir)
    up, file_up = up_vector(config.up, given), np.eye(3)["xyz".index(frame.up)]
    turned = frame.turned or config.needs_up
    notes = []
    if up is None:
        up = np.array([0.0, 0.0, 1.0])
        if turned:
            notes.append("z of the scene is taken for up; --up says otherwise (COLMAP often: -Y)")
    turn = rotation_between(up, file_up) if turned else np.eye(3)
    scale = _scale(mesh.vertices @ turn.T, config, given, unit, frame.unit)
    base = None
    if config.flat_base:
        height = float(np.ptp(mesh.vertices @ up))
        base = Base(up=up, depth=_BASE_SHARE * height if scale.metres is None else _BASE_METRES / scale.metres)
    mesh = simplify(mesh, config.target_faces, base)
    vertices = mesh.vertices @ turn.T
    # What was cut and simplified may have another longest side.
    scale = _scale(vertices, config, given, unit, frame.unit)
    vertices = vertices * scale.factor
    if config.origin == "bottom-center":
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        vertices = vertices - np.where(file_up > 0, low, 0.5 * (low + high))
    if scale.metres is None and frame.needs_size:
        notes.append("no real size is known, so the numbers are the scene's own; --size 80mm gives it one")
    return PlacedMesh(
        world=mesh,
        vertices=separate(np.ascontiguousarray(vertices), mesh.faces),
        unit=None if scale.metres is None else scale.unit,
        notes=notes,
    )


def up_vector(up: str | None, frame: WorldFrame) -> Float64[np.ndarray, " 3"] | None:
    """Unit vector of what is up in the scene, by the option or the scene's frame; None where neither says."""
    chosen = parse_up(up) if up is not None else frame.up
    if chosen is None:
        return None
    direction = np.array(chosen, np.float64)
    return direction / np.linalg.norm(direction)


def rotation_between(start: Float64[np.ndarray, " 3"], end: Float64[np.ndarray, " 3"]) -> Float64[np.ndarray, "3 3"]:
    """The smallest rotation that takes one unit vector to another; exact for axes. Opposite ones: half a turn about the
    first axis that is square to them, x where it can be."""
    cosine = float(start @ end)
    if cosine < -1 + 1e-12:
        about = np.eye(3)[int(np.abs(start).argmin())]
        about = about - start * (about @ start)
        about /= np.linalg.norm(about)
        return 2 * np.outer(about, about) - np.eye(3)
    a, b, c = np.cross(start, end)
    skew = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)


@dataclass(frozen=True, kw_only=True)
class _Scale:
    factor: float
    """From scene units to the file's numbers."""
    unit: Unit | None
    metres: float | None
    """Metres per scene unit as the file has it; None where no real size is known."""


def _scale(
    turned: Vertices, config: MeshExporterConfig, frame: WorldFrame, asked: Unit | None, default: Unit | None
) -> _Scale:
    unit = asked or default
    if config.size is not None:
        length = parse_length(config.size)
        unit = unit or length.unit
        value = length.value
        if length.unit is not None and unit is not None:
            value *= METRES[length.unit] / METRES[unit]
        factor = value / float(np.ptp(turned, axis=0).max())
        return _Scale(factor=factor, unit=unit, metres=None if unit is None else factor * METRES[unit])
    metres = frame.metres_per_unit
    if metres is None:
        if asked is not None:
            raise ConfigError(f"--unit {asked}: no real size of this scene is known; give one, as in --size 80mm.")
        return _Scale(factor=1.0, unit=None, metres=None)
    if unit is None:
        return _Scale(factor=1.0, unit="m" if metres == 1 else None, metres=metres)
    return _Scale(factor=metres / METRES[unit], unit=unit, metres=metres)


def simplify(mesh: ColoredMesh, target: int | None, base: Base | None = None) -> ColoredMesh:
    """At most ``target`` faces, those of a flat base included; closed as before. Raises ConfigError, DataError."""
    aim, vertices, faces = target, mesh.vertices, mesh.faces
    for _ in range(_TRIES):
        vertices, faces = mesh.vertices, mesh.faces
        if aim is not None:
            vertices, faces = decimate(vertices, faces, aim)
        if base is not None:
            vertices, faces = cut_below(vertices, faces, base.up, base.depth)
        if target is None or aim is None or len(faces) <= target:
            break
        aim = max(LEAST_FACES, aim - (len(faces) - target))
    else:
        raise DataError(f"with a flat base the mesh keeps {len(faces)} faces; give a larger --target-faces.")
    if vertices is mesh.vertices:
        return mesh
    colors = None if mesh.colors is None else carry_over(mesh.colors, mesh.vertices, mesh.faces, vertices)
    return replace(mesh, vertices=vertices, faces=faces, colors=colors)
