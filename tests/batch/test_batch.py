"""``sculpt-batch`` through each engine; what is started is a stand-in for sculpt-train, but for the slow test."""

import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import FAKE_TRAIN, plain_environment, started, with_fake

from sculpt_framework.batch.carrier import carry
from sculpt_framework.cli.batch import batch, main
from sculpt_framework.errors import ConfigError, DeviceError, SculptError, TrainingFailed
from sculpt_framework.experiments.launching import KILLED, LocalEngine, Order, start_process

MakeScenes = Callable[..., Path]
TINY = "gaussian-sculpting-tiny"
ENGINES = {
    "local": ("--workers", "2"),
    "ray": ("--engine", "ray", "--cpus-per-run", "1", "--workers", "2"),
    "slurm": ("--engine", "slurm", "--slurm-executor", "local", "--cpus-per-run", "1", "--workers", "2"),
}


def needed_for(engine: str) -> None:
    package = {"ray": "ray", "slurm": "submitit"}.get(engine)
    if package is not None and importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed (pip install 'gaussian-sculpting[{engine}]')")


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sculpt_framework.experiments.runner.TRAIN", FAKE_TRAIN)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.chdir(tmp_path)


# Starting a Ray cluster takes half a minute on a busy machine, and what it needs of one is not ours to test every time.
@pytest.mark.parametrize("engine", ["local", pytest.param("ray", marks=pytest.mark.long), "slurm"])
def test_failures_are_isolated_and_named_and_nothing_is_done_twice(
    engine: str, make_scenes: MakeScenes, tmp_path: Path
):
    needed_for(engine)
    folder, out = make_scenes("apple", "broken-bowl", "killed-cup", "mug"), tmp_path / "out"
    command = with_fake(str(folder), TINY, "--out", str(out), *ENGINES[engine])
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=plain_environment(),
        cwd=tmp_path,
        encoding="utf-8",
    )
    assert done.returncode == 1, done.stderr
    assert "killed-cup failed: killed by SIGKILL; it is tried again, 0 tries left" in done.stdout
    assert "killed-cup goes on from its checkpoint" in done.stdout
    assert "3 of 4 scenes finished, 1 failed." in done.stdout
    assert done.stderr.startswith("error: 1 of 4 scenes failed: broken-bowl: the data are no good.")
    assert sorted(path.parent.name for path in out.glob("runs/*/mesh.ply")) == ["apple", "killed-cup", "mug"]
    assert "threads 1 " in (out / "runs" / "mug.log").read_text(encoding="utf-8")
    page = (out / "report" / "report.html").read_text(encoding="utf-8")
    assert "killed-cup" in page
    assert "the data are no good" in page
    assert "| broken-bowl | the data are no good |" in (out / "tables.md").read_text(encoding="utf-8")
    states = json.loads((out / "state.json").read_text(encoding="utf-8"))["cells"]
    assert {name: (state["status"], state["attempts"]) for name, state in states.items()} == {
        "apple": ("finished", 1),
        "broken-bowl": ("failed", 1),
        "killed-cup": ("finished", 2),
        "mug": ("finished", 1),
    }
    assert len(started(out)) == 5


