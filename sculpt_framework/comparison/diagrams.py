"""Work-precision diagrams: error over time, and the time it takes to reach an error. A panel a scene."""

import math
from collections.abc import Callable, Mapping, Sequence

from sculpt_framework.comparison.runs import HIGHER_IS_BETTER, Clock, Measure, RunRecord, time_to_reach
from sculpt_framework.comparison.statistics import grouped, median_curve, median_time_to_reach
from sculpt_framework.comparison.wording import MEASURES, time_axis
from sculpt_framework.evaluation.charts import COLORS, Axis, Series, line_drawing, sheet
from sculpt_framework.evaluation.drawing import Drawing

_TARGETS = 60
"""Errors along the axis of a time-to-reach diagram."""
_COLUMNS = 2


def error_over_time(records: Sequence[RunRecord], measure: Measure, clock: Clock) -> Drawing | None:
    """A thin line per run, a thick one for the median over seeds, a cross where a run failed.

    A mesh without a curve is a dot at its seconds, or a dashed line where nobody knows those. None if no scene has
    anything to show.
    """

    def series(group: Sequence[RunRecord]) -> list[Series]:
        out = []
        for record in group:
            points = _points(record, measure, clock)
            if points:
                out.append(Series(name=record.method, points=points, style="member"))
                if record.failed:
                    out.append(Series(name=record.method, points=points[-1:], style="cross"))
            elif (value := record.result(measure)) is not None and math.isfinite(value):
                seconds = record.total_seconds(clock)
                style = "level" if seconds is None else "mark"
                out.append(Series(name=record.method, points=[(seconds or 1.0, value)], style=style))
        for method, same in grouped(group, lambda record: record.method).items():
            if middle := median_curve(same, measure, clock):
                out.append(Series(name=method, points=middle, style="median"))
        return out

    title = f"{MEASURES[measure].name} against time"
    return _panels(title, records, series, time_axis(clock), MEASURES[measure].axis)


def time_to_error(records: Sequence[RunRecord], measure: Measure, clock: Clock) -> Drawing | None:
    """Seconds, upwards, until a run first was that good; a thin line per run, a thick one for the median over seeds.

    A line ends at the best value half of the runs reach. None if no scene has anything to show.
    """

    def series(group: Sequence[RunRecord]) -> list[Series]:
        curves = [points for record in group if (points := _points(record, measure, clock))]
        if not curves:
            return []
        # From the worst start on: what a run loses after its start is no error anybody aims at.
        best_of, worst_of = (max, min) if measure in HIGHER_IS_BETTER else (min, max)
        best = best_of(value for points in curves for _, value in points)
        targets = _targets(best, worst_of(points[0][1] for points in curves), log=MEASURES[measure].log)
        out = []
        for record in group:
            reached = [(e, time_to_reach(record.curve, e, measure=measure, clock=clock)) for e in targets]
            out.append(Series(name=record.method, points=_finite(reached), style="member"))
        for method, same in grouped(group, lambda record: record.method).items():
            middle = [(e, median_time_to_reach(same, e, measure, clock)) for e in targets]
            out.append(Series(name=method, points=_finite(middle), style="median"))
        return [line for line in out if line.points]

    worded = MEASURES[measure]
    better = "at least" if measure in HIGHER_IS_BETTER else "at most"
    title = f"Time until the {worded.name} is {better}"
    return _panels(title, records, series, worded.axis, time_axis(clock))


def method_colors(records: Sequence[RunRecord]) -> Mapping[str, str]:
    """A colour per method, in the order of the records."""
    names = dict.fromkeys(record.method for record in records)
    return {name: COLORS[index % len(COLORS)] for index, name in enumerate(names)}


def _panels(
    title: str,
    records: Sequence[RunRecord],
    series: Callable[[Sequence[RunRecord]], list[Series]],
    x: Axis,
    y: Axis,
) -> Drawing | None:
    colors = method_colors(records)
    panels = []
    for scene, group in grouped(records, lambda record: record.scene).items():
        lines = [line for line in series(group) if any(py > 0 or not y.log for _, py in line.points)]
        if lines:
            panels.append(line_drawing(scene, lines, x, y, colors=colors, legend=False))
    return sheet(title, panels, colors, columns=_COLUMNS) if panels else None


def _points(record: RunRecord, measure: Measure, clock: Clock) -> list[tuple[float, float]]:
    pairs = [(point.seconds(clock), point.value(measure)) for point in record.curve]
    return [(seconds, value) for seconds, value in pairs if seconds is not None and value is not None]


def _targets(first: float, last: float, *, log: bool) -> list[float]:
    """Values from one to the other, both exactly."""
    shares = [index / (_TARGETS - 1) for index in range(1, _TARGETS - 1)]
    if log and min(first, last) > 0:
        return [first, *(first * (last / first) ** share for share in shares), last]
    return [first, *(first + (last - first) * share for share in shares), last]


def _finite(points: Sequence[tuple[float, float | None]]) -> list[tuple[float, float]]:
    return [(x, y) for x, y in points if y is not None and math.isfinite(y)]
