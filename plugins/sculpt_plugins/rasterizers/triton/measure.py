"""Measure the kernels on a CUDA device where there is nothing but Python, torch and Triton.

    python plugins/sculpt_plugins/rasterizers/triton/measure.py
    python -m sculpt_plugins.rasterizers.triton.measure --check     with plugins/ as the working folder, or installed

Prints milliseconds of forward and backward pass, medians by CUDA events, and peak memory; for gsplat, too, where it can
be imported. ``--check`` compares a picture and all gradients with those of Triton's interpreter on the CPU first: what
the tests run there is then what the compiler has made.
"""

import argparse
import importlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

if not __package__:
    # Run as a file: its own folder on the path would only hide other packages.
    sys.path[0] = str(Path(__file__).resolve().parents[3])

from sculpt_plugins.rasterizers.triton.scenes import bumpy_sphere, camera, quaternions
from sculpt_plugins.rasterizers.triton.splatting import splat

Pass = Callable[[list[Tensor]], tuple[Tensor, Tensor]]
_CHECKED = 500, 64
"""Gaussians and pixels a side of the comparison with the interpreter: about half a minute."""
_TOLERANCE = 1e-4
_MIB = 2**20


def main(words: list[str] | None = None) -> None:
    """Parse the command line and print. Exits with code 2 without a CUDA device, 1 if a check fails."""
    parser = argparse.ArgumentParser(prog="measure", description="Time the Triton rasteriser on a CUDA device.")
    parser.add_argument("--gaussians", type=int, nargs="+", default=[300_000, 1_000_000, 3_000_000])
    parser.add_argument("--size", type=int, default=800, help="pixels along the image's side")
    parser.add_argument("--repeats", type=int, default=20, help="timed passes, after three that are not")
    parser.add_argument("--check", action="store_true", help="compare with the interpreter first")
    parser.add_argument("--kernels", action="store_true", help="list the time of each kernel, too")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", type=Path, help=argparse.SUPPRESS)
    request = parser.parse_args(words)
    if request.write is not None:
        torch.save(_picture(torch.device("cpu")), request.write)
        return
    if not torch.cuda.is_available():
        parser.exit(2, "measure: torch sees no CUDA device here\n")
    device = torch.device("cuda")
    if request.check and not _check(device):
        parser.exit(1)
    rows = [row for count in request.gaussians for row in measured_rows(count, request.size, request.repeats, device)]
    if request.json:
        sys.stdout.write(json.dumps({"device": torch.cuda.get_device_name(), "rows": rows}, indent=2) + "\n")
    else:
        sys.stdout.write(f"{torch.cuda.get_device_name()}, torch {torch.__version__}\n")
        for row in rows:
            sys.stdout.write(
                "{gaussians:>9} Gaussians {size} px  {backend:7} {total_ms:8.3f} ms ({forward_ms:.3f} + "
                "{backward_ms:.3f})  peak {peak_mib:7.0f} MiB, held {held_mib:7.0f} MiB  {ratio}\n".format(**row)
            )
    if request.kernels:
        for count in request.gaussians:
            sys.stdout.write(_kernels(count, request.size, device) + "\n")


def measured_rows(count: int, size: int, repeats: int, device: torch.device) -> list[dict]:
    """One row per backend. The backends' passes take turns, so that a device that slows down does so for all."""
    scene = bumpy_sphere(count, device)
    passes = {"triton": (_by_triton(size, device), [*scene])}
    gsplat = _by_gsplat(size, device)
    if gsplat is not None:
        passes["gsplat"] = (gsplat, [scene[0], scene[1], quaternions(scene[2]), scene[3], scene[4]])
    leaves = {name: [tensor.clone().requires_grad_(True) for tensor in inputs] for name, (_, inputs) in passes.items()}
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in passes}
    for repeat in range(repeats + 3):
        for name, (run, _) in passes.items():
            elapsed = _timed(run, leaves[name])
            if repeat >= 3:
                times[name].append(elapsed)
    rows = []
    for name, (run, _) in passes.items():
        forward, backward = (statistics.median(part) for part in zip(*times[name], strict=True))
        peak, held = _memory(run, leaves[name])
        total = statistics.median(sum(elapsed) for elapsed in times[name])
        rows.append(
            {
                "gaussians": count,
                "size": size,
                "backend": name,
                "total_ms": round(total, 4),
                "forward_ms": round(forward, 4),
                "backward_ms": round(backward, 4),
                "peak_mib": round(peak / _MIB, 1),
                "held_mib": round(held / _MIB, 1),
                "ratio": "",
            }
        )
    if len(rows) == 2:
        rows[0]["ratio"] = f"triton / gsplat {rows[0]['total_ms'] / rows[1]['total_ms']:.2f}"
    return rows


