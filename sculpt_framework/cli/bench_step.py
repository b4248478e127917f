"""``sculpt-bench step``: what one inner step costs, part by part, and how much of it is outside the kernels."""

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sculpt_framework import registry
from sculpt_framework.cli.bench_splats import bumpy_sphere, bumpy_sphere_camera
from sculpt_framework.command_line.options import Flag
from sculpt_framework.config import RasterizerConfig
from sculpt_framework.device import pick_device
from sculpt_framework.errors import ConfigError

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from sculpt_framework.binders import Binding
    from sculpt_framework.rasterizers import Rasterizer
    from sculpt_framework.sculpting.gaussian_scene import GaussianScene
    from sculpt_framework.types import Surface

PROGRAM = "sculpt-bench step"
_PARTS = ("bind", "colors", "render", "loss", "constraints", "backward", "update")
_COMPILED = ("_Bind", "_CompiledEncoding", "_CompiledExcess", "_CompiledLoss", "_Rasterize")
_IDLE = 3


@dataclass(frozen=True, kw_only=True)
class StepRequest:
    """Time an inner step of the default method on a bumpy sphere: places, colours, rendering, loss, gradient, update.

    Of a step of colours alone, and of one in which places and scales learn too. Medians over the repeats.
    """

    faces: Annotated[int, tyro.conf.arg(metavar="N")] = 120_000
    """Faces, each with one Gaussian."""
    size: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 400
    """Side of the square image."""
    repeats: Annotated[int, tyro.conf.arg(metavar="N")] = 15
    """Timed steps, after three that are not."""
    threads: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """CPU threads."""
    device: Literal["cpu", "cuda"] = "cpu"
    """With cuda, the parts are the host's time in them, and the kernels' that of the device in all of them."""
    json: Flag = False
    """Print JSON."""


@dataclass(frozen=True, kw_only=True)
class StepRow:
    """Medians of wall milliseconds over the steps, by part; ``cpu_ms`` is of the whole step, of all threads.

    The parts are of steps under torch's profiler and add up to more than the total, which is of steps without it.
    """

    step: str
    gaussians: int
    size: int
    threads: int
    total_ms: float
    cpu_ms: float
    bind_ms: float
    """Gaussians from faces and rows."""
    colors_ms: float
    """Colours from the appearance, with the encoding's kernel."""
    render_ms: float
    """With the rasteriser's kernels."""
    loss_ms: float
    """With the kernel, which forms value and gradient."""
    constraints_ms: float
    backward_ms: float
    """With the backward kernels of rasteriser and encoding."""
    update_ms: float
    kernels_ms: float
    """Of all these, what is inside the compiled functions of rasteriser, loss and encoding; on CUDA, in kernels."""
    outside_kernels: float
    """Share of the total that is not."""


def bench_step(words: Sequence[str]) -> None:
    """Measure and print. Raises ConfigError; exits as tyro does for ``--help`` and values of a wrong type."""
    request = tyro.cli(StepRequest, args=words, prog=PROGRAM)
    if min(request.faces - 3, request.size, request.repeats, request.threads) < 1:
        raise ConfigError("--size, --repeats and --threads take numbers from 1 upwards, --faces from 4.")
    import torch

    torch.set_num_threads(request.threads)
    rows = [_measure(request, places) for places in (False, True)]
    if request.json:
        from sculpt_framework.export.json_text import json_text

        sys.stdout.write(json_text([asdict(row) for row in rows], indent=2) + "\n")
        return
    for row in rows:
        sys.stdout.write(f"{row.step}: {row.gaussians} Gaussians, {row.size}x{row.size}, {row.threads} thread(s)\n")
        for name in ("total", "cpu", *_PARTS, "kernels"):
            sys.stdout.write(f"  {name:12} {getattr(row, name + '_ms'):8.2f} ms\n")
        sys.stdout.write(f"  outside the kernels {row.outside_kernels:.1%}\n")


