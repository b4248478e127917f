"""Processes that torchrun has started, on one machine or several, by torch.distributed."""

import json
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from jaxtyping import Int64
from torch import Tensor
from torch.distributed.distributed_c10d import PrefixStore, Store

from sculpt_framework.child_processes import die_with_parent
from sculpt_framework.errors import ConfigError, DeviceError
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.parallel.processes import Processes, ProcessLost, Value

_VARIABLES = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
_PATIENCE = timedelta(minutes=10)
"""How long to wait for a process that is there but says nothing: it may be carving, or measuring a large mesh."""
_ROLL_CALL_SECONDS = 5.0
_MESSAGE_BYTES = 4096
"""Of the messages that need no second one to say the rest."""


@dataclass(frozen=True, kw_only=True)
class _Member:
    host: str
    process: int


class Ranks(Processes):
    """The processes of one torchrun: gloo among CPUs and for what is said, NCCL among CUDA devices."""

    def __init__(self, environment: Mapping[str, str], device: torch.device):
        """Waits for all of them. Raises ConfigError and DeviceError as ``gather``."""
        missing = [name for name in _VARIABLES if not environment.get(name)]
        if missing:
            raise ConfigError(
                f"WORLD_SIZE is {environment['WORLD_SIZE']}, but {', '.join(missing)} is not set; start several "
                "processes as torchrun --nproc-per-node N -m sculpt_framework.cli.train METHOD ..."
            )
        self._rank, self._count = int(environment["RANK"]), int(environment["WORLD_SIZE"])
        self._device = device
        if device.type == "cuda":
            self._take_device(int(environment["LOCAL_RANK"]), int(environment["LOCAL_WORLD_SIZE"]))
        # A process without the launcher that would note its end would train on unseen.
        die_with_parent()
        self._store = _store(environment, self._rank, self._count)
        self._members: list[_Member] = []
        with self._watched():
            dist.init_process_group(
                "cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo",
                store=PrefixStore("group", self._store),
                rank=self._rank,
                world_size=self._count,
                timeout=_PATIENCE,
            )
        self._members = self._introduce()

    @property
    def count(self) -> int:
        return self._count

    @property
    def leads(self) -> bool:
        return self._rank == 0

    def share(self, views: int) -> range:
        return range(self._rank, views, self._count)

    def reduce(self, parameters: Sequence[Tensor], terms: Mapping[str, float]) -> dict[str, float]:
        gradients = [parameter.grad for parameter in parameters]
        there = torch.tensor([float(gradient is not None) for gradient in gradients], device=self._device)
        values = torch.tensor(list(terms.values()), dtype=torch.float32, device=self._device)
        parts = [
            (torch.zeros_like(parameter) if gradient is None else gradient).flatten()
            for parameter, gradient in zip(parameters, gradients, strict=True)
        ]
        # One message for all: each costs a round through all processes, however short it is.
        flat = torch.cat([*parts, there, values])
        with self._watched():
            if self._device.type == "cuda":
                # NCCL waits for the dead without end; gloo, which is asked first, notices.
                dist.all_reduce(torch.zeros(1))
            dist.all_reduce(flat)
        *summed, there, values = flat.split([len(part) for part in (*parts, there, values)])
        for parameter, total, known in zip(parameters, summed, there.tolist(), strict=True):
            parameter.grad = total.view_as(parameter) if known > 0 else None
        return dict(zip(terms, values.tolist(), strict=True))

    def equalize(self, tensors: Sequence[Tensor]) -> None:
        with self._watched(), torch.no_grad():
            for tensor in tensors:
                dist.broadcast(tensor, src=0)

    def align(self, tensors: Sequence[Tensor]) -> None:
        if self._device.type == "cuda":
            self.equalize(tensors)

    def first(self, make: Callable[[], Value]) -> Value:
        if not self.leads:
            return self._hear()
        try:
            value = make()
        except Exception as error:
            self._tell({"error": str(error), "unstable": isinstance(error, (FloatingPointError, EmptySurfaceError))})
            raise
        self._tell({"value": value})
        return value

    def in_turn(self, make: Callable[[], Value]) -> Value:
        made: list[Value] = []
        self.first(lambda: made.append(make()))
        return made[0] if made else make()

    def require_same(self, keys: Int64[Tensor, " n"]) -> None:
        # Sums of keys wrap round, which is as good.
        digest = torch.stack([torch.tensor(len(keys)), keys.sum().cpu(), (keys * (2 * keys + 1)).sum().cpu()])
        extremes = torch.cat([digest, -digest])
        with self._watched():
            dist.all_reduce(extremes, op=dist.ReduceOp.MAX)
        if not torch.equal(extremes[:3], -extremes[3:]):
            raise ProcessLost(
                "the processes have come apart: they extracted different surfaces from the same field. Run them on "
                "machines of one kind, with the same versions and the same --threads."
            )

    def close(self) -> None:
        # Together: one that goes early is to the others as one that has died.
        with self._watched():
            dist.barrier()
        dist.destroy_process_group()

    # -- what is said --------------------------------------------------------------------------------------------

    def _tell(self, message: Mapping[str, Any]) -> None:
        said = json.dumps(message, default=float).encode()
        head = torch.zeros(_MESSAGE_BYTES, dtype=torch.uint8)
        head[:8] = torch.tensor(list(len(said).to_bytes(8, "little")), dtype=torch.uint8)
        body = torch.tensor(list(said), dtype=torch.uint8)
        fitting = _MESSAGE_BYTES - 8
        head[8 : 8 + min(len(said), fitting)] = body[:fitting]
        with self._watched():
            dist.broadcast(head, src=0)
            if len(said) > fitting:
                dist.broadcast(body[fitting:].clone(), src=0)

    def _hear(self) -> Any:
        head = torch.zeros(_MESSAGE_BYTES, dtype=torch.uint8)
        with self._watched():
            dist.broadcast(head, src=0)
            length = int.from_bytes(bytes(head[:8].tolist()), "little")
            said = head[8 : 8 + length]
            if length > len(said):
                rest = torch.zeros(length - len(said), dtype=torch.uint8)
                dist.broadcast(rest, src=0)
                said = torch.cat([said, rest])
        message = json.loads(bytes(said.tolist()))
        if "value" in message:
            return message["value"]
        if message["unstable"]:
            raise FloatingPointError(message["error"])
        raise ProcessLost(f"the first process failed: {message['error']}")

    # -- who is there --------------------------------------------------------------------------------------------

    def _take_device(self, local: int, processes: int) -> None:
        devices = torch.cuda.device_count()
        if devices < processes:
            raise DeviceError(
                f"{processes} processes on {socket.gethostname()}, which has {devices} CUDA devices; give "
                f"--nproc-per-node {devices}, or --device cpu."
            )
        torch.cuda.set_device(local)

    def _introduce(self) -> list[_Member]:
        own = {"host": socket.gethostname(), "process": os.getpid()}
        self._store.set(f"member/{self._rank}", json.dumps(own))
        return [_Member(**json.loads(self._store.get(f"member/{rank}"))) for rank in range(self._count)]

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """What torch says when a process is gone tells neither which nor what to do."""
        try:
            yield
        except RuntimeError as error:
            raise ProcessLost(f"{self._who_is_gone(error)}; --resume goes on from the checkpoint") from error

    def _who_is_gone(self, error: Exception) -> str:
        """Who has died, or, on other machines, does not notice within some seconds that somebody has."""
        deadline, absent = time.monotonic() + _ROLL_CALL_SECONDS, list(range(len(self._members)))
        # The end of a process shows later than that of its connections.
        while not (dead := self._dead_here()) and absent and time.monotonic() < deadline:
            absent = self._absent(absent)
            time.sleep(0.05)
        if dead:
            return "; ".join(f"{self._name(rank)} has died" for rank in dead)
        if absent:
            return "; ".join(f"{self._name(rank)} does not answer" for rank in absent)
        return f"the {self._count} processes have lost touch ({str(error).splitlines()[0]})"

    def _name(self, rank: int) -> str:
        member = self._members[rank]
        return f"process {rank} of {self._count} (number {member.process} on {member.host})"

    def _dead_here(self) -> list[int]:
        here = socket.gethostname()
        return [
            rank
            for rank, member in enumerate(self._members)
            if member.host == here and rank != self._rank and not _is_alive(member.process)
        ]

    def _absent(self, ranks: Sequence[int]) -> list[int]:
        """Of these, those that have not answered this call yet."""
        try:
            self._store.set(f"here/{self._rank}", "")
            return [rank for rank in ranks if not self._store.check([f"here/{rank}"])]
        except RuntimeError:
            return [0]  # It has the store, where no launcher has it.


