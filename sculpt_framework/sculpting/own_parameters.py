"""What terms of the objectives learn themselves, beside surface and Gaussians: exposures, for example."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from sculpt_framework.adam import Adam
from sculpt_framework.losses import Term, TrainingImage


class OwnParameters:
    """Optimised, kept and restored by their position: terms come in the config's order, parameters in each term's."""

    def __init__(self, terms: Sequence[Term]):
        self._terms = terms
        self._optimizer: Adam | None = None
        self._saved: Mapping[str, Tensor] = {}
        """What is to be taken up once the terms have their parameters."""

    def begin(self, images: Sequence[TrainingImage]) -> None:
        """A stage begins. Terms make their parameters in the first one."""
        for term in self._terms:
            term.begin(images)
        if self._optimizer is None:
            groups = [group for term in self._terms for group in term.parameter_groups()]
            self._optimizer = Adam(groups) if groups else None
            self._take_up()

    @property
    def parameters(self) -> list[nn.Parameter]:
        return [] if self._optimizer is None else self._optimizer.parameters

    def zero_grad(self) -> None:
        if self._optimizer is not None:
            self._optimizer.zero_grad()

    def step(self, rate_factor: float) -> None:
        if self._optimizer is not None:
            self._optimizer.step(rate_factor)

    def state(self) -> dict[str, Tensor]:
        """Empty where no term has parameters."""
        if self._optimizer is None:
            return dict(self._saved)
        values = {f"value.{index}": value for index, value in enumerate(self.parameters)}
        return values | {f"moment.{name}": value for name, value in self._optimizer.state().items()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``. Raises KeyError, at the first stage at the latest, where it does not fit."""
        self._saved = {name: value.clone() for name, value in state.items()}
        self._take_up()

    def _take_up(self) -> None:
        if self._optimizer is None or not self._saved:
            return
        with torch.no_grad():
            for index, parameter in enumerate(self.parameters):
                parameter.copy_(self._saved[f"value.{index}"])
        moments = {name.removeprefix("moment."): value for name, value in self._saved.items() if name[0] == "m"}
        self._optimizer.load_state(moments)
