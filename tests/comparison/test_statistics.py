"""Medians, failures, wins and intervals, on runs whose answer is known."""

import math

import numpy as np
import pytest
from scipy.stats import bootstrap
from written_runs import record

from sculpt_framework.comparison.runs import CurvePoint, RunRecord
from sculpt_framework.comparison.statistics import (
    common_target,
    interval,
    interval_of_mean,
    median_curve,
    median_time_to_reach,
    overall,
    summarize,
    value_at,
)


def seeds(method: str, *errors: float, scene: str = "jar", failures: int = 0) -> list[RunRecord]:
    good = [record([(1.0, 1.0), (8.0, error)], method=method, scene=scene, seed=n) for n, error in enumerate(errors)]
    bad = [record([(1.0, 0.5)], method=method, scene=scene, seed=100 + n, failed=True) for n in range(failures)]
    return good + bad


def test_a_cell_is_the_median_over_seeds():
    cell, other = summarize([*seeds("a", 0.3, 0.1, 0.2), *seeds("b", 0.15, 0.25)], "chamfer")
    assert (cell.method, cell.scene, cell.runs, cell.failures, cell.unknown) == ("a", "jar", 3, 0, 0)
    assert (cell.median, cell.seconds) == (0.2, 8)
    assert (other.median, other.low) == (0.2, None)
    assert cell.best
    assert other.best, "as good is as good"


def test_failures_move_the_median_and_lose():
    one, half = summarize([*seeds("a", 0.1, 0.2, failures=1), *seeds("b", 0.1, failures=1)], "chamfer")
    assert (one.median, one.failures) == (0.2, 1)
    assert (half.median, half.failures) == (math.inf, 1)
    assert half.seconds == 8, "of the run that has a result"
    assert one.best
    assert not half.best
    assert not any(cell.best for cell in summarize(seeds("a", failures=2), "chamfer"))


def test_what_is_not_known_is_not_taken_for_good():
    known, unknown = record([(1.0, 0.1)], method="a", psnr=30.0), record([(1.0, 0.1)], method="b")
    a, b = summarize([known, unknown], "psnr")
    assert (a.median, a.best) == (30, True)
    assert (b.median, b.unknown, b.best) == (None, 1, False)


def test_for_a_score_more_is_better():
    low, high = record([(1.0, 0.1)], method="a", psnr=20.0), record([(1.0, 0.1)], method="b", psnr=21.0)
    failed = record([(1.0, 0.1)], method="c", failed=True)
    cells = summarize([low, high, failed], "psnr")
    assert [cell.best for cell in cells] == [False, True, False]
    assert cells[2].median == -math.inf


def test_wins_are_counted_by_scene():
    records = [
        *(*seeds("a", 0.1), *seeds("b", 0.2)),
        *(*seeds("a", 0.3, scene="hammer"), *seeds("b", 0.2, scene="hammer")),
        *(*seeds("a", 0.30000, scene="cup"), *seeds("b", 0.30001, scene="cup")),
        *(*seeds("a", failures=1, scene="fork"), *seeds("b", failures=1, scene="fork")),
    ]
    a, b = overall(records, "chamfer")
    assert (a.scenes, a.runs, a.failures, a.wins) == (4, 4, 1, 2)
    assert (b.wins, b.failures) == (2, 1)
    assert a.mean == math.inf
    a, b = overall([each for each in records if each.scene != "fork"], "chamfer")
    assert a.mean == pytest.approx(0.7 / 3)


def test_the_interval_is_that_of_a_second_implementation():
    values = np.random.default_rng(3).lognormal(size=101).tolist()
    other = bootstrap((values,), np.median, method="percentile", n_resamples=20_000, rng=np.random.default_rng(1))
    low, high = interval(values) or (0.0, 0.0)
    assert (low, high) == pytest.approx(tuple(other.confidence_interval), rel=0.05)
    assert interval(values) == interval(values), "the same random numbers each time"
    assert interval(values, seed=1) == pytest.approx((low, high), rel=0.1)


