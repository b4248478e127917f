"""The commands once: train, as a user runs it, then look, measure, export and resume, in this process."""

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

OPTIONS = (
    "--dataset demo --dataset.resolution 48 --dataset.train-views 10 --dataset.test-views 2 "
    "--steps 4 --trainer.fit-steps 30 --trainer.polish-steps 4"
)
FILES = [
    "checkpoints",
    "config.json",
    "curve.csv",
    "events.jsonl",
    "gaussians.ply",
    "mesh.glb",
    "mesh.ply",
    "metrics.json",
    "report.html",
]
Finished = subprocess.CompletedProcess[str]
Here = Callable[..., Finished]


def trained_by(environment: dict[str, str], *words: str | Path) -> Finished:
    code = """
import sys
from sculpt_framework.cli.train import main
from sculpt_framework.evaluation import evaluator

# As in conftest.py, whose fixtures do not reach this process.
evaluator.CURVE_SAMPLES, evaluator.RESULT_SAMPLES = 1_000, 4_000
sys.argv[0] = "sculpt"
main()
"""
    arguments = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(
        arguments, env=environment, capture_output=True, text=True, timeout=120, check=False, encoding="utf-8"
    )


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Here:
    """``here("train", *words)``: that command, which a process of its own would import all again for."""

    def command(module: str, *words: str | Path) -> Finished:
        arguments = ["sculpt", *map(str, words)]
        monkeypatch.setenv("COLUMNS", "200")
        monkeypatch.setattr(sys, "argv", arguments)
        # The libraries of this process have their threads already; numba refuses to compile where they are to change.
        monkeypatch.setattr("sculpt_framework.cli.train.limit_threads", lambda threads: None)
        capfd.readouterr()
        code: object = 0
        try:
            importlib.import_module(f"sculpt_framework.cli.{module}").main()
        except SystemExit as end:
            code = end.code
        out, err = capfd.readouterr()
        return Finished(args=arguments, returncode=int(str(code)), stdout=out, stderr=err)

    return command


@pytest.fixture(scope="module")
def trained(command_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Finished]:
    folder = tmp_path_factory.mktemp("commands") / "run"
    words = ["gaussian-sculpting-tiny", "--data", "demo", "--output", folder, *OPTIONS.split()]
    return folder, trained_by(command_environment, *words)


def require_one_line(done: Finished, code: int, *parts: str) -> None:
    assert done.returncode == code, done.stderr
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    for part in parts:
        assert part in done.stderr


def test_training_leaves_every_file(trained: tuple[Path, Finished]):
    folder, done = trained
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in folder.iterdir()) == FILES
    assert (folder / "checkpoints" / "latest.safetensors").is_file()
    for name in ("mesh.ply", "curve.csv", "report.html", "100 % of the optimisation"):
        assert name in done.stdout
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["status"] == "finished"
    assert metrics["certificate"]["watertight"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    for name in ("reference", "rendering", "difference", "normals", "mesh error"):
        assert f"{name}" in page
    # Once for the result and, but for the reference, once for the start.
    assert page.count("data:image/png;base64") == 9


def test_a_finished_run_is_measured_and_exported(trained: tuple[Path, Finished], here: Here, tmp_path: Path):
    folder, _ = trained
    done = here("evaluate", folder, "--json", "--samples", "5000")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    done = here("export", folder, "--format", "obj", "--out", tmp_path / "mesh.obj")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "mesh.obj").read_text(encoding="utf-8").count("\nf ") > 100


def test_a_finished_run_is_left_alone(trained: tuple[Path, Finished], here: Here):
    folder, _ = trained
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    done = here("train", "--resume", folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    assert "has finished already" in done.stdout
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_a_damaged_checkpoint_is_one_line(trained: tuple[Path, Finished], here: Here, tmp_path: Path):
    folder = tmp_path / "run"
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "config.json").write_bytes((trained[0] / "config.json").read_bytes())
    checkpoint = folder / "checkpoints" / "latest.safetensors"
    checkpoint.write_bytes((trained[0] / "checkpoints" / "latest.safetensors").read_bytes()[:1000])
    require_one_line(here("train", "--resume", folder), 2, "damaged")
