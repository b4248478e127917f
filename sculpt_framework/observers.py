"""Slot ``observers``: who hears what training does. The trainer knows events only, never who listens."""

from abc import ABC, abstractmethod

from sculpt_framework.engine.events import Event


class Observer(ABC):
    @property
    @abstractmethod
    def snapshot_seconds(self) -> float | None:
        """Least training seconds between "snapshot" events; None: this observer wants none, and none costs nothing."""

    @abstractmethod
    def notify(self, event: Event) -> None:
        """Called in the training thread for every event, in order; must return at once."""

    @abstractmethod
    def close(self) -> None:
        """Called once, after the last event, also when training failed."""