def _store(environment: Mapping[str, str], rank: int, count: int) -> Store:
    """torchrun's own, which outlives any process of the job; without torchrun, the first process's."""
    launched = environment.get("TORCHELASTIC_USE_AGENT_STORE") == "True"
    try:
        # Public by torch's documents, though not by its code.
        store = dist.TCPStore(  # pyright: ignore[reportPrivateImportUsage]
            environment["MASTER_ADDR"],
            int(environment["MASTER_PORT"]),
            count,
            is_master=rank == 0 and not launched,
            timeout=_PATIENCE,
            wait_for_workers=False,
        )
    except (RuntimeError, ValueError, TypeError) as error:
        address, said = f"{environment['MASTER_ADDR']}:{environment['MASTER_PORT']}", str(error).splitlines()[0]
        raise ConfigError(f"the processes cannot meet at {address}, MASTER_ADDR and MASTER_PORT ({said}).") from error
    return PrefixStore(f"sculpt/{environment.get('TORCHELASTIC_RESTART_COUNT', '0')}", store)


def _is_alive(process: int) -> bool:
    """Whether a process of this machine works; one that nobody has asked for its end yet does not."""
    if sys.platform == "win32":  # Where signal 0 is Ctrl-C.
        import psutil

        return psutil.pid_exists(process)
    try:
        os.kill(process, 0)
        state = Path(f"/proc/{process}/stat")
        return not state.exists() or state.read_text("utf-8", "replace").rsplit(")", 1)[1].split()[0] not in "ZX"
    except (ProcessLookupError, FileNotFoundError):
        return False
    except PermissionError:
        return True
