import itertools
import json
import time
from pathlib import Path

import pytest
import torch

from sculpt_framework.cli.bench import bench
from sculpt_framework.cli.bench_cases import OPERATIONS_PER_PAIR, RASTERIZERS, fma_peak, raster_operations
from sculpt_framework.cli.bench_kernels import WAYS, operations_of
from sculpt_framework.cli.bench_memory import MemoryRow, plane, splats_on_a_sphere
from sculpt_framework.cli.bench_splats import bumpy_sphere_camera
from sculpt_framework.errors import ConfigError, DeviceError


@pytest.fixture(autouse=True)
def _threads_restored():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize(
    ("what", "backends"),
    [
        ("raster", {"numba", "reference"}),
        ("loss", {"numba", "torch"}),
        ("colors", {"numba", "torch"}),
        ("field", {"numba", "torch"}),
    ],
)
def test_smallest_case_as_json(what: str, backends: set[str], capsys: pytest.CaptureFixture[str]):
    bench([what, "--cases", "0", "--repeats", "1", "--json"])
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {row["backend"] for row in rows} == backends
    assert all(row["wall_ms"] > 0 and row["cpu_ms"] > 0 and row["threads"] == 1 for row in rows)
    amounts = {
        "raster": {"gaussians": 500, "pixels": 64 * 64},
        "loss": {"pixels": 200 * 200},
        "colors": {"gaussians": 100_000},
        "field": {"points": 50_000},
    }
    for row in rows:
        # As many as there are, over the time it took.
        expected = {name: amount / (1e-3 * row["wall_ms"]) for name, amount in amounts[what].items()}
        assert row["per_second"] == pytest.approx(expected, rel=1e-2)


def test_as_text(capsys: pytest.CaptureFixture[str]):
    bench(["raster", "--cases", "0", "--repeats", "1"])
    printed = capsys.readouterr().out
    assert "500 faces x1 64px" in printed
    assert "M gaussians/s" in printed
    assert "of the peak" in printed


def test_share_of_what_the_processor_does_at_best(capsys: pytest.CaptureFixture[str]):
    bench(["raster", "--cases", "1", "--repeats", "3", "--json"])
    result = json.loads(capsys.readouterr().out)
    (row,) = result["rows"]
    # Any processor does a multiply-add per nanosecond, and none keeps its pipes full of splats.
    assert result["peak_operations_per_second"] > 1e9
    assert 0.005 < row["share_of_peak"] < 1.0


def test_the_peak_is_that_of_the_fastest_pass(monkeypatch: pytest.MonkeyPatch):
    """By a clock on which each pass takes a second, and the third half of one."""
    seconds = [1.0, 1.0, 0.5, *[1.0] * 7]
    ticks = itertools.accumulate(passed for each in seconds for passed in (0.0, each))
    monkeypatch.setattr(time, "thread_time", lambda: next(ticks))
    (few, _), (many, _) = WAYS
    assert few < many < 2 * few
    assert fma_peak() == operations_of(few, 20_000) / 0.5


def test_pairs_are_those_of_the_contract():
    """Counted one by one from the reference's own arithmetic in float64."""
    from sculpt_framework.rasterizers import Rasterizer
    from sculpt_framework.rendering.projection import project

    splats, camera = splats_on_a_sphere(60), bumpy_sphere_camera(24, torch.device("cpu"))
    means, scales, rotations, opacities, _ = (tensor.detach().double() for tensor in splats)
    camera = camera.to(torch.device("cpu"), torch.float64)
    screen = project(means, scales, rotations, camera, 0.3)
    order = screen.depths.argsort()
    axis = torch.arange(24, dtype=torch.float64) + 0.5
    rows, columns = torch.meshgrid(axis, axis, indexing="ij")
    left, pairs = torch.ones(24, 24, dtype=torch.float64), 0
    for i in order.tolist():
        dx, dy = columns - screen.means[i, 0], rows - screen.means[i, 1]
        xx, xy, yy = screen.conics[i]
        alpha = opacities[i] * torch.exp(-0.5 * (xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy))
        counts = (alpha >= Rasterizer.ALPHA_MIN) & (left >= Rasterizer.TRANSMITTANCE_MIN)
        pairs += int(counts.sum())
        left = torch.where(counts, left * (1 - alpha.clamp(max=0.999)), left)
    assert pairs > 1000
    assert raster_operations(splats, camera.to(torch.device("cpu"), torch.float32)) == pytest.approx(
        OPERATIONS_PER_PAIR * pairs, rel=2e-3
    )


def test_plane_through_cases():
    rows = [
        MemoryRow(gaussians=n, pixels=p, peak_mb=(100.0 * n + 20.0 * p) / 2**20 + 3.0)
        for n in (1000, 5000)
        for p in (100, 900)
    ]
    fit = plane(rows)
    assert fit is not None
    assert (fit.per_gaussian, fit.per_pixel, fit.constant_mb, fit.largest_error) == (100.0, 20.0, 3.0, 0.0)
    bent = plane([*rows, MemoryRow(gaussians=20_000, pixels=100, peak_mb=100.0)])
    assert bent is not None
    assert bent.largest_error > 0.05
    assert plane(rows[:2]) is None


@pytest.mark.slow
def test_memory_of_a_rendering_is_linear(capsys: pytest.CaptureFixture[str]):
    bench(["memory", "--gaussians", "100000", "200000", "400000", "--sizes", "400", "1200", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert result["fit"]["largest_error"] < 0.1
    assert 100 < result["fit"]["per_gaussian"] < 1000
    assert 10 < result["fit"]["per_pixel"] < 200


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["raster", "--cases", "99"], "cases 0 to 6"),
        (["raster", "--repeats", "0"], "--repeats"),
        (["loss", "--compare-prototype", "x"], "goes with 'raster'"),
        (["loss", "--device", "cuda"], "goes with 'raster'"),
        (["memory", "--gaussians", "0"], "--gaussians"),
        (["raster", "--device", "cuda", "--compare-prototype", "x"], "goes with --device cpu"),
    ],
)
def test_errors(words: list[str], message: str):
    with pytest.raises(ConfigError, match=message):
        bench(words)


def test_cuda_that_is_not_there(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(DeviceError, match="--device cuda was asked for"):
        bench(["raster", "--device", "cuda"])


def test_a_backend_that_cannot_run_is_left_out(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(RASTERIZERS, "cpu", ("gsplat", "numba"))
    bench(["raster", "--cases", "0", "--repeats", "1"])
    printed = capsys.readouterr()
    assert "gsplat left out: rasterizer 'gsplat' runs on CUDA devices" in printed.err
    assert "gsplat" not in printed.out
    assert "numba" in printed.out


@pytest.mark.gpu
def test_smallest_case_on_cuda(capsys: pytest.CaptureFixture[str]):
    bench(["raster", "--device", "cuda", "--cases", "0", "--repeats", "1", "--json"])
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {"triton", "reference"} <= {row["backend"] for row in rows}
    assert all(row["wall_ms"] > 0 and row["peak_mib"] > 0 for row in rows)


def test_folder_without_a_prototype(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"no raster_proto\.py"):
        bench(["raster", "--compare-prototype", str(tmp_path)])
