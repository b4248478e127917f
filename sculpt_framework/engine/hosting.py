"""Where a run stands, and what of it the session offers the method it hosts."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.checkpoint import Progress
from sculpt_framework.engine.clock import TrainingClock
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.engine.planning import split_views
from sculpt_framework.engine.schedule import Schedule
from sculpt_framework.evaluation.evaluator import Evaluator
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.events import Event, EventName
from sculpt_framework.parallel.processes import Processes
from sculpt_framework.reconstructor import Host
from sculpt_framework.types import Camera, Scene, View


class Hosting(Host):
    """Steps and time so far, the views to learn from and to judge by, the rows of the curve, and who is told.

    The clock stands still while something is measured; one process measures for all.
    """

    def __init__(
        self,
        scene: Scene,
        config: MethodConfig,
        *,
        clock: TrainingClock,
        processes: Processes,
        emit: Callable[[Event], None],
        saved: Progress | None,
    ):
        """``saved`` is where a run that is resumed stood."""
        self.config, self.clock, self.processes, self._emit = config, clock, processes, emit
        self.step = 0 if saved is None else saved.outer
        """Steps taken."""
        self.schedule = Schedule(config.steps, self.deadline(share_left=0.08, seconds_left=3.0))
        chosen, held_out = split_views(len(scene.train), config.holdout_every)
        self.views: Sequence[View] = [scene.train[index] for index in chosen]
        self.evaluator = Evaluator(config, scene, held_out)
        self.milestones = Milestones([] if saved is None else saved.milestones, config.max_time)

    def record(self, reason: str, progress: float, measure: Callable[[], dict[str, Any] | None]) -> None:
        """A row of the curve from what ``measure`` finds, if that is anything; told."""
        began = self.clock.now
        with self.clock.pause(), torch.no_grad():
            measured = self.processes.first(measure)
        self.milestones.charge(seconds := self.clock.now - began)
        if measured is not None:
            clock = self.clock
            seconds_so_far = {
                "t_train_s": clock.train_seconds,
                "t_wall_s": clock.wall_seconds,
                "t_cpu_s": clock.cpu_seconds,
            }
            row = {"reason": reason, "progress": progress, **seconds_so_far, **measured}
            self.milestones.add(progress, row)
            self.tell("evaluation", {**row, "seconds": seconds})

    def shared_progress(self) -> float:
        """``progress``, the same for all processes."""
        return self.processes.first(self.progress)

    # -- as the method sees it -----------------------------------------------------------------------------------

    @property
    def timed(self) -> bool:
        return self.schedule.timed

    def progress(self) -> float:
        return self.schedule.progress(self.step)

    def deadline(self, *, share_left: float, seconds_left: float) -> float | None:
        return self.clock.deadline(self.config.max_time, share_left=share_left, seconds_left=seconds_left)

    def tell(self, name: EventName, data: Mapping[str, Any]) -> None:
        trained, passed = self.clock.train_seconds, self.clock.wall_seconds
        self._emit(Event(t_train=trained, t_wall=passed, outer=self.step, event=name, data=data))

    def warn(self, message: str) -> None:
        self.tell("warning", {"message": message})

    def show_start(self, make: Callable[[], tuple[Mesh, Mapping[str, Any]] | None]) -> None:
        if self.processes.first(self.milestones.start_due):
            self.record("start", 0.0, lambda: self.evaluator.measure_start(make))

    @property
    def judged(self) -> bool:
        return bool(self.evaluator.views)

    def judge(self, render: Callable[[Camera], Float[Tensor, "h w 3"]]) -> float:
        return self.processes.first(lambda: self.evaluator.quick_psnr(render))
