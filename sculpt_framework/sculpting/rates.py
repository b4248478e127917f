"""What stage a run is in and how large its steps are, by its progress."""

import math

from scipy.special import lambertw

from sculpt_framework.sculpting.config import TrainerConfig

_WARM = 0.25
"""Of the time given: before the surface first moves, colours learn for no more of it."""


class Rates:
    """Of a run whose length the clock says (``timed``), or its steps."""

    def __init__(self, config: TrainerConfig, *, timed: bool):
        """Raises ValueError without stages or where one has no share."""
        shares = [stage.share for stage in config.stages]
        if not shares or min(shares) <= 0:
            raise ValueError("a schedule needs stages with positive shares")
        total = sum(shares)
        self._ends = [sum(shares[: index + 1]) / total for index in range(len(shares))]
        self._final_rate = config.final_rate
        self._full_steps = config.surface_steps
        self._timed = timed

    def stage_index(self, progress: float) -> int:
        for index, end in enumerate(self._ends):
            if progress < end - 1e-9:
                return index
        return len(self._ends) - 1

    def warm(self, progress: float) -> bool:
        """Whether colours have had the time there is for them before the first outer step."""
        return self._timed and progress >= _WARM

    def factor(self, progress: float) -> float:
        """Factor on learning rates: they fall exponentially to ``final_rate``."""
        return self._final_rate**progress

    def surface(self, factor: float, outer: int, progress: float) -> float:
        """What of a factor on learning rates the surface gets after so many outer steps of this run."""
        if self._full_steps == 0 or outer == 0 or progress == 0:
            return factor
        return min(factor, 1.0 / (1.0 + progress * settling(outer / progress, self._full_steps)))


def settling(steps: float, full: float) -> float:
    """The x for which 1 / (1 + x p), over ``steps`` steps with p going from 0 to 1, adds up to ``full``; at least 0.

    That is log(1 + x) / x = full / steps.
    """
    share = full / steps
    return 0.0 if share >= 1.0 else -float(lambertw(-share * math.exp(-share), -1).real) / share - 1.0
