"""One object, several processes: which views each renders, and how what they found is put together.

Every process holds the whole state and takes the same steps: it draws the same views and backgrounds, renders its share
of them, and after the gradients of the Gaussians are added up each has the same ones, to the last bit, carries them on
and does the same update. What depends on a clock, or is measured, the first process decides for all.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import torch
from jaxtyping import Int64
from torch import Tensor

from sculpt_framework.commands import Command, ExportMesh, TakeSnapshot, command_from_json, command_to_json
from sculpt_framework.errors import TrainingFailed

Value = TypeVar("Value")


class ProcessLost(TrainingFailed):
    """A process of this job has died or does not answer, which the message names, or they do not fit together."""


class Processes(ABC):
    """The processes that work on one object, seen from one of them.

    All must call the same methods in the same order; each call but ``share`` waits for the others. Every method but
    ``share`` raises ProcessLost where another process is gone.
    """

    @property
    @abstractmethod
    def count(self) -> int:
        """How many there are."""

    @property
    @abstractmethod
    def leads(self) -> bool:
        """Whether this is the first one: it writes, measures and talks to people."""

    @abstractmethod
    def share(self, views: int) -> range:
        """Which of so many views, by their numbers from 0, this process renders; each is one process's."""

    @abstractmethod
    def reduce(self, parameters: Sequence[Tensor], terms: Mapping[str, float]) -> dict[str, float]:
        """Add up over the processes the gradients of ``parameters``, in place, and the terms, which are returned.

        A parameter without a gradient in any process is left without. Parameters have the same sizes everywhere, and
        terms the same names.
        """

    @abstractmethod
    def equalize(self, tensors: Sequence[Tensor]) -> None:
        """Give these tensors everywhere the values that they have in the first process."""

    @abstractmethod
    def align(self, tensors: Sequence[Tensor]) -> None:
        """``equalize`` where devices add up in no fixed order (CUDA), so that the same steps round differently."""

    @abstractmethod
    def first(self, make: Callable[[], Value]) -> Value:
        """What the first process makes, which alone calls ``make``: JSON values, lists where it made tuples.

        An error is raised there, and in the others FloatingPointError if it told of an unstable state, else
        ProcessLost.
        """

    @abstractmethod
    def in_turn(self, make: Callable[[], Value]) -> Value:
        """What each process makes for itself, the first before the others: it may leave them something on disk."""

    @abstractmethod
    def require_same(self, keys: Int64[Tensor, " n"]) -> None:
        """Raise ProcessLost unless the keys are the same everywhere: what is added up would not belong together."""

    @abstractmethod
    def close(self) -> None:
        """Part, after the last call."""


class Alone(Processes):
    """The one process there usually is: nothing is exchanged, nothing is imported for it."""

    @property
    def count(self) -> int:
        return 1

    @property
    def leads(self) -> bool:
        return True

    def share(self, views: int) -> range:
        return range(views)

    def reduce(self, parameters: Sequence[Tensor], terms: Mapping[str, float]) -> dict[str, float]:
        return dict(terms)

    def equalize(self, tensors: Sequence[Tensor]) -> None:
        pass

    def align(self, tensors: Sequence[Tensor]) -> None:
        pass

    def first(self, make: Callable[[], Value]) -> Value:
        return make()

    def in_turn(self, make: Callable[[], Value]) -> Value:
        return make()

    def require_same(self, keys: Int64[Tensor, " n"]) -> None:
        pass

    def close(self) -> None:
        pass


def gather(environment: Mapping[str, str], device: torch.device) -> Processes:
    """The processes of this job: those that torchrun has started, as its variables in ``environment`` say, else one.

    Raises ConfigError where the variables are incomplete, DeviceError where there are fewer CUDA devices on a machine
    than processes.
    """
    if int(environment.get("WORLD_SIZE") or 1) < 2:
        return Alone()
    from sculpt_framework.parallel.ranks import Ranks

    return Ranks(environment, device)


def shared_commands(
    sources: Sequence[Callable[[], Sequence[Command]]], processes: Processes
) -> Sequence[Callable[[], Sequence[Command]]]:
    """Sources of commands from which every process takes those that the first one is given.

    The others leave out what only writes or shows something.
    """
    if processes.count == 1:
        return sources

    def take() -> Sequence[Command]:
        said = processes.first(lambda: [command_to_json(command) for source in sources for command in source()])
        commands = [command_from_json(value) for value in said]
        return [each for each in commands if processes.leads or not isinstance(each, (ExportMesh, TakeSnapshot))]

    return [take]
