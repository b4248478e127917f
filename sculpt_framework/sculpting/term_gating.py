"""Terms of an objective that have had no effect for long rest, and are looked at again now and then."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

_NOTHING = 1e-4
"""Share of the objective up to which a term has no effect."""


class TermGating:
    """Counts, so that whether a term is evaluated depends on the steps and not on the clock."""

    def __init__(self, after: int):
        """``after``: evaluations without effect before a term rests, and calls between two looks at it; 0: never."""
        self._after = after
        self._idle: dict[str, int] = {}
        self._calls: dict[str, int] = {}
        self._told: list[dict[str, Any]] = []
        self.spared: dict[str, int] = {}
        """Evaluations that were left out, by term."""

    def due(self, name: str) -> bool:
        """Whether the term is to be evaluated this time."""
        if self._after == 0 or self._idle.get(name, 0) < self._after:
            return True
        self._calls[name] = self._calls.get(name, 0) + 1
        if self._calls[name] % self._after == 0:
            return True
        self.spared[name] = self.spared.get(name, 0) + 1
        return False

    def saw(self, name: str, value: float, objective: float) -> None:
        """The weighted term's value, just evaluated, beside the objective it is part of."""
        if self._after == 0:
            return
        before, effect = self._idle.get(name, 0), abs(value) > _NOTHING * abs(objective)
        self._idle[name] = 0 if effect else before + 1
        measured = {"term": value, "objective": objective, "evaluations": before}
        if effect and before >= self._after:
            self._told.append({"item": name, "value": "acts again", **measured})
        if not effect and before + 1 == self._after:
            self._calls[name] = 0
            self._told.append({"item": name, "value": "rests: it has had no effect", **measured})

    def news(self) -> list[dict[str, Any]]:
        """What has come to rest or woken since the last call, as data of events."""
        told, self._told = self._told, []
        return told

    def state(self) -> dict[str, Tensor]:
        """For a checkpoint."""
        return {
            name: torch.tensor([idle, self._calls.get(name, 0), self.spared.get(name, 0)])
            for name, idle in self._idle.items()
        }

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``."""
        rows = {name: tensor.tolist() for name, tensor in state.items()}
        self._idle = {name: row[0] for name, row in rows.items()}
        self._calls = {name: row[1] for name, row in rows.items()}
        self.spared = {name: row[2] for name, row in rows.items()}
