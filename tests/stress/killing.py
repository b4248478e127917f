"""Kills small runs at random moments, resumes them and compares what they end with: a program for tests.

    python killing.py SCENE_FOLDER WORK_FOLDER KILLS SEED

Prints one JSON object. Attempts are forked off a process that has imported everything, also what only the report needs,
so that a kill costs no start of a Python; no attempt computes in that process, as threads would not survive the fork.
"""

import json
import os
import random
import signal
import sys
import time
from pathlib import Path

import torch
import trimesh  # noqa: F401

sys.path.insert(0, str(Path(__file__).parents[1] / "engine"))

from small_runs import ONE_STAGE, small_config

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.checkpoint import FILE_NAME, read_checkpoint
from sculpt_framework.engine.run import CHECKPOINTS, CONFIG_NAME, run, run_status
from sculpt_framework.engine.session import Session
from sculpt_framework.errors import SculptError
from sculpt_framework.evaluation.curve import read_curve
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.evaluation.report import write_report  # noqa: F401
from sculpt_framework.serialization import read_config
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig

TIMES = ("t_train_s", "t_wall_s", "t_cpu_s", "rss_mb")


def config_of(scene: str, output: Path) -> MethodConfig:
    """A checkpoint after every step: kills shall meet the writing of them."""
    return small_config(
        data=scene,
        dataset=BlenderConfig(),
        observers=(RecorderConfig(step_seconds=0.0),),
        output=output,
        steps=6,
        fit_steps=20,
        stages=ONE_STAGE,
        checkpoint_seconds=0.01,
        threads=1,
    )


def attempt(
    config: MethodConfig, folder: Path, resume: Path | None, kill_after: float | None, *, written: bool = False
) -> int | None:
    """The exit code of a run in a process of its own; None if it had to be killed.

    That is ``kill_after`` seconds from its start, or, if it is to have ``written`` something to its folder, from its
    first checkpoint.
    """
    before = checkpoint_time(folder)
    child = os.fork()
    if child == 0:
        code = 1
        # Standard output is the report's alone: a run that was killed after its last file says that it has finished.
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        try:
            run(config, resume=resume, started=time.monotonic())
            code = 0
        except SculptError as error:
            sys.stderr.write(f"{error}\n")
            code = 2
        finally:
            os._exit(code)
    deadline = time.monotonic() + (600.0 if kill_after is None or written else kill_after)
    while time.monotonic() < deadline:
        if written and checkpoint_time(folder) != before:
            written, deadline = False, time.monotonic() + (kill_after or 0.0)
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)


def checkpoint_time(folder: Path) -> int:
    """When the last checkpoint was written; 0 if there is none."""
    path = folder / CHECKPOINTS / FILE_NAME
    return path.stat().st_mtime_ns if path.exists() else 0


def broken_files(folder: Path) -> list[str]:
    """Files of a run that are there and cannot be read."""
    found = []

    def reads(name: str, read) -> None:
        if (folder / name).exists():
            try:
                read(folder / name)
            except Exception as error:
                found.append(f"{name}: {type(error).__name__}: {error}")

    reads(CONFIG_NAME, read_config)
    reads(f"{CHECKPOINTS}/{FILE_NAME}", lambda path: read_checkpoint(path.parent))
    reads("curve.csv", read_curve)
    reads("metrics.json", lambda path: json.loads(path.read_text(encoding="utf-8")))
    reads("mesh.ply", load_mesh)
    # A line that was being added may be cut; those before it may not.
    reads(
        "events.jsonl",
        lambda path: [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines(True)[:-1]],
    )
    return found


def final(folder: Path) -> dict[str, object]:
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["final"]
    return {name: value for name, value in metrics.items() if name not in TIMES}


def until_first_checkpoint(folder: Path) -> float:
    """Seconds from a run's start until there is something to go on from."""
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text(encoding="utf-8").splitlines()]
    return next(event["t_wall"] for event in events if event["event"] == "checkpoint")


def main() -> None:
    scene, work, kills, seed = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    moments = random.Random(seed)
    unbroken = work / "unbroken"
    # What a run imports when it builds its parts; building starts no threads.
    torch.set_num_threads(1)
    config = config_of(scene, unbroken)
    Session(config.dataset.build(config.data).load(), config)
    began = time.monotonic()
    if attempt(config_of(scene, unbroken), unbroken, None, None) != 0:
        sys.exit("the unbroken run failed")
    seconds = time.monotonic() - began
    unwritten = until_first_checkpoint(unbroken)
    counts = dict.fromkeys(("kills", "resumed", "started_again", "runs"), 0)
    report = {"seconds": seconds, **counts, "broken": [], "different": []}
    number, folder, resume = 0, work / "run-0", None
    while report["kills"] < kills or resume is not None:
        config = config_of(scene, folder) if resume is None else read_config(folder / CONFIG_NAME)
        last = report["kills"] >= kills
        # Loading and starting take most of so small a run; of the kills they get a fifth.
        written = moments.random() > 0.2
        # The first run is the slowest: most later ones would end before they are killed.
        kill_after = moments.uniform(0.0, 0.6 * (seconds - unwritten) if written else unwritten)
        code = attempt(config, folder, resume, None if last else kill_after, written=written and not last)
        report["broken"] += broken_files(folder)
        if code is None:
            report["kills"] += 1
        elif code != 0:
            report["broken"].append(f"attempt ended with {code}")
        if code == 0 and run_status(folder) == "finished":
            report["runs"] += 1
            if (folder / "mesh.ply").read_bytes() != (unbroken / "mesh.ply").read_bytes():
                report["different"].append(f"{folder.name}: mesh.ply")
            if final(folder) != final(unbroken):
                report["different"].append(f"{folder.name}: metrics.json")
            report["broken"] += [str(path) for path in folder.rglob("*.partial")]
            if not (folder / "report.html").exists():
                report["broken"].append(f"{folder.name}: no report.html")
        if code is None and (folder / CHECKPOINTS / FILE_NAME).exists():
            resume = folder
            report["resumed"] += 1
        else:
            # Finished, or killed before there was anything to go on from.
            report["started_again"] += code is None
            number, resume = number + 1, None
            folder = work / f"run-{number}"
    sys.stdout.write(json.dumps(report) + "\n")


if __name__ == "__main__":
    main()
