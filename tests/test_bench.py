import json
from pathlib import Path

import pytest
import torch

from sculpt_framework.cli.bench import bench
from sculpt_framework.errors import ConfigError


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
    ],
)
def test_errors(words: list[str], message: str):
    with pytest.raises(ConfigError, match=message):
        bench(words)


def test_folder_without_a_prototype(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"no raster_proto\.py"):
        bench(["raster", "--compare-prototype", str(tmp_path)])
