"""docs/guide/writing-a-method.md, tried: its package is installed, and its method lives the whole life of a run."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.evaluation.curve import read_curve
from sculpt_framework.viewing.frames import read_frame, step_files

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "writing-a-method.md"
PROGRAM = "import sys; from importlib import import_module; import_module(sys.argv.pop(1)).main()"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An import folder that pip has installed the guide's package into."""
    source, target = tmp_path_factory.mktemp("sculpt-ball"), tmp_path_factory.mktemp("site")
    found = re.findall(r"^`([\w/.]+)`\n\n```\w+\n(.*?)^```$", GUIDE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert len(found) == 3
    for name, content in found:
        (source / name).parent.mkdir(exist_ok=True)
        (source / name).write_text(content, encoding="utf-8")
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(source)]
    subprocess.run(pip, check=True, timeout=120)
    return target


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    settings = DemoSettings(train_views=11, test_views=2, resolution=48, reference_cells=32)
    for name in ("one", "two"):
        write_scene(demo_object("blob"), settings, folder / name)
    return folder


def words(module: str, *more: str) -> list[str]:
    return [sys.executable, "-c", PROGRAM, f"sculpt_framework.cli.{module}", *more]


def environment(installed: Path) -> dict[str, str]:
    # What is on the path already stays: it says which checkout is tested.
    paths = os.pathsep.join([str(installed), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    return {**os.environ, "PYTHONPATH": paths, "COLUMNS": "160", "NO_COLOR": "1", "OMP_NUM_THREADS": "1"}


def sculpt(installed: Path, module: str, *more: str) -> str:
    done = subprocess.run(
        words(module, *more),
        env=environment(installed),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_it_trains_is_evaluated_and_reported(installed: Path, scenes: Path, tmp_path: Path):
    out = tmp_path / "run"
    told = sculpt(installed, "train", "ball", "--data", str(scenes / "one"), "--output", str(out), "--rate", "0.8")
    assert "watertight" in told
    rows = read_curve(out / "curve.csv")
    assert (rows[-1]["chamfer_ps"] or 9) < 0.5 * (rows[0]["chamfer_ps"] or 0)
    assert rows[-1]["gaussians"] is None
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Before training" in page
    assert "mesh error" in page
    told = sculpt(installed, "evaluate", str(out))
    assert re.search(r"mask IoU +0\.[6-9]", told)
    sculpt(installed, "report", str(out), "--out", str(tmp_path / "page"))
    assert "ball" in next((tmp_path / "page").glob("*.html")).read_text(encoding="utf-8")
    again = sculpt(installed, "train", "--resume", str(out))
    assert "has finished already" in again


@pytest.mark.slow
def test_killed_and_gone_on_with_it_ends_as_an_unbroken_one(installed: Path, scenes: Path, tmp_path: Path):
    common = ["--data", str(scenes / "one"), "--steps", "20", "--checkpoint-seconds", "0.001"]
    sculpt(installed, "train", "ball", *common, "--output", str(tmp_path / "whole"))
    out = tmp_path / "killed"
    process = subprocess.Popen(
        words("train", "ball", *common, "--output", str(out)), env=environment(installed), stdout=subprocess.DEVNULL
    )
    while not (out / "checkpoints" / "latest.safetensors").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    sculpt(installed, "train", "--resume", str(out))
    assert (out / "mesh.ply").read_bytes() == (tmp_path / "whole" / "mesh.ply").read_bytes()
    assert json.loads((out / "metrics.json").read_text(encoding="utf-8"))["status"] == "finished"


@pytest.mark.slow
def test_a_batch_of_it(installed: Path, scenes: Path, tmp_path: Path):
    sculpt(installed, "batch", str(scenes), "ball", "--out", str(tmp_path / "out"), "--", "--steps", "5")
    assert [path.parent.name for path in sorted((tmp_path / "out").glob("runs/*/mesh.ply"))] == ["one", "two"]


@pytest.mark.slow
def test_two_processes_run_it_as_one_does(installed: Path, scenes: Path, tmp_path: Path):
    """What a method does not share out each process does; one of them measures and writes."""
    common = ["ball", "--data", str(scenes / "one"), "--steps", "6", "--output"]
    sculpt(installed, "train", *common, str(tmp_path / "alone"))
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command = [*launcher, "-m", "sculpt_framework.cli.train", *common, str(tmp_path / "shared")]
    done = subprocess.run(
        command, env=environment(installed), capture_output=True, text=True, timeout=300, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "shared" / "mesh.ply").read_bytes() == (tmp_path / "alone" / "mesh.ply").read_bytes()


@pytest.mark.slow
def test_it_is_watched(installed: Path, scenes: Path, tmp_path: Path):
    out = tmp_path / "run"
    more = ["--viewer", "--observers.viser.port", "0", "--steps", "400", "--data", str(scenes / "one")]
    sculpt(installed, "train", "ball", *more, "--output", str(out))
    frames = [read_frame(path) for _, path in step_files(out)]
    assert len(frames) >= 2
    assert all(frame.gaussians is None and frame.cells is None for frame in frames)
    assert frames[-1].colors.shape == frames[-1].vertices.shape


@pytest.mark.slow
def test_what_it_cannot_do_is_said(installed: Path, scenes: Path, tmp_path: Path):
    out = tmp_path / "run"
    sculpt(installed, "train", "ball", "--data", str(scenes / "one"), "--output", str(out), "--steps", "3")
    for more, said in (
        (["--resume", str(out), "--refine-box", "0", "0", "0", "1", "1", "1"], "'ball' cannot be refined in boxes"),
        (["ball", "--data", "demo", "--field", "mlp"], "there is no option --field"),
        (["ball", "--data", "demo", "--rat", "1"], "Did you mean --rate?"),
    ):
        done = subprocess.run(
            words("train", *more),
            env=environment(installed),
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
            encoding="utf-8",
        )
        assert done.returncode == 2
        assert said in done.stderr
