"""Which photographs are compared with which."""

from collections.abc import Sequence

EXHAUSTIVE_UP_TO = 100
"""Photographs; of more, neighbours in the order of their names are compared."""
_NEIGHBOURS = 10
_STRIDE = 5
"""Every so many images one is compared with all others chosen so: it finds where a path comes back to."""


def choose_pairs(count: int, *, in_order: bool) -> tuple[Sequence[tuple[int, int]], str]:
    """Pairs of indices, the lower first, and the rule in words.

    All pairs up to a hundred photographs. Of more, and of the frames of a video (``in_order``): each with the ten that
    follow and with those 16, 32, 64, ... further on, and every fifth with every fifth.
    """
    everything = [(first, second) for first in range(count) for second in range(first + 1, count)]
    if count <= EXHAUSTIVE_UP_TO and not in_order:
        return everything, "every photograph with every other"
    chosen = [pair for pair in everything if _near(*pair)]
    return chosen, "each with the ten next and some further on, every fifth with every fifth"


def _near(first: int, second: int) -> bool:
    apart = second - first
    power_of_two = apart & (apart - 1) == 0
    return apart <= _NEIGHBOURS or power_of_two or (first % _STRIDE == 0 and second % _STRIDE == 0)
