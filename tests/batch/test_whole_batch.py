"""Twelve scenes through each engine by the real sculpt-train: one is broken, one worker is killed."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import plain_environment

from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(sys.platform != "linux", reason="finds the processes of runs in /proc"),
]
ENGINES = {
    "local": ("--workers", "2"),
    "ray": ("--engine", "ray", "--cpus-per-run", "1", "--workers", "2"),
    "slurm": ("--engine", "slurm", "--slurm-executor", "local", "--cpus-per-run", "1", "--workers", "2"),
}
SMALL = (
    *("--steps", "6", "--trainer.base-cells", "10", "--trainer.fit-steps", "20"),
    *("--trainer.polish-steps", "2", "--checkpoint-seconds", "0.01"),
)


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scans")
    first = folder / "scan-00"
    settings = DemoSettings(train_views=11, test_views=2, resolution=48, reference_cells=32)
    write_scene(demo_object("blob"), settings, first)
    for number in range(1, 12):
        shutil.copytree(first, folder / f"scan-{number:02d}")
    (folder / "scan-07" / "transforms_train.json").write_text("{", encoding="utf-8")
    return folder


def process_of(run: Path) -> int | None:
    """The process that was started for a run directory."""
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().split(b"\0")
        except OSError:
            continue
        if str(run).encode() in words:
            return int(entry.parent.name)
    return None


def parent_of(process: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[1])


@pytest.mark.parametrize("engine", ENGINES)
def test_eleven_meshes_one_named_failure_and_nothing_twice(engine: str, scans: Path, tmp_path: Path):
    package = {"ray": "ray", "slurm": "submitit"}.get(engine)
    if package is not None and importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed (pip install 'gaussian-sculpting[{engine}]')")
    out = tmp_path / "out"
    words = (str(scans), "gaussian-sculpting-tiny", "--out", str(out), "--retries", "1", *ENGINES[engine])
    command = [sys.executable, "-m", "sculpt_framework.cli.batch", *words, "--", *SMALL]
    with subprocess.Popen(
        command, env=plain_environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8"
    ) as process:
        victim = out / "runs" / "scan-03"
        while not (victim / "checkpoints" / "latest.safetensors").exists():
            assert process.poll() is None, process.stdout and process.stdout.read()
            time.sleep(0.05)
        run = process_of(victim)
        assert run is not None, "it ended before it could be killed"
        # With a scheduler the worker that carries the run is killed, and the run with it.
        os.kill(run if engine == "local" else parent_of(run), signal.SIGKILL)
        output, _ = process.communicate(timeout=1200)
    assert process.returncode == 1, output
    assert "scan-03 failed: killed by SIGKILL; it is tried again" in output
    assert "scan-03 goes on from its checkpoint" in output
    assert "11 of 12 scenes finished, 1 failed." in output
    assert "error: 1 of 12 scenes failed: scan-07:" in output
    meshes = sorted(out.glob("runs/*/mesh.ply"))
    assert [path.parent.name for path in meshes] == [f"scan-{number:02d}" for number in range(12) if number != 7]
    page = (out / "report" / "report.html").read_text(encoding="utf-8")
    assert all(path.parent.name in page for path in meshes)

    states = json.loads((out / "state.json").read_text(encoding="utf-8"))["cells"]
    assert states["scan-03"]["attempts"] == 2
    written = {path: path.stat().st_mtime_ns for path in meshes}
    again = subprocess.run(
        command, env=plain_environment(), capture_output=True, text=True, timeout=300, check=False, encoding="utf-8"
    )
    assert again.returncode == 1
    assert "12 of 12 runs were done before, 1 of them failed" in again.stdout
    assert {path: path.stat().st_mtime_ns for path in meshes} == written
    assert json.loads((out / "state.json").read_text(encoding="utf-8"))["cells"] == states
