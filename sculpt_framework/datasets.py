"""Slot ``dataset``: from what the user named to views, box and reference."""

from abc import ABC, abstractmethod

from sculpt_framework.types import Scene


class Dataset(ABC):
    @abstractmethod
    def load(self) -> Scene:
        """Read everything.

        Raises DataError with one clear line for anything missing, malformed or impossible to reconstruct.
        """
