"""``sculpt-export``: the results of a run in the format another program wants."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.errors import CheckpointError


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """Write the mesh or the Gaussians of a run."""

    run_dir: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_DIR")]
    """Run directory."""
    format: Literal["obj", "ply", "glb", "gaussians"]
    """obj, ply, glb: the mesh with vertex colours. gaussians: PLY as 3DGS has it, for splat viewers."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """File to write. Default: mesh.FORMAT or gaussians.ply in the run directory."""


def main() -> None:
    """The console script ``sculpt-export``."""
    exit_codes.run(lambda: export(sys.argv[1:]))


def export(words: Sequence[str]) -> None:
    """Write the file and say where it is. Raises SculptError; exits as tyro does for ``--help``."""
    request = tyro.cli(ExportRequest, args=words, prog="sculpt-export")
    name = "gaussians.ply" if request.format == "gaussians" else "mesh.ply"
    source = request.run_dir / name
    if not source.is_file():
        raise CheckpointError(
            f"{request.run_dir} has no {name}: not a run directory, or a run that has not finished;"
            f" sculpt-train --resume {request.run_dir} goes on with it."
        )
    out = request.out or source.with_suffix(".ply" if request.format == "gaussians" else f".{request.format}")
    _write(source, request.format, out)
    sys.stdout.write(f"{out}\n")


def _write(source: Path, kind: str, out: Path) -> None:
    from sculpt_framework.export import mesh_files
    from sculpt_framework.export.atomic import write_atomically

    if kind in ("ply", "gaussians"):
        if not (out.exists() and out.samefile(source)):
            write_atomically(out, source.read_bytes())
        return
    writer = {"obj": mesh_files.write_mesh_obj, "glb": mesh_files.write_mesh_glb}[kind]
    writer(out, *mesh_files.read_colored_mesh(source))
