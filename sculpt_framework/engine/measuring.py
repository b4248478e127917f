"""A run measured while it trains: the rows of its curve, and what they cost."""

from collections.abc import Callable, Mapping
from typing import Any, Literal

import torch

from sculpt_framework.engine.clock import TrainingClock
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.evaluation.evaluator import Evaluator
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.events import EventName
from sculpt_framework.parallel.processes import Processes
from sculpt_framework.reconstructor import Reconstructor


class Measuring:
    """Adds rows to the curve and tells them. The clock stands still meanwhile; one process measures for all."""

    def __init__(
        self,
        evaluator: Evaluator,
        clock: TrainingClock,
        milestones: Milestones,
        processes: Processes,
        tell: Callable[[EventName, Mapping[str, Any]], None],
    ):
        self._evaluator, self._clock, self._tell = evaluator, clock, tell
        self.milestones, self.processes = milestones, processes

    def due(self, progress: float) -> Literal["stage", "share", "time"] | None:
        """Why a measurement is due now, if one is."""
        return self.processes.first(lambda: self.milestones.due(progress, self._clock.train_seconds))

    def start(self, make: Callable[[], tuple[Mesh, Mapping[str, Any]] | None]) -> None:
        """A row of what an initializer has made, if there is time for one."""
        if self.processes.first(self.milestones.start_due):
            self._add("start", 0.0, lambda: self._evaluator.measure_start(make))

    def method(self, reason: str, progress: float, method: Reconstructor) -> None:
        """A row of what the method has; of the result, all there is to measure."""
        measure = self._evaluator.measure_result if reason == "result" else self._evaluator.measure
        self._add(reason, progress, lambda: measure(method))

    def _add(self, reason: str, progress: float, measure: Callable[[], dict[str, Any] | None]) -> None:
        began = self._clock.now
        with self._clock.pause(), torch.no_grad():
            measured = self.processes.first(measure)
        self.milestones.charge(seconds := self._clock.now - began)
        if measured is not None:
            clock = self._clock
            seconds_so_far = {
                "t_train_s": clock.train_seconds,
                "t_wall_s": clock.wall_seconds,
                "t_cpu_s": clock.cpu_seconds,
            }
            row = {"reason": reason, "progress": progress, **seconds_so_far, **measured}
            self.milestones.add(progress, row)
            self._tell("evaluation", {**row, "seconds": seconds})
