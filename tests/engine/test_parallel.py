"""Several processes on one object do what one does, and a dead one ends the job so that it can be resumed."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from ranks import config_of
from small_runs import small_config

from sculpt_framework.engine.checkpoint import read_checkpoint
from sculpt_framework.engine.run import StopFlag, run
from sculpt_framework.errors import ConfigError, DeviceError
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.parallel.processes import Alone, ProcessLost, Value, gather, shared_commands
from sculpt_framework.serialization import read_config

HERE = Path(__file__).parent
Job = dict[str, Any]
SHORT: dict[str, Any] = {"steps": 4, "holdout_every": 0, "fit_steps": 20}
TORCHRUN = {"RANK": "0", "WORLD_SIZE": "2", "LOCAL_RANK": "0", "LOCAL_WORLD_SIZE": "2", "MASTER_ADDR": "localhost"}


@pytest.fixture(scope="session")
def bare_scene(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene without a mesh to measure against, which would take longer than the steps."""
    folder = tmp_path_factory.mktemp("bare") / "blob"
    folder.mkdir()
    for path in scene_folder.iterdir():
        if path.name != "gt_mesh.ply":
            (folder / path.name).symlink_to(path)
    return folder


def do(jobs: list[Job], scene: Path, work: Path, environment: dict[str, str], seconds: float = 550.0) -> dict[str, Job]:
    """What ranks.py tells of each job, by its name. Whoever waits for the dead waits for longer, ten minutes."""
    command = [sys.executable, str(HERE / "ranks.py"), str(scene), str(work), json.dumps(jobs)]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=seconds, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr
    return {job["name"]: told for job, told in zip(jobs, json.loads(done.stdout), strict=True)}


@pytest.fixture(scope="session")
def outcomes(
    bare_scene: Path, tmp_path_factory: pytest.TempPathFactory, command_environment: dict[str, str]
) -> tuple[dict[str, Job], Path]:
    work = tmp_path_factory.mktemp("ranks")
    jobs = [
        {"name": "one", "processes": 1, "changes": SHORT},
        {"name": "three", "processes": 3, "changes": SHORT},
        {"name": "dead", "processes": 2, "kill": [1, 2, 1], "changes": SHORT},
        {"name": "dead on", "processes": 2, "resume": "dead"},
        {"name": "headless", "processes": 2, "kill": [0, 2, 0], "changes": SHORT},
        {"name": "headless on", "processes": 1, "resume": "headless"},
    ]
    return do(jobs, bare_scene, work, command_environment), work


def mesh_of(folder: Path) -> Mesh:
    return load_mesh(folder / "mesh.ply")


def losses(folder: Path) -> list[float]:
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text(encoding="utf-8").splitlines()]
    return [event["data"]["loss"] for event in events if event["event"] == "outer_step"]


@pytest.mark.slow
def test_three_processes_do_what_one_does(outcomes: tuple[dict[str, Job], Path]):
    told, work = outcomes
    assert told["one"]["codes"] == [0], told["one"]["said"]
    assert told["three"]["codes"] == [0, 0, 0], told["three"]["said"]
    assert losses(work / "three") == pytest.approx(losses(work / "one"), rel=1e-5)
    one, three = mesh_of(work / "one"), mesh_of(work / "three")
    np.testing.assert_array_equal(one.faces, three.faces)
    np.testing.assert_allclose(one.vertices, three.vertices, atol=1e-4)


@pytest.mark.slow
def test_only_the_first_process_writes_and_speaks(outcomes: tuple[dict[str, Job], Path]):
    told, work = outcomes
    assert told["three"]["said"][1:] == ["", ""]
    events = (work / "three" / "events.jsonl").read_text(encoding="utf-8").splitlines()
    assert sum(json.loads(line)["event"] == "run_started" for line in events) == 1
    assert sum(json.loads(line)["event"] == "run_ended" for line in events) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("name", "dead", "left"), [("dead", 1, 0), ("headless", 0, 1)])
def test_a_dead_process_is_named_and_the_run_goes_on(
    name: str, dead: int, left: int, outcomes: tuple[dict[str, Job], Path]
):
    told, work = outcomes
    ended = told[name]
    assert ended["codes"][dead] == -signal.SIGKILL
    assert ended["codes"][left] == 1, ended["said"]
    number = ended["numbers"][dead]
    expected = rf"error: process {dead} of 2 \(number {number} on .*\) has died; --resume goes on from the checkpoint\n"
    assert re.search(expected, ended["said"][left]), ended["said"][left]
    again = told[f"{name} on"]
    assert set(again["codes"]) == {0}, again["said"]
    assert json.loads((work / name / "metrics.json").read_text(encoding="utf-8"))["status"] == "finished"
    # It went on after the second step, the last that was whole, and lost none.
    lines = (work / name / "events.jsonl").read_text(encoding="utf-8").splitlines()
    assert any("going on after outer step 2" in line for line in lines)
    assert mesh_of(work / name).vertices.shape[0] > 100


@pytest.mark.slow
def test_a_run_keeps_its_batch_whoever_goes_on_with_it(outcomes: tuple[dict[str, Job], Path]):
    _, work = outcomes
    assert read_config(work / "headless" / "config.json").trainer.inner_batch == 2
    assert small_config().among(3).trainer.inner_batch == 3
    assert small_config(inner_batch=5).among(3).trainer.inner_batch == 5
    assert small_config().among(1).trainer.inner_batch is None


class _Several(Alone):
    """As seen from the first of three processes whose others do nothing."""

    @property
    def count(self) -> int:
        return 3


