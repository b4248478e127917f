"""Runs of several processes for tests: forked off one that has imported everything, so that none costs a start.

    python ranks.py SCENE_FOLDER WORK_FOLDER JSON

JSON is a list of jobs, each {"name", "processes", "resume": name of a job, "kill": [rank, outer step, share of it],
"changes"}, all but the first two optional.
Prints a JSON list of {"codes", "said", "numbers"}, by rank: exit codes, minus the signal, what was said, and process
numbers. No job computes in this process, as threads would not survive the fork.
"""

import json
import os
import signal
import sys
import time
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist

sys.path.insert(0, str(Path(__file__).parent))

from small_runs import ONE_STAGE, small_config

from sculpt_framework.cli import exit_codes
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.run import run
from sculpt_framework.parallel import ranks
from sculpt_framework.reconstructor import Moment
from sculpt_framework.sculpting.method import Sculpting
from sculpt_framework.serialization import read_config
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig


def main() -> None:
    scene, work = sys.argv[1], Path(sys.argv[2])
    sys.stdout.write(json.dumps([do(job, scene, work) for job in json.loads(sys.argv[3])]))


def do(job: dict[str, Any], scene: str, work: Path) -> dict[str, Any]:
    count = job["processes"]
    store = dist.TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False, timeout=timedelta(seconds=60))
    children = []
    for rank in range(count):
        child = os.fork()
        if child == 0:
            os._exit(work_as(rank, count, store.port, job, scene, work))
        children.append(child)
    codes: dict[int, int] = {}
    while len(codes) < count:
        child, status = os.wait()
        rank = children.index(child)
        codes[rank] = os.waitstatus_to_exitcode(status)
        if codes[rank] < 0:
            # As torchrun does to those that are left.
            for other in range(count):
                if other not in codes:
                    os.kill(children[other], signal.SIGTERM)
    said = [(work / f"{job['name']}-{rank}.log").read_text(encoding="utf-8") for rank in range(count)]
    return {
        "codes": [codes[rank] for rank in range(count)],
        "said": said,
        "numbers": children,
    }


def work_as(rank: int, count: int, port: int, job: dict[str, Any], scene: str, work: Path) -> int:
    """What a process does; its exit code."""
    log = os.open(work / f"{job['name']}-{rank}.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    if count > 1:
        names = {"RANK": rank, "WORLD_SIZE": count, "LOCAL_RANK": rank, "LOCAL_WORLD_SIZE": count}
        os.environ.update({name: str(value) for name, value in names.items()})
        os.environ.update(MASTER_ADDR="127.0.0.1", MASTER_PORT=str(port), TORCHELASTIC_USE_AGENT_STORE="True")
    torch.set_num_threads(1)
    if job.get("kill") and job["kill"][0] == rank:
        kill_at(*job["kill"][1:])
    resume = None if job.get("resume") is None else work / job["resume"]
    config = config_of(job, scene, work) if resume is None else read_config(resume / "config.json")
    try:
        exit_codes.run(lambda: run(config, resume=resume, started=time.monotonic()))
    except SystemExit as error:
        return int(error.code or 0)
    except BaseException as error:
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        sys.stderr.flush()
        return 70
    finally:
        sys.stdout.flush()
    return 0


def kill_at(outer: int, share: float) -> None:
    """Die within the outer step after so many, before its first sum (share 0) or its last (share 1)."""
    settle, reduce, calls = Sculpting.settle, ranks.Ranks.reduce, -1

    def settling(self: Sculpting, moment: Moment) -> None:
        nonlocal calls
        if moment.step == outer:
            calls = 0
        settle(self, moment)

    def dying(self: ranks.Ranks, *given: Any) -> Any:
        nonlocal calls
        # A step of these runs adds up twice: one inner step of two views, then the outer one.
        if calls >= 0:
            calls += 1
        if calls > share:
            os.kill(os.getpid(), signal.SIGKILL)
        return reduce(self, *given)

    Sculpting.settle, ranks.Ranks.reduce = settling, dying


def config_of(job: dict[str, Any], scene: str, work: Path) -> MethodConfig:
    changes: dict[str, Any] = {"steps": 6, "stages": ONE_STAGE, "inner_batch": 2, "checkpoint_seconds": 1e6}
    return small_config(
        data=scene,
        dataset=BlenderConfig(),
        observers=(RecorderConfig(step_seconds=0.0),),
        output=work / job["name"],
        threads=1,
        device="cpu",
        **{**changes, **job.get("changes", {})},
    )


if __name__ == "__main__":
    main()
