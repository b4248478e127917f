"""States that a session can go back to: the latest that a step went well from, and the best."""

from collections.abc import Callable, Mapping

from torch import Tensor

from sculpt_framework.engine.checkpoint import Progress

_RECOVERIES_AT_MOST = 3
_MARGIN_DB = 0.3
"""By which an earlier state's held-out views must be better: less is chance, and rates were higher then."""


class KnownGood:
    """Kept as what ``Reconstructor.state`` gives."""

    def __init__(self) -> None:
        self.latest: Mapping[str, Tensor] | None = None
        self.best: Mapping[str, Tensor] | None = None
        self.best_psnr: float | None = None
        """Of the best state's held-out views, dB."""
        self.rate = 1.0
        """Factor on learning rates: halved with each return."""
        self.returns = 0

    def take_up(self, progress: Progress, best: Mapping[str, Tensor]) -> None:
        """What is known of a resumed run."""
        self.rate, self.returns = progress.rate_scale, progress.recoveries
        if progress.best_psnr is not None:
            self.best, self.best_psnr = best, progress.best_psnr

    def offer(self, psnr: float, state: Callable[[], Mapping[str, Tensor]]) -> None:
        """A state of the last stage; it is taken, and only then made, if it is the best so far."""
        if self.best_psnr is None or psnr > self.best_psnr:
            self.best, self.best_psnr = state(), psnr

    def better_than(self, psnr: float | None) -> Mapping[str, Tensor] | None:
        """The best state, if its held-out views are clearly better than these."""
        if self.best_psnr is None or psnr is None or self.best_psnr <= psnr + _MARGIN_DB:
            return None
        return self.best

    def after_failure(self) -> Mapping[str, Tensor] | None:
        """The state to go back to, at half the learning rates; None if there is none, or it was tried too often."""
        self.returns += 1
        if self.latest is None or self.returns > _RECOVERIES_AT_MOST:
            return None
        self.rate *= 0.5
        return self.latest
