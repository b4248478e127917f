"""Whether a loss that is drawn view by view has come to a plateau."""


class Plateau:
    """Compares the mean of a loss over a pass of evaluations with that over the pass before.

    Single values say nothing: views differ by more than a loss falls from one step to the next.
    """

    def __init__(self, length: int, gain: float):
        """``length``: evaluations of a pass; ``gain``: share by which a pass has to lower the mean; 0: it may rise."""
        self._length = length
        self._gain = gain
        self._before: float | None = None
        self._sum = 0.0
        self._count = 0

    def after(self, loss: float, count: int = 1) -> bool:
        """Whether it falls, as far as is known after ``count`` further evaluations whose mean is ``loss``."""
        if self._gain == 0.0:
            return True
        self._sum += loss * count
        self._count += count
        if self._count < self._length:
            return True
        before, mean = self._before, self._sum / self._count
        self._before, self._sum, self._count = mean, 0.0, 0
        return before is None or mean < (1.0 - self._gain) * before
