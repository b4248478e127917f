"""What the machine may do to a run: kill it, refuse its files, interrupt it."""

import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from sculpt_framework.cli import exit_codes
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.engine.run import stop_on_interrupt

PROGRAM = Path(__file__).with_name("killing.py")
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forked processes")


@pytest.fixture(scope="module")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("killed") / "blob"
    settings = DemoSettings(train_views=11, test_views=2, resolution=32, reference_cells=16)
    write_scene(demo_object("blob"), settings, folder)
    # Comparing with a reference would take most of so small a run, and most kills would meet nothing else.
    (folder / "gt_mesh.ply").unlink()
    return folder


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def killed(scene: Path, work: Path, kills: int, timeout: float) -> dict:
    command = [sys.executable, str(PROGRAM), str(scene), str(work), str(kills), "0"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=timeout, check=False, env=environment(), encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def check_report(report: dict, kills: int) -> None:
    assert report["kills"] == kills
    assert report["resumed"] + report["started_again"] == kills
    assert report["resumed"] > 0
    assert report["broken"] == []
    assert report["different"] == []


@pytest.mark.slow
def test_killed_runs_end_as_unbroken_ones(small_scene: Path, tmp_path: Path):
    check_report(killed(small_scene, tmp_path, 3, 500), 3)


@pytest.mark.slow
def test_a_hundred_kills(small_scene: Path, tmp_path: Path):
    check_report(killed(small_scene, tmp_path, 100, 3600), 100)


def test_a_second_interrupt_stops_at_once():
    with stop_on_interrupt() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def too_much() -> None:
    torch.empty(1 << 60, dtype=torch.uint8)


def no_memory() -> None:
    raise MemoryError


@pytest.mark.parametrize("main", [too_much, no_memory])
def test_too_little_memory_is_one_line_with_what_to_lower(main, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        exit_codes.run(main)
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "image-scale" in said


def test_another_runtime_error_keeps_its_traceback():
    def fails() -> None:
        raise RuntimeError("shapes do not match")

    with pytest.raises(RuntimeError, match="shapes"):
        exit_codes.run(fails)


def limit_files() -> None:
    """The system refuses files of more than 20 kB: the first checkpoint or mesh is larger."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


def sculpt_train(*words: str, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from sculpt_framework.cli.train import main; main()", *words]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=300, check=False, env=environment(), **options
    )


@pytest.mark.slow
def test_files_the_system_refuses_are_one_line(small_scene: Path, tmp_path: Path):
    words = ["gaussian-sculpting-tiny", "--data", str(small_scene), "--output", str(tmp_path / "run")]
    steps = ["--steps", "2", "--trainer.fit-steps", "5", "--trainer.base-cells", "8"]
    steps += ["--checkpoint-seconds", "0.01", "--trainer.polish-steps", "0"]
    done = sculpt_train(*words, *steps, "--observers", "recorder", preexec_fn=limit_files)
    assert done.returncode == 2, done.stderr[-2000:]
    assert done.stderr.count("\n") == 1
    assert "cannot write" in done.stderr
    assert "File too large" in done.stderr
    assert not list((tmp_path / "run").rglob("*.partial"))


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a folder in which nobody may write")
def test_a_folder_nobody_may_write_is_one_line(small_scene: Path):
    done = sculpt_train("gaussian-sculpting-tiny", "--data", str(small_scene), "--output", "/proc/run")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot write to /proc/run" in done.stderr