def test_the_same_command_runs_what_is_missing(
    fake: None, make_scenes: MakeScenes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = make_scenes("apple", "crash", "mug")
    words = [str(folder), TINY, "--retries", "2", "--", "--seed", "4"]
    with pytest.raises(TrainingFailed, match="1 of 3 scenes failed: crash: RuntimeError: a fault of ours"):
        batch(words)
    out = tmp_path / "outputs" / "batch-scans"
    assert sum("crash" in line for line in started(out)) == 3
    assert all(" --seed 4 " in line for line in started(out))
    (folder / "pear").mkdir()
    with pytest.raises(TrainingFailed, match="1 of 4 scenes failed"):
        batch(words)
    assert len(started(out)) == 6
    assert "pear" in started(out)[-1]
    (folder / "crash").rename(folder / "brick")
    capsys.readouterr()
    batch(words)
    assert "4 of 4 scenes finished, 0 failed." in capsys.readouterr().out
    batch([*words[:2], "--show", *words[2:]])
    assert len(started(out)) == 7


def test_failures_are_tried_again_when_asked(fake: None, make_scenes: MakeScenes, tmp_path: Path):
    folder = make_scenes("broken")
    for more, count in (((), 1), ((), 1), (("--retry-failed",), 2)):
        with pytest.raises(TrainingFailed, match=r"all 1 runs failed; the first said: the data are no good"):
            batch([str(folder), TINY, "--out", "out", *more])
        assert len(started(tmp_path / "out")) == count


@pytest.mark.parametrize(
    "engine", [pytest.param(engine, marks=() if engine == "local" else pytest.mark.long) for engine in ENGINES]
)
def test_an_interrupt_lets_runs_save_wherever_they_are(engine: str, make_scenes: MakeScenes, tmp_path: Path):
    needed_for(engine)
    folder, out = make_scenes("waits"), tmp_path / "out"
    command = with_fake(str(folder), TINY, "--out", str(out), *ENGINES[engine])
    ready = out / "runs" / "waits" / "ready"
    with subprocess.Popen(command, env=plain_environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as first:
        wait_for(ready.exists, first)
        first.send_signal(signal.SIGINT)
        output, _ = first.communicate(timeout=90)
    assert first.returncode == 130, output
    assert b"interrupted; the same command goes on" in output
    assert json.loads((out / "runs" / "waits" / "metrics.json").read_text(encoding="utf-8"))["status"] == "stopped"
    if engine != "local":
        return  # how it goes on is the same for all
    done = subprocess.run(
        command, env=plain_environment(), capture_output=True, text=True, timeout=90, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr
    assert "waits goes on from its checkpoint" in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="the system has no signal for the death of a parent")
def test_no_run_goes_on_when_the_batch_is_killed(make_scenes: MakeScenes, tmp_path: Path):
    folder, out = make_scenes("waits"), tmp_path / "out"
    ready = out / "runs" / "waits" / "ready"
    with subprocess.Popen(with_fake(str(folder), TINY, "--out", str(out)), env=plain_environment()) as first:
        wait_for(lambda: ready.exists() and ready.read_text(encoding="utf-8") != "", first)
        first.kill()
    deadline = time.monotonic() + 20
    while Path(f"/proc/{ready.read_text(encoding='utf-8')}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def wait_for(holds: Callable[[], bool], process: subprocess.Popen) -> None:
    deadline = time.monotonic() + 90
    while not holds():
        assert process.poll() is None, process.stdout and process.stdout.read()
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_gpus_are_given_to_one_run_at_a_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5,GPU-7,8")
    engine = LocalEngine(2, gpus_per_run=2)
    show = (sys.executable, "-S", "-c", "import os; print(os.environ['CUDA_VISIBLE_DEVICES'])")
    orders = [Order(name="x", command=show, log=tmp_path / f"{number}.log") for number in range(4)]
    for pair in (orders[:2], orders[2:]):
        jobs = [engine.start(order) for order in pair]
        while any(job.poll() is None for job in jobs):
            time.sleep(0.01)
        assert {order.log.read_text(encoding="utf-8") for order in pair} == {"3,5\n", "GPU-7,8\n"}
    with pytest.raises(DeviceError, match="3 runs at a time with 2 CUDA devices each need 6; there are 4 here"):
        LocalEngine(3, gpus_per_run=2)


def test_a_run_of_several_gpus_has_a_process_for_each(make_scenes: MakeScenes, monkeypatch: pytest.MonkeyPatch):
    seen: list[tuple[str, ...]] = []

    def start(command: tuple[str, ...], log: Path, environment: dict[str, str]) -> subprocess.Popen[bytes]:
        seen.append(tuple(command))
        return start_process((sys.executable, "-S", "-c", "import sys; sys.exit('error: not here')"), log, environment)

    monkeypatch.setattr("sculpt_framework.experiments.launching.start_process", start)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1")
    folder = make_scenes("mug")
    with pytest.raises(TrainingFailed):
        batch([str(folder), TINY, "--gpus-per-run", "2", "--retries", "0", "--out", str(folder.parent / "out")])
    launched = " ".join(seen[0])
    assert "-m torch.distributed.run --standalone --nproc-per-node 2 -m sculpt_framework.cli.train" in launched


def test_a_carrier_reports_how_the_run_ended(tmp_path: Path):
    log = tmp_path / "run.log"
    assert carry((sys.executable, "-S", "-c", "import os; print(os.environ['HERE'])"), str(log), {"HERE": "x"}) == 0
    assert log.read_text(encoding="utf-8") == "x\n"
    assert carry((sys.executable, "-S", "-c", "import os; os.kill(os.getpid(), 9)"), str(log), {}) == KILLED


def test_a_run_hears_of_interrupts_though_its_worker_blocks_them(tmp_path: Path):
    log, ask = tmp_path / "run.log", "import signal as s; print(s.SIGINT in s.pthread_sigmask(s.SIG_BLOCK, ()))"
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        assert carry((sys.executable, "-S", "-c", ask), str(log), {}) == 0
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    assert log.read_text(encoding="utf-8") == "False\n"


SAVES = """
import pathlib, signal, sys, time
def stop(number, frame):
    print("saved")
    sys.exit(0)
signal.signal(signal.SIGINT, stop)
print("deaf" if signal.SIGUSR2 in signal.pthread_sigmask(signal.SIG_BLOCK, ()) else "ends by SIGUSR2")
pathlib.Path(sys.argv[1]).touch()
time.sleep(60)
"""


def test_a_run_saves_before_the_time_of_its_job_is_over(tmp_path: Path):
    def submitit(number: int, frame: object) -> None:
        raise RuntimeError("Job not requeued because: timed-out and not checkpointable.")

    def warn() -> None:
        while not ready.exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGUSR2)

    ready, log = tmp_path / "ready", tmp_path / "run.log"
    before = signal.signal(signal.SIGUSR2, submitit)
    scheduler = threading.Thread(target=warn)
    scheduler.start()
    try:
        assert carry((sys.executable, "-S", "-c", SAVES, str(ready)), str(log), {}) == 0
        scheduler.join()
        assert signal.getsignal(signal.SIGUSR2) is submitit
    finally:
        signal.signal(signal.SIGUSR2, before)
    assert log.read_text(encoding="utf-8") == "deaf\nsaved\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--workers 0", "--workers is 0; expected 1 or more"),
        ("--gpus-per-run -1", "--gpus-per-run is -1; expected 0 or more"),
        ("--retries -1", "expected 0 or more"),
        ("--ray-address x:1", "--ray-address needs --engine ray"),
        ("--slurm partition=long", "need --engine slurm"),
        ("--engine slurm --slurm-executor local --slurm partition", "expected NAME=VALUE"),
        ("--engine slurm --slurm-executor local --slurm cpus-per-task=3", "follows from the other options"),
        ("--engine slurm --slurm-executor local --slurm time=10", "--slurm-minutes); leave it out"),
        ("--engine slurm --slurm-executor local --slurm job-name=mine", "leave it out"),
        ("--engine slurm", "there is no sbatch on this machine"),
        ("-- --output x", "--output cannot be given to all runs"),
        ("-- --fieldd mlp", "there is no option --fieldd"),
    ],
)
def test_mistakes_cost_nothing(
    words: str, message: str, fake: None, make_scenes: MakeScenes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    if "slurm" in words:
        needed_for("slurm")
    monkeypatch.setattr("shutil.which", lambda name: None)
    folder = make_scenes("mug")
    with pytest.raises(SculptError, match=re.escape(message)):
        batch([str(folder), TINY, "--out", "out", *words.split()])
    assert not (tmp_path / "out" / "runs").exists()


SBATCH = """#!/bin/sh
cp "$1" "$(dirname "$0")/script"
echo 'sbatch: error: invalid partition specified: moon' >&2
echo 'sbatch: error: Batch job submission failed' >&2
exit 1
"""


def test_a_job_that_slurm_refuses_is_one_line(
    fake: None,
    make_scenes: MakeScenes,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    needed_for("slurm")
    (tmp_path / "bin").mkdir()
    for name in ("sbatch", "srun"):
        (tmp_path / "bin" / name).write_text(SBATCH, encoding="utf-8")
        (tmp_path / "bin" / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"), prepend=":")
    words = [str(make_scenes("mug")), TINY, "--out", "out", "--engine", "slurm", "--slurm", "partition=moon"]
    with pytest.raises(ConfigError, match=r"sbatch takes no job \(.*partition specified: moon.*; mend --slurm"):
        batch(words)
    assert capsys.readouterr().err == ""
    assert (
        json.loads((tmp_path / "out" / "state.json").read_text(encoding="utf-8"))["cells"]["mug"]["status"] == "pending"
    )
    # What it would have been: tried again by the batch alone, and asked to save before its time is over.
    script = (tmp_path / "bin" / "script").read_text(encoding="utf-8")
    assert "#SBATCH --no-requeue\n" in script
    assert "#SBATCH --signal=USR2@90\n" in script


@pytest.mark.parametrize(("engine", "package"), [("ray", "ray"), ("slurm", "submitit")])
def test_an_engine_that_is_not_installed(
    engine: str, package: str, fake: None, make_scenes: MakeScenes, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=rf"--engine {engine} needs .*pip install 'gaussian-sculpting\[{engine}\]'"):
        batch([str(make_scenes("mug")), TINY, "--engine", engine])


def test_main_ends_with_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr("sys.argv", ["sculpt-batch", "nowhere", TINY])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    assert capsys.readouterr().err.startswith("error: nowhere: no such folder or file; expected")


def test_help_imports_nothing_heavy():
    script = (
        "import sys\nsys.argv = ['sculpt-batch', '--help']\nfrom sculpt_framework.cli.batch import main\n"
        "try:\n    main()\nfinally:\n    heavy = {'torch', 'numpy', 'ray', 'submitit', 'viser', 'scipy'}\n"
        "    sys.stderr.write(','.join(sorted(heavy & set(sys.modules))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False, encoding="utf-8"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "SCENE_DIR_OR_LIST" in done.stdout
