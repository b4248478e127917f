"""``sculpt-bench start``: how good the surface is that training starts from, and what it costs."""

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from sculpt_framework import registry
from sculpt_framework.command_line.options import Flag
from sculpt_framework.config import DatasetConfig, InitializerConfig
from sculpt_framework.errors import ConfigError, DataError

PROGRAM = "sculpt-bench start"


@dataclass(frozen=True, kw_only=True)
class StartRequest:
    """Compare initial surfaces with the scenes' reference meshes, before any training."""

    data: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DATA")]
    """Scenes with a reference mesh: folders, demo, demo:NAME."""
    initializers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ("visual-hull", "photo-hull")
    """Components of the slot to compare."""
    cells: Annotated[int, tyro.conf.arg(metavar="N")] = 128
    """Cells along the longest side of the box that surfaces are extracted with."""
    samples: Annotated[int, tyro.conf.arg(metavar="N")] = 50_000
    """Points on either surface for the Chamfer distance."""
    json: Flag = False
    """Print JSON."""


@dataclass(frozen=True, kw_only=True)
class StartRow:
    """Distances are from point to surface in scene units, seconds those of making the surface's function."""

    scene: str
    initializer: str
    seconds: float
    cpu_seconds: float
    chamfer: float
    accuracy: float
    """Mean distance from the surface to the reference."""
    completeness: float
    """Mean distance from the reference to the surface."""
    visible_chamfer: float
    """Of the part of the reference that some train view sees."""


def bench_start(words: Sequence[str]) -> None:
    """Measure and print. Raises SculptError; exits as tyro does for ``--help`` and values of a wrong type."""
    request = tyro.cli(StartRequest, args=words, prog=PROGRAM)
    if not request.data or request.cells < 8 or request.samples < 1:
        raise ConfigError("expected one scene or more, --cells from 8 upwards and --samples from 1 upwards.")
    rows = []
    for data in request.data:
        for row in _rows(data, request):
            rows.append(row)
            if not request.json:
                sys.stdout.write(
                    f"{row.scene:24} {row.initializer:14} {row.seconds:6.1f} s  cpu {row.cpu_seconds:6.1f} s  "
                    f"chamfer {row.chamfer:.5f}  accuracy {row.accuracy:.5f}  completeness {row.completeness:.5f}  "
                    f"visible {row.visible_chamfer:.5f}\n"
                )
                sys.stdout.flush()
    if request.json:
        from sculpt_framework.export.json_text import json_text

        sys.stdout.write(json_text([asdict(row) for row in rows], indent=2) + "\n")


def _rows(data: str, request: StartRequest) -> list[StartRow]:
    import torch

    from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
    from sculpt_framework.evaluation.mesh import load_mesh
    from sculpt_framework.evaluation.visibility import seen_by, visible_distances
    from sculpt_framework.posed_images.training_images import in_object_frame
    from sculpt_framework.sculpting.initial_fit import start_mesh

    dataset = registry.default("dataset", "auto")
    assert isinstance(dataset, DatasetConfig)  # noqa: S101
    scene = dataset.build(data).load()
    if scene.reference_mesh is None:
        raise DataError(f"{data}: has no reference mesh; expected gt_mesh.ply in the folder.")
    reference = MeasuredMesh(load_mesh(Path(scene.reference_mesh)), request.samples)
    seen = seen_by(reference, [view.camera for view in scene.train])
    views = [in_object_frame(view, scene.box) for view in scene.train]
    rows = []
    for name in request.initializers:
        config = registry.default("initializer", name)
        assert isinstance(config, InitializerConfig)  # noqa: S101
        wall, cpu = time.perf_counter(), time.process_time()
        *_, function = config.build().targets(views, scene.box.half_sides, torch.device("cpu"))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        mesh = start_mesh(function, scene.box, request.cells)
        result = chamfer(mesh, reference, samples=request.samples, point_to_point=False)
        rows.append(
            StartRow(
                scene=scene.name,
                initializer=name,
                seconds=wall,
                cpu_seconds=cpu,
                chamfer=result.point_to_surface,
                accuracy=result.accuracy,
                completeness=result.completeness,
                visible_chamfer=visible_distances(mesh, reference, seen).point_to_surface,
            )
        )
    return rows
