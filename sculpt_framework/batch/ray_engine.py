"""Runs as tasks of a Ray cluster; without one, of a cluster that is this machine."""

import os
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from sculpt_framework.batch.carrier import carry
from sculpt_framework.errors import ConfigError, DeviceError
from sculpt_framework.experiments.launching import KILLED, Engine, Job, Order

_STORE_BYTES = 80 << 20
"""Of shared memory for a cluster of our own: tasks return a number each, Ray would take a third of the machine."""


class RayEngine(Engine):
    """Each run is a task of Ray with so many CPUs and GPUs; Ray decides where. Retries are the caller's."""

    def __init__(self, *, address: str | None, cpus_per_run: int, gpus_per_run: int):
        """Connect to the cluster at ``address`` or in RAY_ADDRESS, or start one.

        Raises ConfigError if Ray is not installed or there is no such cluster, DeviceError if no machine of the cluster
        is large enough for a run.
        """
        # Nothing is sent anywhere unless the user has said so.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        self._ray = _import_ray()
        own = address is None and not os.environ.get("RAY_ADDRESS")
        options = {"object_store_memory": _STORE_BYTES, "include_dashboard": False} if own else {"address": address}
        try:
            self._ray.init(log_to_driver=False, logging_level="ERROR", **options)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise ConfigError(f"--engine ray: no cluster could be reached or started ({error}).") from error
        self._environment = {"OMP_NUM_THREADS": str(cpus_per_run)}
        self._run = self._ray.remote(num_cpus=cpus_per_run, num_gpus=gpus_per_run, max_retries=0)(carry)
        largest = self._largest("CPU"), self._largest("GPU")
        if largest[0] < cpus_per_run or largest[1] < gpus_per_run:
            self.close()
            raise DeviceError(
                f"--engine ray: a run needs {cpus_per_run} CPUs and {gpus_per_run} GPUs of one machine; the largest "
                f"has {largest[0]:g} and {largest[1]:g}. Lower --cpus-per-run or --gpus-per-run."
            )
        self._needs = {"CPU": cpus_per_run, "GPU": gpus_per_run}

    @property
    def room(self) -> int:
        """How many runs the cluster has room for at a time."""
        whole: Mapping[str, float] = self._ray.cluster_resources()
        return max(1, min(int(whole.get(kind, 0.0) / each) for kind, each in self._needs.items() if each > 0))

    def start(self, order: Order) -> Job:
        environment = {**self._environment, **order.environment}
        task = self._run.options(name=order.name).remote(order.command, str(order.log.absolute()), environment)
        return _RayJob(self._ray, task)

    def close(self) -> None:
        self._ray.shutdown()

    def _largest(self, kind: str) -> float:
        return max((node["Resources"].get(kind, 0.0) for node in self._ray.nodes() if node["Alive"]), default=0.0)


class _RayJob(Job):
    def __init__(self, ray: ModuleType, task: Any):
        self._ray = ray
        self._task = task
        self._code: int | None = None

    def poll(self) -> int | None:
        if self._code is None:
            done, _ = self._ray.wait([self._task], timeout=0)
            if done:
                self._code = self._result()
        return self._code

    def interrupt(self) -> None:
        self._ray.cancel(self._task, force=False)

    def kill(self) -> None:
        self._ray.cancel(self._task, force=True)

    def _result(self) -> int:
        """Whatever took the worker down, or kept it from starting, has killed the run."""
        try:
            return self._ray.get(self._task)
        except self._ray.exceptions.RayError:
            return KILLED


def _import_ray() -> ModuleType:
    try:
        import ray
    except ImportError as error:
        raise ConfigError(f"--engine ray needs Ray ({error}): pip install 'gaussian-sculpting[ray]'.") from error
    return ray