def test_intervals_cover_as_often_as_they_say():
    """The median of 25 draws of a known law: about 95 of 100 intervals hold the law's median."""
    random = np.random.default_rng(0)
    draws = random.normal(size=(60, 25))
    held = [low <= 0 <= high for low, high in (interval(row.tolist()) or (9.0, 9.0) for row in draws)]
    assert 0.85 <= np.mean(held) <= 1


def test_an_interval_reaches_to_failures_and_needs_three_seeds():
    assert interval([1.0, 2.0]) is None
    low, high = interval([1.0, 2.0, math.inf]) or (0.0, 0.0)
    assert (low, high) == (1, math.inf)
    assert interval_of_mean([[1.0, 2.0, 3.0], [1.0]]) is None
    assert interval_of_mean([[1.0] * 3, [3.0] * 3]) == (2, 2)


def test_a_median_curve_is_the_run_in_the_middle():
    """Three power laws measured at different times: the middle one, wherever it is looked at."""
    curves = [
        record([(t, factor / t**0.5) for t in times], seed=n)
        for n, (factor, times) in enumerate([(1.0, (1.0, 4.0, 16.0)), (2.0, (1.0, 2.0, 16.0)), (4.0, (1.0, 8.0, 16.0))])
    ]
    points = median_curve(curves, "chamfer")
    assert [seconds for seconds, _ in points] == [1, 2, 4, 8, 16]
    for seconds, value in points:
        assert value == pytest.approx(2 / seconds**0.5)


def test_a_failed_run_counts_against_the_median_curve_from_its_failure_on():
    whole, broken = record([(1.0, 0.4), (4.0, 0.2)]), record([(1.0, 0.4), (2.0, 0.3)], failed=True)
    assert [seconds for seconds, _ in median_curve([whole, broken], "chamfer")] == [1, 2]
    assert median_curve([whole, whole, broken], "chamfer")[-1] == (4, 0.2)
    never = record([], failed=True)
    assert median_curve([whole, never], "chamfer") == []


def test_a_run_that_ended_keeps_its_value():
    short, long = record([(1.0, 0.4), (2.0, 0.2)]), record([(1.0, 0.4), (8.0, 0.1)])
    assert value_at(short, 5.0, "chamfer") == 0.2
    assert value_at(short, 0.5, "chamfer") is None
    assert median_curve([short, long], "chamfer")[-1] == (8, pytest.approx(0.15))


def test_time_to_an_error_counts_failures_as_never():
    good = [record([(1.0, 0.4), (4.0, 0.1)]), record([(1.0, 0.4), (16.0, 0.1)])]
    assert median_time_to_reach(good, 0.1, "chamfer") == 10
    broken = record([(1.0, 0.05)], failed=True)
    assert median_time_to_reach([good[0], broken, good[1]], 0.1, "chamfer") == 16
    assert median_time_to_reach([good[0], broken], 0.1, "chamfer") == math.inf
    assert median_time_to_reach([RunRecord(name="x", scene="s", method="m")], 0.1, "chamfer") is None


def test_the_common_target_is_reached_by_half_of_every_method():
    records = [*seeds("a", 0.1, 0.3), *seeds("b", 0.2, 0.2, 0.25), *seeds("c", failures=2, scene="jar")]
    target = common_target(records, "chamfer")
    assert target == 0.3
    for method in ("a", "b"):
        reached = median_time_to_reach([r for r in records if r.method == method], target, "chamfer")
        assert reached is not None
        assert reached <= 8
    assert common_target(seeds("a", failures=1), "chamfer") is None


def test_the_common_target_of_a_score():
    def run(method: str, psnr: float) -> RunRecord:
        curve = (CurvePoint(train_seconds=1.0, psnr=psnr),)
        return RunRecord(name=method, scene="s", method=method, curve=curve, final={"psnr": psnr})

    assert common_target([run("a", 20.0), run("a", 24.0), run("b", 22.0)], "psnr") == 20
