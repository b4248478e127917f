"""When a method at work is measured, and what follows from it: the best state, and an early end."""

from torch import Tensor

from sculpt_framework.engine import announcements
from sculpt_framework.engine.hosting import Hosting
from sculpt_framework.engine.known_good import KnownGood
from sculpt_framework.evaluation.album import Album
from sculpt_framework.evaluation.pictures import Picture
from sculpt_framework.reconstructor import Reconstructor
from sculpt_framework.stop_rule import StopRule


class Measuring:
    """Of one method in one run. What is the best of its states so far is noted in ``known_good``."""

    def __init__(self, host: Hosting, method: Reconstructor, known_good: KnownGood):
        self._host, self._method, self._known_good = host, method, known_good
        shown = host.evaluator.views[:1] or host.views[:1]
        self._album = Album(shown[0], host.evaluator.reference)

    def begin(self) -> None:
        """Before the first step, or going on: unless it has been before, what a method begins with is measured."""
        milestones = self._host.milestones
        if milestones.staged:
            return
        if self._method.begins_with_surface:
            milestones.enter_stage()
        else:
            milestones.wait()

    def if_due(self) -> dict[str, Tensor] | None:
        """The state that was measured, if one was."""
        host, progress = self._host, self._host.shared_progress()
        if (reason := host.processes.first(lambda: host.milestones.due(progress, host.clock.train_seconds))) is None:
            return None
        self.measure(reason, progress)
        if host.step == 0:
            with host.clock.pause():
                self._album.begin(self._method)
        self._end_if_level()
        return self._method.state()

    def measure(self, reason: str, progress: float) -> None:
        """A row of what the method has now; of the result, all there is to measure."""
        host = self._host
        measure = host.evaluator.measure_result if reason == "result" else host.evaluator.measure
        host.record(reason, progress, lambda: measure(self._method))
        host.schedule.end_by(host.deadline(share_left=0.0, seconds_left=3.0 + host.milestones.seconds_of_end))
        self._keep_best(reason, host.milestones.latest("psnr"))

    def pictures(self) -> dict[str, dict[str, Picture]]:
        """A held-out view, or a train view if none is, beside what the run makes of it, and made of it at its start."""
        return self._album.pages(self._method)

    def _keep_best(self, reason: str, score: float | None) -> None:
        """Keep the state if its held-out views are the best of the last stage so far.

        Where the run counts steps, measurements at clock times are passed over: which state wins must not depend on how
        fast the machine is.
        """
        chosen = reason != "time" or self._host.config.max_time is not None
        if score is not None and self._in_last_stage and chosen:
            self._known_good.offer(score, self._method.state)

    def _end_if_level(self) -> None:
        """Have a run that gains no more come to its end, and its rates with it."""
        host, config = self._host, self._host.config
        rule, watched = StopRule(least_gain=config.level_gain_db), host.milestones.of_stage("psnr")
        ripe = self._in_last_stage and host.step >= config.steps
        if ripe and rule.stops(watched) and (factor := host.schedule.cut_short()) is not None:
            host.milestones.cut_short(factor)
            host.tell("decision", announcements.cut_short(rule.gain(watched), factor))

    @property
    def _in_last_stage(self) -> bool:
        return self._method.stage == self._method.stages - 1
