"""Slot ``observers``: who hears what training does. The trainer knows events only, never who listens."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from sculpt_framework.commands import Command
from sculpt_framework.events import Event


class Observer(ABC):
    @property
    @abstractmethod
    def snapshot_seconds(self) -> float | None:
        """Least seconds between "snapshot" events; None: this observer wants none, and none costs nothing."""

    @abstractmethod
    def notify(self, event: Event) -> None:
        """Called in the training thread for every event, in order; must return at once."""

    @abstractmethod
    def close(self) -> None:
        """Called once, after the last event, also when training failed."""


class SteeringObserver(Observer):
    """An observer that also tells the run what to do."""

    @abstractmethod
    def take_commands(self) -> Sequence[Command]:
        """What has been asked for since the last call. Called in the training thread between two steps; must return
        at once."""