def _timed(run: Pass, leaves: list[Tensor]) -> tuple[float, float]:
    """Milliseconds of the forward and of the backward pass, as the device's clock saw them."""
    for leaf in leaves:
        leaf.grad = None
    marks = [torch.cuda.Event(enable_timing=True) for _ in range(3)]
    torch.cuda.synchronize()
    marks[0].record()
    outputs = run(leaves)
    marks[1].record()
    torch.autograd.backward(outputs, [torch.ones_like(output) for output in outputs])
    marks[2].record()
    torch.cuda.synchronize()
    return marks[0].elapsed_time(marks[1]), marks[1].elapsed_time(marks[2])


def _memory(run: Pass, leaves: list[Tensor]) -> tuple[int, int]:
    """Bytes in use at a pass's highest point, gradients included, inputs not; bytes torch took of the device for it."""
    for leaf in leaves:
        leaf.grad = None
    torch.cuda.synchronize()
    torch.cuda.empty_cache()
    torch.cuda.reset_peak_memory_stats()
    before, held_before = torch.cuda.memory_allocated(), torch.cuda.memory_reserved()
    _timed(run, leaves)
    return torch.cuda.max_memory_allocated() - before, torch.cuda.max_memory_reserved() - held_before


def _by_triton(size: int, device: torch.device) -> Pass:
    pose, screen = camera(size, device)
    background = torch.zeros(3, device=device)

    def run(leaves: list[Tensor]) -> tuple[Tensor, Tensor]:
        means, scales, rotations, opacities, colors = leaves
        image, alpha, _ = splat(means, scales, rotations, opacities, colors, pose, background, screen)
        return image, alpha

    return run


def _by_gsplat(size: int, device: torch.device) -> Pass | None:
    try:
        rasterization = importlib.import_module("gsplat").rasterization
    except ImportError as error:
        sys.stderr.write(f"gsplat left out: {error}\n")
        return None
    pose, screen = camera(size, device)
    lens = torch.tensor([[screen.fx, 0.0, screen.cx], [0.0, screen.fy, screen.cy], [0.0, 0.0, 1.0]], device=device)

    def run(leaves: list[Tensor]) -> tuple[Tensor, Tensor]:
        means, scales, rotations, opacities, colors = leaves
        images, alphas, _ = rasterization(
            means, rotations, scales, opacities, colors, pose[None], lens[None], size, size,
            near_plane=0.01, eps2d=screen.low_pass_px2, packed=False,
        )  # fmt: skip
        return images, alphas

    return run


def _kernels(count: int, size: int, device: torch.device) -> str:
    """A table of the kernels of ten passes, by time."""
    leaves = [tensor.requires_grad_(True) for tensor in bumpy_sphere(count, device)]
    run = _by_triton(size, device)
    _timed(run, leaves)
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
        for _ in range(10):
            _timed(run, leaves)
    return f"{count} Gaussians, 10 passes\n{profile.key_averages().table(sort_by='device_time_total', row_limit=24)}"


def _picture(device: torch.device) -> dict[str, Tensor]:
    """Image, alpha, depth and all gradients of a small scene in which little is hidden, on the CPU."""
    count, size = _CHECKED
    generator = torch.Generator().manual_seed(1)
    means, scales, rotations, _, colors = bumpy_sphere(count, device)
    opacities = 0.02 + 0.9 * torch.rand(count, generator=generator)
    pose, screen = camera(size, device)
    background = torch.tensor([0.2, 0.5, 0.8], device=device)
    leaves = (means, scales, rotations, opacities.to(device), colors, pose)
    for leaf in leaves:
        leaf.requires_grad_(True)
    images = splat(*leaves, background, screen)
    slopes = [torch.randn(image.shape, generator=generator).to(device) for image in images]
    names = ("image", "alpha", "depth", "means", "scales", "rotations", "opacities", "colors", "pose")
    values = [*images, *torch.autograd.grad(images, leaves, slopes)]
    return {name: value.detach().cpu() for name, value in zip(names, values, strict=True)}


def _check(device: torch.device) -> bool:
    """Whether the compiled kernels give the interpreter's numbers, and the same bits twice; prints how far they are."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.pt"
        subprocess.run(
            [sys.executable, __file__, "--write", str(path)], env={**os.environ, "TRITON_INTERPRET": "1"}, check=True
        )
        expected = torch.load(path, weights_only=True)
    first, second = _picture(device), _picture(device)
    good = True
    for name, value in expected.items():
        error = float((first[name] - value).norm() / value.norm())
        repeats = torch.equal(first[name], second[name])
        good &= error < _TOLERANCE and repeats
        sys.stdout.write(f"{name:10} relative difference {error:.1e}{'' if repeats else ', NOT the same bits twice'}\n")
    sys.stdout.write("the compiled kernels agree with the interpreter\n" if good else "they do NOT agree\n")
    return good


if __name__ == "__main__":
    main()
