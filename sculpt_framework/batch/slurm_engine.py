"""Runs as jobs of Slurm, handed in by submitit; or of its stand-in that starts them on this machine."""

import io
import shutil
from collections.abc import Mapping
from contextlib import redirect_stderr
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from sculpt_framework.batch.carrier import carry
from sculpt_framework.errors import ConfigError, JobRefusedError
from sculpt_framework.experiments.launching import KILLED, Engine, Job, Order

Executor = Literal["slurm", "local"]
OUR_PARAMETERS = ("name", "job_name", "cpus_per_task", "gpus_per_node", "timeout_min", "time")


class SlurmEngine(Engine):
    """Each run is a job of its own, so that it waits for its own resources only. Retries are the caller's."""

    def __init__(
        self,
        folder: Path,
        *,
        executor: Executor,
        cpus_per_run: int,
        gpus_per_run: int,
        minutes: int,
        parameters: Mapping[str, str],
    ):
        """``folder`` is for submitit's own files, on a file system that all machines see; ``minutes`` is the longest a
        job may take. ``parameters`` are sbatch's, by their long names without dashes. Raises ConfigError if submitit is
        not installed, if there is no sbatch or srun, or if a parameter is not for the user to set.
        """
        submitit = _import_submitit()
        for program in ("sbatch", "srun") if executor == "slurm" else ():
            if shutil.which(program) is None:
                raise ConfigError(
                    f"--engine slurm: there is no {program} on this machine; start it on a login node of the cluster, "
                    "or try it with --slurm-executor local."
                )
        for name in parameters:
            if name.replace("-", "_") in OUR_PARAMETERS:
                raise ConfigError(
                    f"--slurm {name}=...: it follows from the other options (--cpus-per-run, --gpus-per-run, "
                    "--slurm-minutes); leave it out."
                )
        self._executor = submitit.AutoExecutor(folder=folder, cluster=executor)
        self._executor.update_parameters(
            name="sculpt",
            cpus_per_task=cpus_per_run,
            gpus_per_node=gpus_per_run,
            timeout_min=minutes,
            slurm_additional_parameters={
                **{name.replace("-", "_"): value for name, value in parameters.items()},
                # It is the caller who tries again, from the checkpoint.
                "no_requeue": True,
            },
        )
        self._environment = {"OMP_NUM_THREADS": str(cpus_per_run)}

    def start(self, order: Order) -> Job:
        environment = {**self._environment, **order.environment}
        try:
            # submitit prints what sbatch said, and then raises it.
            with redirect_stderr(io.StringIO()):
                job = self._executor.submit(carry, order.command, str(order.log.absolute()), environment)
        except RuntimeError as error:
            raise JobRefusedError(
                f"--engine slurm: sbatch takes no job ({error}); mend --slurm or --slurm-minutes, or lower --workers."
            ) from error
        return _SlurmJob(job)

    def close(self) -> None:
        pass


class _SlurmJob(Job):
    def __init__(self, job: Any):
        self._job = job
        self._code: int | None = None

    def poll(self) -> int | None:
        if self._code is None and self._job.done():
            self._code = self._result()
        return self._code

    def interrupt(self) -> None:
        if self.poll() is None:
            self._job.cancel()

    def kill(self) -> None:
        # scancel asks first and kills after the cluster's own grace; there is no harder word for a job elsewhere.
        self.interrupt()

    def _result(self) -> int:
        """A job that left no result, for whatever reason, was killed. submitit's own log beside says by whom."""
        try:
            return self._job.result()
        except Exception:
            return KILLED


def _import_submitit() -> ModuleType:
    try:
        import submitit
    except ImportError as error:
        raise ConfigError(
            f"--engine slurm needs submitit ({error}): pip install 'gaussian-sculpting[slurm]'."
        ) from error
    return submitit
