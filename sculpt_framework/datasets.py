"""Slot ``dataset``: from what the user named to views, box and reference."""

from abc import ABC, abstractmethod

from sculpt_framework.types import Scene


class Dataset(ABC):
    @property
    def lacks_cameras(self) -> bool:
        """Whether ``load`` has to find cameras first, which takes minutes and leaves a folder beside the data."""
        return False

    @abstractmethod
    def load(self) -> Scene:
        """Read everything.

        Raises DataError with one clear line for anything missing, malformed or impossible to reconstruct.
        """