def test_commands_of_the_first_reach_all(monkeypatch: pytest.MonkeyPatch):
    from sculpt_framework.commands import ExportMesh, SetRate, Stop

    commands = [SetRate(part="surface", factor=0.5), ExportMesh(), Stop()]
    (take,) = shared_commands([lambda: commands], _Several())
    assert take() == commands
    monkeypatch.setattr(_Several, "leads", False)
    assert take() == [commands[0], commands[2]]
    source = [lambda: commands]
    assert shared_commands(source, Alone()) is source


def test_one_process_pays_nothing(bare_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Nothing of torch.distributed is called, and what would call it is not imported."""
    monkeypatch.setitem(sys.modules, "sculpt_framework.parallel.ranks", None)
    called: list[str] = []
    for name in ("init_process_group", "all_reduce", "broadcast", "barrier", "all_gather", "TCPStore"):
        monkeypatch.setattr(torch.distributed, name, lambda *words, name=name, **more: called.append(name))
    for name in (*TORCHRUN, "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    job = {"name": "run", "changes": {**SHORT, "steps": 1, "inner_batch": None}}
    run(config_of(job, str(bare_scene), tmp_path), resume=None, started=time.monotonic())
    assert called == []
    assert isinstance(gather({"WORLD_SIZE": "1"}, torch.device("cpu")), Alone)
    assert list(Alone().share(3)) == [0, 1, 2]


def test_a_loss_that_shows_between_two_steps_is_saved(
    bare_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    class Deserted(Alone):
        def first(self, make: Callable[[], Value]) -> Value:
            if isinstance(make, StopFlag):  # Asked by the loop over the session, not by a step.
                raise ProcessLost("process 1 of 2 has died")
            return super().first(make)

    monkeypatch.setattr("sculpt_framework.engine.run.gather", lambda environment, device: Deserted())
    job = {"name": "run", "changes": {**SHORT, "steps": 3}}
    with pytest.raises(ProcessLost, match="has died"):
        run(config_of(job, str(bare_scene), tmp_path), resume=None, started=time.monotonic())
    state, _ = read_checkpoint(tmp_path / "run" / "checkpoints")
    assert state


def test_what_torchrun_says_must_be_whole(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(ConfigError, match=r"WORLD_SIZE is 2, but RANK, LOCAL_RANK.* torchrun --nproc-per-node N"):
        gather({"WORLD_SIZE": "2"}, torch.device("cpu"))
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(DeviceError, match=r"2 processes on .*, which has 1 CUDA devices; give --nproc-per-node 1"):
        gather({**TORCHRUN, "MASTER_PORT": "1"}, torch.device("cuda"))
    with pytest.raises(ConfigError, match="the processes cannot meet at localhost:99999, MASTER_ADDR and MASTER_PORT"):
        gather({**TORCHRUN, "MASTER_PORT": "99999"}, torch.device("cpu"))


@pytest.mark.long
def test_killed_ten_times_it_ends_and_goes_on_ten_times(
    bare_scene: Path, tmp_path: Path, command_environment: dict[str, str]
):
    chance = random.Random(7)
    jobs: list[Job] = []
    for number in range(10):
        kill = [chance.randrange(2), chance.randrange(4), chance.randrange(2)]
        jobs.append({"name": f"run-{number}", "processes": 2, "kill": kill, "changes": SHORT})
        jobs.append({"name": f"run-{number} on", "processes": 2, "resume": f"run-{number}"})
    told = do(jobs, bare_scene, tmp_path, command_environment, 1500.0)
    for number in range(10):
        ended, dead = told[f"run-{number}"], jobs[2 * number]["kill"][0]
        assert ended["codes"][dead] == -signal.SIGKILL
        assert f"process {dead} of 2 (number {ended['numbers'][dead]} on" in ended["said"][1 - dead]
        assert told[f"run-{number} on"]["codes"] == [0, 0], told[f"run-{number} on"]["said"]


@pytest.mark.slow
def test_torchrun_trains_and_names_the_dead(bare_scene: Path, tmp_path: Path, command_environment: dict[str, str]):
    launcher = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    train = [*launcher, "-m", "sculpt_framework.cli.train"]
    small = ("--trainer.base-cells", "10", "--trainer.fit-steps", "20", "--trainer.polish-steps", "0")
    words = [
        "gaussian-sculpting-tiny",
        "--data",
        str(bare_scene),
        "--output",
        str(tmp_path / "run"),
        "--device",
        "cpu",
        *small,
    ]
    environment = {**command_environment, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [*train, *words, "--steps", "60"], env=environment, stderr=subprocess.PIPE, text=True, encoding="utf-8"
    ) as process:
        events = tmp_path / "run" / "events.jsonl"
        while not events.exists() or '"outer_step"' not in events.read_text(encoding="utf-8"):
            assert process.poll() is None, process.stderr and process.stderr.read()
            time.sleep(0.1)
        victim = next(number for number in descendants(process.pid) if rank_of(number) == "1")
        os.kill(victim, signal.SIGKILL)
        _, said = process.communicate(timeout=60)
    assert process.returncode != 0
    assert f"error: process 1 of 2 (number {victim} on" in said
    assert (tmp_path / "run" / "checkpoints" / "latest.safetensors").exists()
    again = subprocess.run(
        [*train, "--resume", str(tmp_path / "run")],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        encoding="utf-8",
    )
    assert again.returncode == 0, again.stderr
    assert json.loads((tmp_path / "run" / "metrics.json").read_text(encoding="utf-8"))["status"] == "finished"


def descendants(process: int) -> list[int]:
    children = [
        int(word) for word in Path(f"/proc/{process}/task/{process}/children").read_text(encoding="utf-8").split()
    ]
    return children + [each for child in children for each in descendants(child)]


def rank_of(process: int) -> str | None:
    words = Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
    return next((word[5:].decode() for word in words if word.startswith(b"RANK=")), None)
