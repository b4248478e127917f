"""Who is told how far a posing is."""

from abc import ABC, abstractmethod


class Announcer(ABC):
    @abstractmethod
    def step(self, name: str, done: int, total: int) -> None:
        """So many of so many are done in a step; a step ends when all are or when another begins."""

    @abstractmethod
    def say(self, line: str) -> None:
        """Something that stays to be read."""