def _measure(request: StepRequest, places: bool) -> StepRow:
    """An inner step as ``BiLevelTrainer.inner_loop`` takes it."""
    import torch
    from torch.profiler import ProfilerActivity, profile, record_function

    from sculpt_framework.rendering.photometric import l1_dssim
    from sculpt_framework.sculpting.gaussian_scene import assemble

    device = pick_device(request.device)
    scene, surface, rasterizer, constraints = _parts(request.faces, device)
    camera, background = bumpy_sphere_camera(request.size, device), torch.zeros(3, device=device)
    target = torch.rand(request.size, request.size, 3, generator=torch.Generator().manual_seed(0)).to(device)
    wait = torch.cuda.synchronize if device.type == "cuda" else lambda: None
    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if device.type == "cuda" else [])]
    fixed = scene.bind(surface, learn=False)

    def step() -> None:
        scene.zero_grad()
        with record_function("bind"):
            binding = scene.bind(surface, learn=True) if places else fixed
        with record_function("colors"):
            gaussians = assemble(binding, scene.harmonics(binding.means, degree=0, learn=True))
        with record_function("render"):
            image = rasterizer.render(gaussians, camera, background, low_pass_px2=0.05)
        with record_function("loss"):
            loss = l1_dssim(image.rgb, target, 0.2)
        with record_function("constraints"):
            if places:
                loss = loss + sum(weight * constraint(binding) for weight, constraint in constraints)
        with record_function("backward"):
            loss.backward()
        with record_function("update"):
            scene.step(1.0)

    parts: dict[str, list[float]] = {name: [] for name in ("total", "cpu", "kernels", *_PARTS)}
    # Without the profiler: it takes time itself, most where there is most of Python, and has the system take memory
    # back between two steps, which a run keeps.
    for count in range(_IDLE + request.repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        step()
        wait()
        if count >= _IDLE:
            parts["total"].append(1e3 * (time.perf_counter() - wall))
            parts["cpu"].append(1e3 * (time.process_time() - cpu))
    for _ in range(request.repeats):
        with profile(activities=activities) as profiled:
            step()
            wait()
        # An annotation is told twice where there is a GPU: of the host, and of the device.
        events = profiled.key_averages()
        for name in _PARTS:
            parts[name].append(1e-3 * sum(event.cpu_time_total for event in events if event.key == name))
        if device.type == "cpu":
            kernels = [event.self_cpu_time_total for event in events if event.key.startswith(_COMPILED)]
        else:
            there = [event for event in events if event.device_type.name == "CUDA" and event.key not in _PARTS]
            kernels = [event.self_device_time_total for event in there]
        parts["kernels"].append(1e-3 * sum(kernels))
    medians = {f"{name}_ms": round(statistics.median(values), 3) for name, values in parts.items()}
    return StepRow(
        step="places and colours" if places else "colours alone",
        gaussians=request.faces,
        size=request.size,
        threads=request.threads,
        outside_kernels=round(1 - medians["kernels_ms"] / medians["total_ms"], 3),
        **medians,
    )


def _parts(
    faces: int, device: "torch.device"
) -> "tuple[GaussianScene, Surface, Rasterizer, list[tuple[float, Callable[[Binding], Tensor]]]]":
    """The default method's binder, appearance and constraints on a bumpy sphere, and the device's rasteriser."""
    import torch

    from sculpt_framework.sculpting.config import of_sculpting
    from sculpt_framework.sculpting.gaussian_scene import GaussianScene
    from sculpt_framework.types import Surface

    method = of_sculpting(registry.load_method("gaussian-sculpting")())
    rasterizer = registry.default("rasterizer", "auto")
    assert isinstance(rasterizer, RasterizerConfig)  # noqa: S101 - what the registry promises for the slot
    points, triangles = bumpy_sphere(faces)
    surface = Surface(
        vertices=torch.from_numpy(points).float().to(device),
        faces=torch.from_numpy(triangles).long().to(device),
        face_keys=torch.arange(len(triangles), device=device),
    )
    scene = GaussianScene(method.binder.build(), method.appearance.build(device))
    scene.follow(surface)
    constraints = [(config.weight, config.build()) for config in method.constraints]
    return scene, surface, rasterizer.build(device), constraints
