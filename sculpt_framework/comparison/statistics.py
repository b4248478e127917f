"""What several seeds and scenes say: medians, failures, wins, and how sure one can be of a median.

A failure is a result that is infinitely bad: it moves the median, it loses to every result, and it is counted. A value
that is not known (no reference mesh, no mask) is left out and counted apart; it is never taken for a good one.
"""

import itertools
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

from sculpt_framework.comparison.runs import HIGHER_IS_BETTER, Clock, Measure, RunRecord, time_to_reach

Item = TypeVar("Item")

FEWEST_FOR_INTERVAL = 3
"""Seeds below which resampling says nothing about the spread."""
TIE = 1e-3
"""Medians nearer than this share of the best are as good: figures from samples are not surer than that."""
LEVEL = 0.95
"""What intervals cover."""
_RESAMPLES = 10_000


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One method on one scene, over its seeds."""

    method: str
    scene: str
    runs: int
    failures: int
    """Of ``runs``: without a result to be counted. They are infinitely bad in the median."""
    unknown: int
    """Of ``runs``: ended, but the measure is not known; left out of the median."""
    median: float | None
    """Of the measure; infinite where half or more failed, None where nothing is known."""
    low: float | None
    high: float | None
    """Interval of the median over seeds, by resampling; None with fewer than ``FEWEST_FOR_INTERVAL`` seeds."""
    seconds: float | None
    """Median seconds to the result, over the runs that have one."""
    best: bool
    """No other method has a better median on this scene, but for ``TIE``; a failure is never best."""


@dataclass(frozen=True, kw_only=True)
class Overall:
    """One method over its scenes."""

    method: str
    scenes: int
    runs: int
    failures: int
    wins: int
    """Scenes on which no other method has a better median."""
    mean: float | None
    """Mean over the scenes of the medians; infinite if a scene's is, None if one is not known."""
    low: float | None
    high: float | None
    """Interval of that mean over seeds: the seeds of each scene are resampled, the scenes stay."""
    seconds: float | None
    """Mean over the scenes of the median seconds; None if one is not known."""


def summarize(records: Sequence[RunRecord], measure: Measure, clock: Clock = "train") -> tuple[Cell, ...]:
    """A cell per scene and method there is, scenes and methods in the order of the records."""
    cells = []
    for scene, of_scene in grouped(records, lambda record: record.scene).items():
        groups = grouped(of_scene, lambda record: record.method)
        values = {method: known_values(group, measure) for method, group in groups.items()}
        medians = {method: median(known) for method, known in values.items()}
        best = best_of([value for value in medians.values() if value is not None], measure)
        for method, group in groups.items():
            low, high = interval(values[method]) or (None, None)
            times = [record.total_seconds(clock) for record in group if not record.failed]
            cells.append(
                Cell(
                    method=method,
                    scene=scene,
                    runs=len(group),
                    failures=sum(record.failed for record in group),
                    unknown=len(group) - len(values[method]),
                    median=medians[method],
                    low=low,
                    high=high,
                    seconds=median([value for value in times if value is not None]),
                    best=_as_good(medians[method], best),
                )
            )
    return tuple(cells)


def overall(records: Sequence[RunRecord], measure: Measure, clock: Clock = "train") -> tuple[Overall, ...]:
    """A line per method over its scenes. Compare lines only where the number of scenes is the same."""
    cells = summarize(records, measure, clock)
    out = []
    for method, of_method in grouped(cells, lambda cell: cell.method).items():
        groups = [
            known_values([r for r in records if (r.method, r.scene) == (method, cell.scene)], measure)
            for cell in of_method
        ]
        low, high = interval_of_mean(groups) or (None, None)
        out.append(
            Overall(
                method=method,
                scenes=len(of_method),
                runs=sum(cell.runs for cell in of_method),
                failures=sum(cell.failures for cell in of_method),
                wins=sum(cell.best for cell in of_method),
                mean=_mean([cell.median for cell in of_method]),
                low=low,
                high=high,
                seconds=_mean([cell.seconds for cell in of_method]),
            )
        )
    return tuple(out)


def known_values(records: Iterable[RunRecord], measure: Measure) -> list[float]:
    """Results by their measure, failures as infinitely bad; those that are not known are left out."""
    return [value for record in records if (value := record.result(measure)) is not None]


def median(values: Sequence[float]) -> float | None:
    """The middle value, or the mean of the middle two; infinite if one of those is. None of nothing."""
    return statistics.median(values) if values else None


