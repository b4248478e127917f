import json
from pathlib import Path

import pytest
import torch

from sculpt_framework.cli.bench import RASTERIZERS, bench
from sculpt_framework.errors import ConfigError, DeviceError


@pytest.fixture(autouse=True)
def _threads_restored():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize(("what", "backends"), [("raster", {"numba", "reference"}), ("loss", {"numba", "torch"})])
def test_smallest_case_as_json(what: str, backends: set[str], capsys: pytest.CaptureFixture[str]):
    bench([what, "--cases", "0", "--repeats", "1", "--json"])
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {row["backend"] for row in rows} == backends
    assert all(row["wall_ms"] > 0 and row["cpu_ms"] > 0 and row["threads"] == 1 for row in rows)


def test_as_text(capsys: pytest.CaptureFixture[str]):
    bench(["raster", "--cases", "0", "--repeats", "1"])
    assert "500 faces x1 64px" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["raster", "--cases", "99"], "cases 0 to 6"),
        (["raster", "--repeats", "0"], "--repeats"),
        (["loss", "--compare-prototype", "x"], "goes with 'raster'"),
        (["loss", "--device", "cuda"], "goes with 'raster'"),
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
