"""Snapshots as files, written by the run and read by whoever shows it.

RUN_DIR/evolution/live.npz        the newest state with its Gaussians, replaced as the run goes on
RUN_DIR/evolution/step-N.npz      the surface alone after N outer steps, at times further and further apart
"""

import io
import re
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor

from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.geometry.band import levels_of
from sculpt_framework.geometry.grid import Grid, unpack_ijk
from sculpt_framework.rendering.spherical_harmonics import BAND_0
from sculpt_framework.sculpting.reconstruction import in_world
from sculpt_framework.snapshot import Cells as SurfaceCells
from sculpt_framework.snapshot import Snapshot
from sculpt_framework.types import Box, Gaussians, Surface

FOLDER = "evolution"
LIVE = "live.npz"
FORMAT = 1
_STEP = re.compile(r"step-(\d+)\.npz")


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """Grid cells in world frame."""

    minimum: Float[np.ndarray, "c 3"]
    side: Float[np.ndarray, " c"]
    level: Int64[np.ndarray, " c"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A state of a run as it is shown; world frame."""

    outer: int
    t_train: float
    """Seconds of training until then."""
    vertices: Float[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    colors: Float[np.ndarray, "v 3"]
    """sRGB in [0, 1]."""
    face_keys: Int64[np.ndarray, " f"] | None = None
    gaussians: Gaussians | None = None
    cells: Cells | None = None


def step_path(run_dir: Path, outer: int) -> Path:
    return run_dir / FOLDER / f"step-{outer:06d}.npz"


def step_files(run_dir: Path) -> list[tuple[int, Path]]:
    """The recorded steps of a run and their files, in order."""
    found = [(match, path) for path in (run_dir / FOLDER).glob("step-*.npz") if (match := _STEP.fullmatch(path.name))]
    return sorted((int(match[1]), path) for match, path in found)


def write_frame(path: Path, snapshot: Snapshot, *, outer: int, t_train: float, whole: bool) -> None:
    """Keep a snapshot; ``whole`` with its Gaussians, else with one colour per face. Raises OutputError."""
    surface, gaussians, box = snapshot.surface, snapshot.gaussians, snapshot.box
    arrays: dict[str, np.ndarray] = {
        "header": np.array([FORMAT, outer, t_train], dtype=np.float64),
        "box": torch.stack([box.minimum, box.maximum]).double().cpu().numpy(),
        "vertices": _plain(surface.vertices, np.float32),
        "faces": _plain(surface.faces, np.int32),
        "face_keys": _plain(surface.face_keys, np.int64),
    }
    if gaussians is None:
        arrays["vertex_rgb"] = _bytes(_plain(snapshot.vertex_colors, np.float32))
    elif whole:
        arrays |= {
            "face": _plain(gaussians.face, np.int32),
            "means": _plain(gaussians.means, np.float32),
            "scales": _plain(gaussians.scales, np.float32),
            "rotations": _plain(gaussians.rotations, np.float32),
            "opacities": _plain(gaussians.opacities, np.float32),
            "sh": _plain(gaussians.sh, np.float16),
        }
    else:
        arrays["face"] = _plain(gaussians.face, np.int32)
        arrays["rgb"] = _bytes(_plain(0.5 + BAND_0 * gaussians.sh[:, 0], np.float32))
    if whole and snapshot.cells is not None:
        grid = snapshot.cells.grid
        arrays["cells"] = _plain(snapshot.cells.keys, np.int64)
        arrays["grid"] = np.array([*grid.origin, *grid.base_shape, grid.base_cell, grid.level], dtype=np.float64)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # pyright: ignore[reportArgumentType] (the stub takes "allow_pickle" for one of them)
    write_atomically(path, buffer.getvalue())


def read_frame(path: Path) -> Frame:
    """Inverse of ``write_frame``. Raises CheckpointError if the file is not whole or of another version."""
    try:
        # np.load leaves a file open that it cannot read.
        with np.load(io.BytesIO(path.read_bytes())) as file:
            arrays = {name: file[name] for name in file.files}
        version, outer, t_train = arrays["header"].tolist()
        if version != FORMAT:
            raise CheckpointError(f"{path} has format {version:g}, this version reads {FORMAT}.")
        return _frame(arrays, int(outer), t_train)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, EOFError) as error:
        raise CheckpointError(f"{path} is damaged and cannot be read ({error}).") from error


def frame_of(snapshot: Snapshot, *, outer: int, t_train: float) -> Frame:
    """A frame straight from a snapshot."""
    cells = None if snapshot.cells is None else _cells_in_world(snapshot.cells, snapshot.box)
    if snapshot.gaussians is None:
        vertices = snapshot.box.to_world(snapshot.surface.vertices.double()).cpu().numpy()
        return Frame(
            outer=outer,
            t_train=t_train,
            vertices=vertices.astype(np.float32),
            faces=snapshot.surface.faces.cpu().numpy(),
            colors=_plain(snapshot.vertex_colors, np.float32),
            face_keys=snapshot.surface.face_keys.cpu().numpy(),
            cells=cells,
        )
    plain, gaussians = _plain_frame(snapshot.surface, snapshot.gaussians, snapshot.box, outer, t_train)
    return replace(plain, gaussians=gaussians, cells=cells)


def _plain_frame(
    surface: Surface, gaussians: Gaussians, box: Box, outer: int, t_train: float
) -> tuple[Frame, Gaussians]:
    """The surface as it is shown, coloured by its Gaussians, and the Gaussians in world frame."""
    result = in_world(surface, gaussians, box)
    # Where stray pieces of the surface were left out, rows no longer agree with its keys.
    whole = len(result.faces) == len(surface.faces)
    frame = Frame(
        outer=outer,
        t_train=t_train,
        vertices=result.vertices.astype(np.float32),
        faces=result.faces,
        colors=result.colors,
        face_keys=surface.face_keys.cpu().numpy() if whole else None,
    )
    return frame, result.gaussians


def _frame(arrays: dict[str, np.ndarray], outer: int, t_train: float) -> Frame:
    def tensor(name: str, dtype: torch.dtype) -> Tensor:
        return torch.from_numpy(arrays[name]).to(dtype)

    low, high = torch.from_numpy(arrays["box"]).float()
    box = Box(minimum=low, maximum=high)
    surface = Surface(
        vertices=tensor("vertices", torch.float32),
        faces=tensor("faces", torch.int64),
        face_keys=tensor("face_keys", torch.int64),
    )
    cells = None
    if "cells" in arrays:
        grid = arrays["grid"]
        x, y, z = grid[3:6].astype(int).tolist()
        origin = (grid[0], grid[1], grid[2])
        cells = SurfaceCells(
            grid=Grid(origin=origin, base_shape=(x, y, z), base_cell=float(grid[6]), level=int(grid[7])),
            keys=tensor("cells", torch.int64),
        )
    if "vertex_rgb" in arrays:
        colors = tensor("vertex_rgb", torch.float32) / 255
        snapshot = Snapshot(surface=surface, box=box, colors=colors, cells=cells)
        return frame_of(snapshot, outer=outer, t_train=t_train)
    face = tensor("face", torch.int64)
    if "rgb" in arrays:
        flat: Any = (tensor("rgb", torch.float32) / 255 - 0.5) / BAND_0
        count = len(flat)
        gaussians = Gaussians(
            means=torch.zeros(count, 3),
            scales=torch.zeros(count, 3),
            rotations=torch.eye(3).expand(count, 3, 3).contiguous(),
            opacities=torch.zeros(count),
            sh=flat[:, None],
            face=face,
        )
        return _plain_frame(surface, gaussians, box, outer, t_train)[0]
    snapshot = Snapshot(
        surface=surface,
        gaussians=Gaussians(
            means=tensor("means", torch.float32),
            scales=tensor("scales", torch.float32),
            rotations=tensor("rotations", torch.float32),
            opacities=tensor("opacities", torch.float32),
            sh=tensor("sh", torch.float32),
            face=face,
        ),
        box=box,
        cells=cells,
    )
    return frame_of(snapshot, outer=outer, t_train=t_train)


def _cells_in_world(cells: SurfaceCells, box: Box) -> Cells:
    keys, grid = cells.keys.cpu(), cells.grid
    level = levels_of(keys)
    side = grid.base_cell / (2.0 ** level.double())
    low = torch.tensor(grid.origin, dtype=torch.float64) + unpack_ijk(keys).double() * side[:, None]
    return Cells(
        minimum=box.to_world(low).numpy().astype(np.float32),
        side=(side * box.scale).numpy().astype(np.float32),
        level=level.numpy(),
    )


def _bytes(colors: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 3"]:
    return (255 * colors.clip(0, 1)).astype(np.uint8)


def _plain(tensor: Tensor, dtype: Any) -> np.ndarray:
    return tensor.detach().cpu().numpy().astype(dtype)