def best_of(values: Sequence[float], measure: Measure) -> float | None:
    """The best value that is no failure's; None if there is none."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return None
    return max(finite) if measure in HIGHER_IS_BETTER else min(finite)


def _as_good(value: float | None, best: float | None) -> bool:
    return value is not None and best is not None and abs(value - best) <= TIE * abs(best)


def interval(values: Sequence[float], *, seed: int = 0) -> tuple[float, float] | None:
    """Percentile bootstrap of the median: the range of medians of as many values drawn again from these.

    An end is infinite where failures reach it. None for fewer than ``FEWEST_FOR_INTERVAL`` values.
    """
    return interval_of_mean([values], seed=seed)


def interval_of_mean(groups: Sequence[Sequence[float]], *, seed: int = 0) -> tuple[float, float] | None:
    """The same for the mean over groups of their medians, each group drawn from by itself."""
    if not groups or min(len(group) for group in groups) < FEWEST_FOR_INTERVAL:
        return None
    generator = np.random.default_rng(seed)
    medians = np.stack([_resampled_medians(np.asarray(group, dtype=np.float64), generator) for group in groups])
    means = np.sort(medians.mean(axis=0))
    # Values that occur, not interpolated: between a number and infinity there is nothing.
    first, last = (round(share * (_RESAMPLES - 1)) for share in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return float(means[first]), float(means[last])


def _resampled_medians(values: Float64[np.ndarray, " n"], generator: np.random.Generator) -> Float64[np.ndarray, " r"]:
    drawn = np.sort(values[generator.integers(0, len(values), (_RESAMPLES, len(values)))], axis=1)
    middle = len(values) // 2
    return drawn[:, middle] if len(values) % 2 else 0.5 * (drawn[:, middle - 1] + drawn[:, middle])


# -- curves ----------------------------------------------------------------------------------------------------------


def value_at(record: RunRecord, seconds: float, measure: Measure, clock: Clock = "train") -> float | None:
    """What the run had by then: between two rows interpolated in log time (and in the log of an error).

    None before its first row. After its last row a run that ended keeps its value; one that failed is infinitely bad.
    """
    known = [
        (t, v)
        for point in record.curve
        if (t := point.seconds(clock)) is not None and (v := point.value(measure)) is not None
    ]
    if not known or seconds < known[0][0]:
        return None
    for (t0, v0), (t1, v1) in itertools.pairwise(known):
        if t0 <= seconds <= t1:
            return _interpolated((t0, v0), (t1, v1), seconds, log=measure not in HIGHER_IS_BETTER)
    return known[-1][1] if seconds == known[-1][0] or not record.failed else record.result(measure)


def median_curve(records: Sequence[RunRecord], measure: Measure, clock: Clock = "train") -> list[tuple[float, float]]:
    """The median over seeds at every time one of them was measured: (seconds, value) while half of them have a result.

    A run that has no value yet, and one that failed before, are infinitely bad at that time.
    """
    worst = -math.inf if measure in HIGHER_IS_BETTER else math.inf
    measured = [record for record in records if any(point.value(measure) is not None for point in record.curve)]
    # Those that failed before their first row have no time of their own, but count.
    counted = [*measured, *(record for record in records if record.failed and record not in measured)]
    times = sorted({t for record in measured for point in record.curve if (t := point.seconds(clock)) is not None})
    points = []
    for seconds in times:
        values = [value_at(record, seconds, measure, clock) for record in counted]
        middle = statistics.median([worst if value is None else value for value in values])
        if math.isfinite(middle):
            points.append((seconds, middle))
    return points


def median_time_to_reach(
    records: Sequence[RunRecord], error: float, measure: Measure, clock: Clock = "train"
) -> float | None:
    """Median over seeds of ``time_to_reach``; infinite where half or more never did. None of no curve at all.

    What a run that failed had reached before it failed does not count: it left no result.
    """
    times = [
        math.inf if record.failed else time_to_reach(record.curve, error, measure=measure, clock=clock)
        for record in records
        if record.failed or record.curve
    ]
    return median(times)


def common_target(records: Sequence[RunRecord], measure: Measure) -> float | None:
    """The best value that half of the runs of every method reach, where times can be compared; None if there is none.

    Methods half of whose runs failed are left aside, and so is what has no curve.
    """
    higher = measure in HIGHER_IS_BETTER
    reached = []
    for group in grouped(records, lambda record: record.method).values():
        values = known_values([record for record in group if record.failed or record.curve], measure)
        if values:
            reached.append(statistics.median_low(values) if higher else statistics.median_high(values))
    finite = [value for value in reached if math.isfinite(value)]
    if not finite:
        return None
    return min(finite) if higher else max(finite)


def grouped(items: Iterable[Item], key: Callable[[Item], str]) -> Mapping[str, list[Item]]:
    """Items by their key, in the order they come."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def _interpolated(before: tuple[float, float], after: tuple[float, float], seconds: float, *, log: bool) -> float:
    (t0, v0), (t1, v1) = before, after
    if t1 == t0:
        return v1
    share = math.log(seconds / t0) / math.log(t1 / t0) if t0 > 0 else (seconds - t0) / (t1 - t0)
    if log and min(v0, v1) > 0:
        return v0 * (v1 / v0) ** share
    return v0 + share * (v1 - v0)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known and len(known) == len(values) else None
