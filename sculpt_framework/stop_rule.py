"""When to end what is repeated because it no longer gains anything."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

FEWEST = 4
"""Scores without which nothing can be said."""


@dataclass(frozen=True, kw_only=True)
class StopRule:
    """End once the later half of what was watched is hardly better than the earlier half.

    The best of each half is compared, because single scores fall out of line. A score that is not finite counts as no
    gain.
    """

    least_gain: float
    """What the later half has to gain, in units of the scores; 0: whatever it gains, go on."""
    latest: int | None = None
    """How many of the latest scores to look at, ``FEWEST`` or more; None: all."""

    def stops(self, watched: Sequence[tuple[float, float]]) -> bool:
        """Whether to end, after these pairs of a place and the score there: places ascend, higher scores are better."""
        return self.least_gain > 0 and not self.gain(watched) >= self.least_gain

    def gain(self, watched: Sequence[tuple[float, float]]) -> float:
        """By how much the later half, by places, is better; infinite as long as too little is known to tell."""
        seen = watched if self.latest is None else watched[-self.latest :]
        if len(seen) < FEWEST:
            return math.inf
        middle = 0.5 * (seen[0][0] + seen[-1][0])
        early = [_ranked(score) for place, score in seen if place <= middle]
        later = [_ranked(score) for place, score in seen if place > middle]
        return max(later) - max(early) if later else math.inf


def _ranked(score: float) -> float:
    return score if math.isfinite(score) else -math.inf
