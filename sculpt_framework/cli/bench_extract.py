"""``sculpt-bench extract``: what an outer step costs without its renderings, by the resolution of the surface."""

import math
import multiprocessing
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError
from sculpt_framework.memory import peak_bytes

if TYPE_CHECKING:
    import torch

    from sculpt_framework.extractors import Extractor

PROGRAM = "sculpt-bench extract"
Way = Literal["flexicubes", "flexicubes-half", "flexicubes-octree", "marching-tetrahedra"]

BASE_CELLS = 32
"""Cells along the longest side at level 0."""


@dataclass(frozen=True, kw_only=True)
class ExtractRequest:
    """Time and memory of extraction and field on the cells of the surface, forwards, backwards and updated.

    The object is the sphere that the hash-grid field starts as, half as wide as the box. Each case runs in a process of
    its own. The last lines tell the power of the resolution that the cost grows with, fitted to all cases.
    """

    ways: Annotated[tuple[Way, ...], tyro.conf.arg(metavar="WAY")] = (
        "flexicubes",
        "flexicubes-half",
        "flexicubes-octree",
        "marching-tetrahedra",
    )
    """flexicubes, marching-tetrahedra: all cells alike. flexicubes-half: cells twice as large in one half of the box.
    flexicubes-octree: 32 cells, refined by a box that holds everything."""
    resolutions: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N")] = (64, 128, 256, 512)
    """Cells along the longest side of the box, where they are finest: 32 times a power of 2."""
    repeats: Annotated[int, tyro.conf.arg(metavar="N")] = 5
    """Timed steps per case, after one that is not."""
    threads: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """CPU threads."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the tensors live. Memory is then that of the device."""
    json: Flag = False
    """Print JSON."""


@dataclass(frozen=True, kw_only=True)
class ExtractRow:
    """One case. Milliseconds are medians, megabytes are 2^20 bytes."""

    way: str
    resolution: int
    cells: int
    faces: int
    extract_ms: float
    """Wall time of field and extraction."""
    step_ms: float
    """Wall time of the whole step: these, the gradient, and the update."""
    cpu_ms: float
    """CPU time of the whole step, of all threads."""
    step_mb: float
    """Most memory in use during the steps less what was in use before."""
    peak_mb: float
    """Most memory the process used, libraries included; on cuda, of the device."""


def bench_extract(words: Sequence[str]) -> None:
    """Measure and print. Raises ConfigError; exits as tyro does for ``--help`` and values of a wrong type."""
    request = tyro.cli(ExtractRequest, args=words, prog=PROGRAM)
    _check(request)
    rows = []
    # A process that has not loaded torch starts each case anew, so that no case finds another's memory.
    context = multiprocessing.get_context("spawn")
    for way in request.ways:
        for resolution in request.resolutions:
            with context.Pool(1) as pool:
                row = pool.apply(_measure, (way, resolution, request))
            rows.append(row)
            if not request.json:
                sys.stdout.write(_line(row) + "\n")
                sys.stdout.flush()
    fits = [_fitted(way, [row for row in rows if row.way == way]) for way in request.ways]
    if request.json:
        from sculpt_framework.export.json_text import json_text

        sys.stdout.write(json_text({"rows": [vars(row) for row in rows], "exponents": fits}, indent=2) + "\n")
    else:
        for fit in fits:
            powers = ", ".join(f"{name} {fit[name]}" for name in ("step_ms", "cpu_ms", "step_mb"))
            sys.stdout.write(f"{fit['way']:20} grows with the resolution to the power of: {powers}\n")


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float | None:
    """Slope of the straight line nearest to the costs on logarithmic axes; None for fewer than two sizes."""
    if len(set(sizes)) < 2:
        return None
    x, y = [math.log(size) for size in sizes], [math.log(max(cost, 1e-9)) for cost in costs]
    return statistics.linear_regression(x, y).slope


def _check(request: ExtractRequest) -> None:
    if request.repeats < 1 or request.threads < 1:
        raise ConfigError("--repeats and --threads take numbers from 1 upwards.")
    for resolution in request.resolutions:
        steps = math.log2(resolution / BASE_CELLS) if resolution > 0 else -1.0
        if not steps.is_integer() or not 1 <= steps <= 8:
            raise ConfigError(f"--resolutions {resolution}: expected 32 times a power of 2, from 64 to 8192.")
    if request.device == "cuda":
        import torch

        if not torch.cuda.is_available():
            raise ConfigError("--device cuda: torch finds no CUDA device here. Use --device cpu.")


def _line(row: ExtractRow) -> str:
    return (
        f"{row.way:20} {row.resolution:5}  {row.cells:8} cells {row.faces:8} faces  extract {row.extract_ms:8.1f} ms  "
        f"step {row.step_ms:8.1f} ms  cpu {row.cpu_ms:8.1f} ms  {row.step_mb:7.0f} MB of {row.peak_mb:.0f}"
    )


