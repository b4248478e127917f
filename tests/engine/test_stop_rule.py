import math

import pytest

from sculpt_framework.stop_rule import FEWEST, StopRule

RULE = StopRule(least_gain=0.3)


def test_the_gain_is_that_of_the_later_half_over_the_earlier():
    assert RULE.gain([(0.0, 20.0), (0.1, 30.0), (0.2, 33.0), (0.3, 34.0), (0.4, 34.5)]) == pytest.approx(1.5)
    # The best of each half counts: one that is out of line, low or early, does not.
    dips = [(0.0, 20.0), (0.1, 34.0), (0.2, 33.0), (0.3, 34.6), (0.4, 31.0)]
    assert RULE.gain(dips) == pytest.approx(0.6)
    assert RULE.gain([(0.5 + place, score) for place, score in dips]) == pytest.approx(0.6)
    assert RULE.gain([(0.0, 20.0), (0.1, 34.0), (0.2, 33.0), (0.3, 33.9), (0.4, 33.0)]) == pytest.approx(-0.1)


@pytest.mark.parametrize(
    "watched",
    [[], [(0.0, 20.0), (0.1, 20.0), (0.2, 20.0)], [(1.0, 20.0), (1.0, 20.0), (1.0, 20.0), (1.0, 20.0)]],
    ids=["nothing", "too few", "all at one place"],
)
def test_without_enough_scores_it_goes_on(watched: list[tuple[float, float]]):
    assert RULE.gain(watched) == math.inf
    assert not RULE.stops(watched)


def test_it_ends_what_gains_less_than_asked():
    watched = [(0.0, 20.0), (1.0, 25.0), (2.0, 25.1), (3.0, 25.2)]
    assert RULE.stops(watched)
    assert not StopRule(least_gain=0.1).stops(watched)
    assert not StopRule(least_gain=0.0).stops([(float(place), -float(place)) for place in range(9)])


def test_only_the_latest_scores_count_where_it_says_so():
    scores = [0.0, 10.0, 20.0, 25.0, 30.0, 30.0, 30.0, 30.0]
    watched = [(float(place), score) for place, score in enumerate(scores)]
    assert not RULE.stops(watched)
    assert StopRule(least_gain=0.3, latest=FEWEST).stops(watched)
    assert not StopRule(least_gain=0.3, latest=FEWEST).stops(watched[:-2])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_no_gain(bad: float):
    assert RULE.stops([(0.0, 20.0), (1.0, 21.0), (2.0, bad), (3.0, bad)])
    assert RULE.stops([(float(place), bad) for place in range(4)])
    assert not RULE.stops([(0.0, bad), (1.0, 21.0), (2.0, bad), (3.0, 22.0)])
