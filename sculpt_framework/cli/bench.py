"""``sculpt-bench``: how fast the parts that decide the speed of training are on this machine."""

import importlib
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError, DeviceError

if TYPE_CHECKING:
    from sculpt_framework.cli.bench_cases import Case

COMMANDS = {
    "suite": "sculpt_framework.cli.bench_suite:suite",
    "extract": "sculpt_framework.cli.bench_extract:bench_extract",
    "start": "sculpt_framework.cli.bench_start:bench_start",
    "step": "sculpt_framework.cli.bench_step:bench_step",
    "memory": "sculpt_framework.cli.bench_memory:bench_memory",
}
"""Commands with options of their own, and the function of the words after them."""


@dataclass(frozen=True, kw_only=True)
class BenchRequest:
    """Time forward plus backward passes: medians of wall and CPU milliseconds.

    Commands of their own, with --help each: sculpt-bench suite, whole runs on a set of scenes; sculpt-bench extract,
    extraction by resolution; sculpt-bench start, the surfaces that training starts from; sculpt-bench step, an inner
    step part by part; sculpt-bench memory, that of a rendering.
    """

    what: Annotated[Literal["raster", "loss", "colors", "field"], tyro.conf.Positional]
    """raster: Gaussians on a bumpy sphere; loss: L1 and SSIM; colors: spherical harmonics; field: the hash grid."""
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
    per_second: dict[str, float]
    """Gaussians, pixels and points a second of wall time, forwards and backwards."""
    share_of_peak: float | None = None
    """raster on the CPU: what compositing could not do without, of what the CPU time it all took would do at best."""
    peak_mib: float | None = None
    """CUDA memory at the highest point of the passes beside the inputs."""


def main() -> None:
    """The console script ``sculpt-bench``."""
    exit_codes.run(lambda: bench(sys.argv[1:]))


def bench(words: Sequence[str]) -> None:
    """Measure and print. Raises ConfigError; exits as tyro does for ``--help`` and values of a wrong type."""
    if words and words[0] in COMMANDS:
        module, _, name = COMMANDS[words[0]].partition(":")
        getattr(importlib.import_module(module), name)(words[1:])
        return
    request = tyro.cli(BenchRequest, args=words, prog="sculpt-bench")
    _check(request)
    import torch

    from sculpt_framework.cli.bench_cases import fma_peak

    peak = fma_peak() if request.what == "raster" and request.device == "cpu" else None
    if peak is not None and not request.json:
        sys.stdout.write(f"one core at best: {peak * 1e-9:.0f} billion operations of float32 a second\n")
    rows = []
    for case in _cases(request):
        for threads in request.threads:
            torch.set_num_threads(threads)
            for row in _measure(case, threads, request.repeats, peak):
                rows.append(row)
                if not request.json:
                    sys.stdout.write(_line(row) + "\n")
                    sys.stdout.flush()
    if request.json:
        from sculpt_framework.export.json_text import json_text

        result = {"peak_operations_per_second": peak, "rows": [vars(row) for row in rows]}
        sys.stdout.write(json_text(result, indent=2) + "\n")


def _check(request: BenchRequest) -> None:
    if request.repeats < 1 or min(request.threads, default=0) < 1:
        raise ConfigError("--repeats and --threads take numbers from 1 upwards.")
    if request.compare_prototype is not None and request.what != "raster":
        raise ConfigError(f"--compare-prototype goes with 'raster', not with {request.what!r}.")
    if request.device != "cpu" and request.what != "raster":
        raise ConfigError(f"--device cuda goes with 'raster', not with {request.what!r}.")
    if request.device != "cpu" and request.compare_prototype is not None:
        raise ConfigError("--compare-prototype goes with --device cpu: the prototype knows no other.")
    if request.device == "cuda":
        import torch

        if not torch.cuda.is_available():
            raise DeviceError("--device cuda was asked for, but torch sees no CUDA device here; use --device cpu")


def _cases(request: BenchRequest) -> "Iterator[Case]":
    from sculpt_framework.cli.bench_cases import color_cases, field_cases, loss_cases, raster_cases

    if request.what == "raster":
        return raster_cases(request.cases, request.device, request.compare_prototype)
    return {"loss": loss_cases, "colors": color_cases, "field": field_cases}[request.what](request.cases)


def _line(row: Row) -> str:
    return (
        f"{row.case:24} {row.backend:10} {row.threads} thread{'s' if row.threads > 1 else ' '} "
        f"wall {row.wall_ms:8.2f} ms ({row.forward_wall_ms:.2f} + {row.backward_wall_ms:.2f})  cpu {row.cpu_ms:8.2f} ms"
        f"{''.join(f'  {1e-6 * rate:.2f} M {name}/s' for name, rate in row.per_second.items())}"
        f"{'' if row.share_of_peak is None else f'  {row.share_of_peak:.1%} of the peak'}"
        f"{'' if row.peak_mib is None else f'  peak {row.peak_mib:.0f} MiB'}"
    )


def _measure(case: "Case", threads: int, repeats: int, peak: float | None) -> Iterator[Row]:
    """Passes of all contenders in turn, so that a machine that gets slower does so for all."""
    import torch

    contenders = case.contenders
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
        wall = statistics.median(f + b for f, b in zip(forward, backward, strict=True))
        share = None if case.operations is None or peak is None else case.operations / statistics.median(cpu) / peak
        yield Row(
            case=case.name,
            backend=contender.backend,
            threads=threads,
            wall_ms=round(1e3 * wall, 3),
            cpu_ms=round(1e3 * statistics.median(cpu), 3),
            forward_wall_ms=round(1e3 * statistics.median(forward), 3),
            backward_wall_ms=round(1e3 * statistics.median(backward), 3),
            per_second={name: round(amount / wall, 1) for name, amount in case.amounts.items()},
            share_of_peak=None if share is None else round(share, 4),
            peak_mib=peaks.get(contender.backend),
        )


def _nothing() -> None:
    """What there is to wait for on the CPU."""


def _reset_peak() -> int:
    """Bytes of CUDA memory in use now, from where the highest point is looked for."""
    import torch

    torch.cuda.reset_peak_memory_stats()
    return torch.cuda.memory_allocated()