def _fitted(way: str, rows: Sequence[ExtractRow]) -> dict[str, str | float | None]:
    sizes = [float(row.resolution) for row in rows]
    measured = {
        "extract_ms": [row.extract_ms for row in rows],
        "step_ms": [row.step_ms for row in rows],
        "cpu_ms": [row.cpu_ms for row in rows],
        "step_mb": [row.step_mb for row in rows],
    }
    powers = {name: exponent(sizes, values) for name, values in measured.items()}
    return {"way": way} | {name: None if power is None else round(power, 2) for name, power in powers.items()}


def _measure(way: Way, resolution: int, request: ExtractRequest) -> ExtractRow:
    """One case; runs in a process of its own."""
    import torch

    from sculpt_framework import registry
    from sculpt_framework.adam import Adam
    from sculpt_framework.config import FieldConfig
    from sculpt_framework.geometry.band import discover
    from sculpt_framework.parameters import ParameterGroup

    torch.set_num_threads(request.threads)
    device = torch.device(request.device)
    config = registry.default("field", "hash-grid")
    assert isinstance(config, FieldConfig)  # noqa: S101 - what the registry promises for the slot
    torch.manual_seed(0)
    field = config.build(resolution, device)
    extractor = _extractor(way, resolution, device)
    field.set_detail(2.0 / resolution)
    # Rates so small that the surface stays where it is.
    parameters = [parameter for group in field.parameter_groups() for parameter in group.parameters]
    optimizer = Adam([ParameterGroup(parameters=parameters, rate=1e-9)])

    def sdf(points: torch.Tensor) -> torch.Tensor:
        return field(points)

    before = _resident_megabytes(device)
    seeds = discover(sdf, extractor.grid, 0, lipschitz=1.5, device=device)
    times: list[tuple[float, float, float]] = []
    for _ in range(request.repeats + 1):
        optimizer.zero_grad()
        for table in extractor.tables.values():
            table.zero_grad()
        started, cpu = _now(device), time.process_time()
        extraction = extractor.extract(sdf, seeds)
        middle = _now(device)
        extraction.surface.vertices.square().sum().backward()
        optimizer.step()
        for table in extractor.tables.values():
            table.step(rate_factor=1e-6)
        times.append((middle - started, _now(device) - started, time.process_time() - cpu))
        seeds = extraction.cells
    extract, step, cpu = zip(*times[1:], strict=True)
    peak = _peak_megabytes(device)
    return ExtractRow(
        way=way,
        resolution=resolution,
        cells=len(extraction.cells),
        faces=len(extraction.surface.faces),
        extract_ms=round(1e3 * statistics.median(extract), 2),
        step_ms=round(1e3 * statistics.median(step), 2),
        cpu_ms=round(1e3 * statistics.median(cpu), 2),
        step_mb=round(peak - before, 1),
        peak_mb=round(peak, 1),
    )


def _extractor(way: Way, resolution: int, device: "torch.device") -> "Extractor":
    import torch

    from sculpt_framework import registry
    from sculpt_framework.config import ExtractorConfig
    from sculpt_framework.extractors import RefiningExtractor
    from sculpt_framework.geometry.grid import grid_over_box
    from sculpt_framework.geometry.octree_policy import RefineBox
    from sculpt_framework.types import Box

    level = round(math.log2(resolution / BASE_CELLS))
    coarser = {"flexicubes-half": 1, "flexicubes-octree": level}.get(way, 0)
    config = registry.default("extractor", "marching-tetrahedra" if way == "marching-tetrahedra" else "flexicubes")
    assert isinstance(config, ExtractorConfig)  # noqa: S101 - what the registry promises for the slot
    extractor = config.build(grid_over_box(torch.ones(3), BASE_CELLS, level - coarser), device)
    if coarser > 0:
        assert isinstance(extractor, RefiningExtractor)  # noqa: S101 - flexicubes is one
        low = 0.0 if way == "flexicubes-half" else -2.0
        extractor.cells.set_boxes([RefineBox(box=Box.between((low, -2.0, -2.0), (2.0, 2.0, 2.0)), levels=coarser)])
    return extractor


def _now(device: "torch.device") -> float:
    """Seconds, once all work on the device is done."""
    if device.type == "cuda":
        import torch

        torch.cuda.synchronize(device)
    return time.perf_counter()


def _resident_megabytes(device: "torch.device") -> float:
    if device.type == "cuda":
        import torch

        torch.cuda.reset_peak_memory_stats(device)
        return torch.cuda.memory_allocated(device) / 2**20
    # What the process has used at most so far, which right after loading is about what it uses.
    return _peak_megabytes(device)


def _peak_megabytes(device: "torch.device") -> float:
    if device.type == "cuda":
        import torch

        return torch.cuda.max_memory_allocated(device) / 2**20
    return peak_bytes() / 2**20
