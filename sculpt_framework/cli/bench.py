"""``sculpt-bench``: how fast the parts that decide the speed of training are on this machine; ``suite``: whole runs."""

import importlib
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.cli.bench_splats import bumpy_sphere_camera, splats_on_bumpy_sphere
from sculpt_framework.errors import ComponentImportError, ConfigError, DeviceError

if TYPE_CHECKING:
    from types import ModuleType

    import torch
    from torch import Tensor

    from sculpt_framework.types import Camera

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]

RASTER_CASES = (
    # Faces of the mesh, Gaussians per face, pixels along the image's side.
    (500, 1, 64),
    (10_000, 1, 400),
    (40_000, 1, 400),
    (40_000, 3, 400),
    (40_000, 1, 800),
    (160_000, 1, 800),
    (160_000, 3, 800),
)
CUDA_RASTER_CASES = (*RASTER_CASES, (300_000, 1, 800), (1_000_000, 1, 800), (3_000_000, 1, 800))
RASTERIZERS = {"cpu": ("numba",), "cuda": ("triton", "gsplat")}
DENSE_PAIRS = 10_000_000
"""Pixels times Gaussians beyond which the reference, which forms all of these pairs, is left out."""


@dataclass(frozen=True, kw_only=True)
class BenchRequest:
    """Time forward plus backward passes: medians of wall and CPU milliseconds.

    Whole runs on a set of scenes have a command of their own: sculpt-bench suite --help
    So have the cost of extraction by resolution, sculpt-bench extract --help, and the surfaces that training starts
    from, sculpt-bench start --help, and an inner step part by part, sculpt-bench step --help
    """

    what: Annotated[Literal["raster", "loss", "encode"], tyro.conf.Positional]
    """raster: Gaussians on a bumpy sphere; loss: L1 and SSIM; encode: the hash grid."""
    threads: tuple[int, ...] = (1,)
    """CPU threads, one run of all cases for each number."""
    repeats: Annotated[int, tyro.conf.arg(metavar="N")] = 9
    """Timed passes per case, after two that are not."""
    cases: Annotated[tuple[int, ...] | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """Numbers of the cases to run, counted from 0. Default: all."""
    compare_prototype: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    """raster only: also time the raster_proto.py in this folder, its passes in turn with ours."""
    device: Literal["cpu", "cuda"] = "cpu"
    """raster only: cuda times triton and, where it is installed, gsplat."""
    json: Flag = False
    """Print JSON."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the result. Milliseconds are medians."""

    case: str
    backend: str
    threads: int
    wall_ms: float
    cpu_ms: float
    forward_wall_ms: float
    backward_wall_ms: float
    peak_mib: float | None = None
    """CUDA memory at the highest point of the passes beside the inputs."""


@dataclass(frozen=True, kw_only=True)
class Contender:
    """A way to compute a case: ``forward`` gives tensors, and what turns a pass's gradients back to none."""

    backend: str
    forward: "Callable[[], tuple[Tensor, ...]]"
    leaves: "Sequence[Tensor]"
    cuda: bool = False


def main() -> None:
    """The console script ``sculpt-bench``."""
    exit_codes.run(lambda: bench(sys.argv[1:]))


def bench(words: Sequence[str]) -> None:
    """Measure and print. Raises ConfigError; exits as tyro does for ``--help`` and values of a wrong type."""
    if words and words[0] == "suite":
        from sculpt_framework.cli.bench_suite import suite

        suite(words[1:])
        return
    if words and words[0] == "extract":
        from sculpt_framework.cli.bench_extract import bench_extract

        bench_extract(words[1:])
        return
    if words and words[0] == "step":
        from sculpt_framework.cli.bench_step import bench_step

        bench_step(words[1:])
        return
    if words and words[0] == "start":
        from sculpt_framework.cli.bench_start import bench_start

        bench_start(words[1:])
        return
    request = tyro.cli(BenchRequest, args=words, prog="sculpt-bench")
    if request.repeats < 1 or min(request.threads, default=0) < 1:
        raise ConfigError("--repeats and --threads take numbers from 1 upwards.")
    if request.compare_prototype is not None and request.what != "raster":
        raise ConfigError(f"--compare-prototype goes with 'raster', not with {request.what!r}.")
    if request.device != "cpu" and request.what != "raster":
        raise ConfigError(f"--device cuda goes with 'raster', not with {request.what!r}.")
    if request.device != "cpu" and request.compare_prototype is not None:
        raise ConfigError("--compare-prototype goes with --device cpu: the prototype knows no other.")
    import torch

    if request.device == "cuda" and not torch.cuda.is_available():
        raise DeviceError("--device cuda was asked for, but torch sees no CUDA device here; use --device cpu")
    cases = {"raster": _raster_cases, "loss": _loss_cases, "encode": _encode_cases}[request.what](request)
    rows = []
    for case, contenders in cases:
        for threads in request.threads:
            torch.set_num_threads(threads)
            for row in _measure(case, contenders, threads, request.repeats):
                rows.append(row)
                if not request.json:
                    sys.stdout.write(_line(row) + "\n")
                    sys.stdout.flush()
    if request.json:
        from sculpt_framework.export.json_text import json_text

        sys.stdout.write(json_text({"rows": [vars(row) for row in rows]}, indent=2) + "\n")


def _line(row: Row) -> str:
    return (
        f"{row.case:24} {row.backend:10} {row.threads} thread{'s' if row.threads > 1 else ' '} "
        f"wall {row.wall_ms:8.2f} ms ({row.forward_wall_ms:.2f} + {row.backward_wall_ms:.2f})  cpu {row.cpu_ms:8.2f} ms"
        f"{'' if row.peak_mib is None else f'  peak {row.peak_mib:.0f} MiB'}"
    )


def _measure(case: str, contenders: Sequence[Contender], threads: int, repeats: int) -> Iterator[Row]:
    """Passes of all contenders in turn, so that a machine that gets slower does so for all."""
    import torch

    times: dict[str, list[tuple[float, float, float]]] = {contender.backend: [] for contender in contenders}
    peaks: dict[str, float] = {}
    for repeat in range(repeats + 2):
        for contender in contenders:
            for leaf in contender.leaves:
                leaf.grad = None
            wait = torch.cuda.synchronize if contender.cuda else _nothing
            held = _reset_peak() if contender.cuda else 0
            wait()
            wall, cpu = time.perf_counter(), time.process_time()
            outputs = contender.forward()
            wait()
            middle = time.perf_counter()
            torch.autograd.backward(outputs, [torch.ones_like(output) for output in outputs])
            wait()
            end = time.perf_counter()
            if repeat >= 2:
                times[contender.backend].append((middle - wall, end - middle, time.process_time() - cpu))
            if contender.cuda:
                peaks[contender.backend] = round((torch.cuda.max_memory_allocated() - held) / 2**20, 1)
            del outputs
    for contender in contenders:
        forward, backward, cpu = zip(*times[contender.backend], strict=True)
        yield Row(
            case=case,
            backend=contender.backend,
            threads=threads,
            wall_ms=round(1e3 * statistics.median(f + b for f, b in zip(forward, backward, strict=True)), 3),
            cpu_ms=round(1e3 * statistics.median(cpu), 3),
            forward_wall_ms=round(1e3 * statistics.median(forward), 3),
            backward_wall_ms=round(1e3 * statistics.median(backward), 3),
            peak_mib=peaks.get(contender.backend),
        )


def _nothing() -> None:
    """What there is to wait for on the CPU."""


def _reset_peak() -> int:
    """Bytes of CUDA memory in use now, from where the highest point is looked for."""
    import torch

    torch.cuda.reset_peak_memory_stats()
    return torch.cuda.memory_allocated()


def _chosen(request: BenchRequest, count: int) -> Sequence[int]:
    chosen = range(count) if request.cases is None else request.cases
    if any(not 0 <= number < count for number in chosen):
        raise ConfigError(f"--cases {' '.join(map(str, chosen))}: there are cases 0 to {count - 1}.")
    return chosen


def _raster_cases(request: BenchRequest) -> Iterator[tuple[str, list[Contender]]]:
    """Colour and coverage of Gaussians on a bumpy sphere that fills two fifths of the image, by all that run there."""
    import torch

    prototype = None if request.compare_prototype is None else _prototype(request.compare_prototype)
    device = torch.device(request.device)
    cases = CUDA_RASTER_CASES if request.device == "cuda" else RASTER_CASES
    for number in _chosen(request, len(cases)):
        faces, per_face, size = cases[number]
        camera = bumpy_sphere_camera(size, device)
        splats = [tensor.to(device).requires_grad_(True) for tensor in splats_on_bumpy_sphere(faces, per_face)]
        dense = splats[0].shape[0] * size * size <= DENSE_PAIRS
        names = (*RASTERIZERS[request.device], *(("reference",) if dense else ()))
        contenders = [each for name in names if (each := _rasterizer(name, splats, camera, device)) is not None]
        if prototype is not None:
            contenders.append(_prototype_rasterizer(prototype, splats, camera))
        yield f"{faces} faces x{per_face} {size}px", contenders


def _rasterizer(name: str, splats: "list[Tensor]", camera: "Camera", device: "torch.device") -> Contender | None:
    """A backend's passes; None, and a line that says why, where it cannot run here."""
    import torch

    from sculpt_framework import registry
    from sculpt_framework.config import RasterizerConfig

    config = registry.default("rasterizer", name)
    assert isinstance(config, RasterizerConfig)  # noqa: S101 - what the registry promises for the slot
    try:
        rasterizer = config.build(device)
    except (ComponentImportError, DeviceError) as error:
        sys.stderr.write(f"{name} left out: {error}\n")
        return None
    background = torch.zeros(3, device=device)

    def forward() -> "tuple[Tensor, ...]":
        means, scales, rotations, opacities, colors = splats
        output = rasterizer.rasterize(
            means, scales, rotations, opacities, colors, camera, background, low_pass_px2=0.3, alpha_max=0.999
        )
        return output.features, output.alpha

    return Contender(backend=name, forward=forward, leaves=splats, cuda=device.type == "cuda")


def _prototype(folder: Path) -> "ModuleType":
    """The module raster_proto of a folder, which imports its neighbours by plain names."""
    if not (folder / "raster_proto.py").is_file():
        raise ConfigError(f"--compare-prototype {folder}: there is no raster_proto.py in that folder.")
    sys.path.insert(0, str(folder))
    return importlib.import_module("raster_proto")


def _prototype_rasterizer(prototype: "ModuleType", splats: "list[Tensor]", camera: "Camera") -> Contender:
    def forward() -> "tuple[Tensor, ...]":
        from sculpt_framework.cpu_kernels import share_threads

        share_threads()
        lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        return prototype.render(*splats, camera.world_to_camera, *lens)[:2]

    return Contender(backend="prototype", forward=forward, leaves=splats)


def _loss_cases(request: BenchRequest) -> Iterator[tuple[str, list[Contender]]]:
    import torch

    from sculpt_framework.rendering.photometric import l1_dssim, l1_dssim_in_torch

    sizes = (200, 400, 800)
    for number in _chosen(request, len(sizes)):
        size = sizes[number]
        target = torch.rand(size, size, 3, generator=torch.Generator().manual_seed(0))
        image = (0.9 * target + 0.05).requires_grad_(True)

        def compiled(image: "Tensor" = image, target: "Tensor" = target) -> "tuple[Tensor, ...]":
            return (l1_dssim(image, target, 0.2),)

        def in_torch(image: "Tensor" = image, target: "Tensor" = target) -> "tuple[Tensor, ...]":
            return (l1_dssim_in_torch(image, target, 0.2),)

        yield (
            f"{size}x{size}x3",
            [
                Contender(backend="numba", forward=compiled, leaves=[image]),
                Contender(backend="torch", forward=in_torch, leaves=[image]),
            ],
        )


def _encode_cases(request: BenchRequest) -> Iterator[tuple[str, list[Contender]]]:
    """Points on a sphere, as they are near a surface, with and without a gradient by their positions."""
    import torch

    from sculpt_framework.encodings.hash_grid import HashEncoding, encode_in_torch

    cases = [(count, log2_table, moving) for log2_table in (17, 19) for count in (50_000, 200_000) for moving in (0, 1)]
    for number in _chosen(request, len(cases)):
        count, log2_table, moving = cases[number]
        encoding = HashEncoding(
            levels=8,
            features_per_level=2,
            log2_table=log2_table,
            base_resolution=8,
            finest_resolution=256,
            init_scale=0.1,
        )
        directions = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
        points = (0.6 * directions / directions.norm(dim=1, keepdim=True)).requires_grad_(bool(moving))
        tables = list(encoding.tables)

        def compiled(encoding: HashEncoding = encoding, points: "Tensor" = points) -> "tuple[Tensor, ...]":
            return (encoding(points),)

        def in_torch(encoding: HashEncoding = encoding, points: "Tensor" = points) -> "tuple[Tensor, ...]":
            return (encode_in_torch(points, list(encoding.tables), encoding.resolutions),)

        leaves = [points, *tables]
        yield (
            f"{count} points 2^{log2_table}{' d/dx' if moving else ''}",
            [
                Contender(backend="numba", forward=compiled, leaves=leaves),
                Contender(backend="torch", forward=in_torch, leaves=leaves),
            ],
        )
