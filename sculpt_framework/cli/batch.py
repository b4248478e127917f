"""``sculpt-batch``: a reconstruction of every scene of a folder or list, on this machine or on a cluster."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.cli.ablate import split_extra
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError

if TYPE_CHECKING:
    from sculpt_framework.experiments.launching import Engine

PROGRAM = "sculpt-batch"
SLURM_WORKERS = 64
"""Jobs in the queue at a time where the user does not say."""


@dataclass(frozen=True, kw_only=True)
class BatchRequest:
    """Reconstruct many scenes: one run per scene, failures isolated, going on where an earlier call ended.

    Options of sculpt-train for all runs follow after --, as in: sculpt-batch scans gaussian-sculpting --workers 2 --
    --max-time 300
    """

    scenes: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE_DIR_OR_LIST")]
    """A folder with a folder per scene, or a file with a scene per line."""
    method: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="METHOD")]
    """The method, as for sculpt-train."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Where runs, tables and the report go. Default: outputs/batch-NAME. What has finished there is not run again."""
    engine: Literal["local", "ray", "slurm"] = "local"
    """Where runs are started: on this machine, by Ray, or as jobs of Slurm. All must see the scenes and --out."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """Runs at a time. Default: 1 on this machine; with Ray as many as there is room for; with Slurm 64."""
    cpus_per_run: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """CPU cores of each run. Default: on this machine the cores shared by the workers; elsewhere 2."""
    gpus_per_run: Annotated[int, tyro.conf.arg(metavar="G")] = 0
    """GPUs of each run; from 2 on a run has a process for each. 0: what a run finds where it is started."""
    retries: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """How often a run that was killed or crashed is tried again, from its checkpoint if it has one."""
    retry_failed: Flag = False
    """Run again what failed in an earlier call."""
    show: Flag = False
    """Run nothing; tables and report of what there is."""
    ray_address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None
    """Cluster to use. Default: that of RAY_ADDRESS, else one that is this machine."""
    slurm: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE", help_behavior_hint="")] = ()
    """Options of sbatch, as partition=long account=lab."""
    slurm_minutes: Annotated[int, tyro.conf.arg(metavar="N")] = 240
    """The longest a job may take."""
    slurm_executor: Literal["slurm", "local"] = "slurm"
    """local: submitit's stand-in for Slurm on this machine, to try a batch without a cluster."""


def main() -> None:
    """The console script ``sculpt-batch``."""
    exit_codes.run(lambda: batch(sys.argv[1:]))


def batch(words: Sequence[str]) -> None:
    """Run, print, write. Raises SculptError, and TrainingFailed with the names of scenes that failed."""
    own, extra = split_extra(words)
    request = tyro.cli(BatchRequest, args=own, prog=PROGRAM)
    _check(request)

    from sculpt_framework.batch.outcome import batch_tables, require_all, write_report
    from sculpt_framework.batch.scenes import batch_matrix, check_options, find_scenes
    from sculpt_framework.experiments.carry_out import carry_out
    from sculpt_framework.experiments.matrix import folder_name
    from sculpt_framework.experiments.runner import TRAIN

    check_options(extra)
    scenes = find_scenes(request.scenes)
    matrix = batch_matrix(scenes, request.method, extra)
    out = (request.out or Path("outputs") / f"batch-{folder_name(Path(request.scenes).stem)}").absolute()
    with _engine(request, out) as (engine, workers):
        results = carry_out(
            matrix,
            out,
            batch_tables,
            asked=(PROGRAM, *words),
            jobs=workers,
            retry_failed=request.retry_failed,
            run=not request.show,
            retries=request.retries,
            command=TRAIN if request.gpus_per_run < 2 else _many_processes(request.gpus_per_run),
            engine=engine,
        )
    page = write_report(results, out, matrix.title)
    if page is not None:
        sys.stdout.write(f"report: {page}\n")
    if not request.show:
        require_all(results, out)


@contextmanager
def _engine(request: BatchRequest, out: Path) -> "Iterator[tuple[Engine | None, int]]":
    """The engine, and how many runs it is given at a time."""
    if request.show:
        yield None, 1
        return
    made, workers = _make_engine(request, out)
    try:
        yield made, workers
    finally:
        made.close()


def _make_engine(request: BatchRequest, out: Path) -> "tuple[Engine, int]":
    cpus = request.cpus_per_run or 2
    if request.engine == "ray":
        from sculpt_framework.batch.ray_engine import RayEngine

        ray = RayEngine(address=request.ray_address, cpus_per_run=cpus, gpus_per_run=request.gpus_per_run)
        return ray, request.workers or ray.room
    if request.engine == "slurm":
        from sculpt_framework.batch.slurm_engine import SlurmEngine

        slurm = SlurmEngine(
            out / "slurm",
            executor=request.slurm_executor,
            cpus_per_run=cpus,
            gpus_per_run=request.gpus_per_run,
            minutes=request.slurm_minutes,
            parameters=dict(_parameter(word) for word in request.slurm),
        )
        return slurm, request.workers or SLURM_WORKERS
    from sculpt_framework.experiments.launching import LocalEngine

    workers = request.workers or 1
    return LocalEngine(workers, gpus_per_run=request.gpus_per_run, cpus_per_run=request.cpus_per_run), workers


def _many_processes(gpus: int) -> tuple[str, ...]:
    """``sculpt-train`` with a process for each GPU of a run."""
    launcher = (sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(gpus))
    return (*launcher, "-m", "sculpt_framework.cli.train")


def _parameter(word: str) -> tuple[str, str]:
    name, equals, value = word.lstrip("-").partition("=")
    if not name or not equals:
        raise ConfigError(f"--slurm {word}: expected NAME=VALUE, as partition=long.")
    return name, value


def _check(request: BatchRequest) -> None:
    for name, value, least in (
        ("workers", request.workers, 1),
        ("cpus-per-run", request.cpus_per_run, 1),
        ("gpus-per-run", request.gpus_per_run, 0),
        ("retries", request.retries, 0),
        ("slurm-minutes", request.slurm_minutes, 1),
    ):
        if value is not None and value < least:
            raise ConfigError(f"--{name} is {value}; expected {least} or more.")
    if request.ray_address is not None and request.engine != "ray":
        raise ConfigError("--ray-address needs --engine ray.")
    if (request.slurm or request.slurm_executor != "slurm") and request.engine != "slurm":
        raise ConfigError("--slurm and --slurm-executor need --engine slurm.")


if __name__ == "__main__":
    main()
