"""When what happens: progress, stages, rates, measurements, clocks."""

import itertools
import time
from dataclasses import replace

import pytest
from small_runs import TWO_STAGES, small_config

from sculpt_framework.engine.clock import TrainingClock, process_start
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.engine.planning import split_views
from sculpt_framework.engine.schedule import Schedule
from sculpt_framework.evaluation.evaluator import some_views
from sculpt_framework.sculpting.config import StageConfig
from sculpt_framework.sculpting.rates import Rates
from sculpt_framework.types import Scene

IMPORTED = time.monotonic()


def test_steps_make_progress():
    schedule = Schedule(10, None)
    assert schedule.total_steps == 10
    assert [schedule.progress(outer) for outer in (0, 5, 10, 12)] == [0.0, 0.5, 1.0, 1.0]
    rates = Rates(small_config(stages=TWO_STAGES).trainer, timed=False)
    assert [rates.stage_index(p) for p in (0.0, 0.49, 0.5, 1.0)] == [0, 0, 1, 1]


def test_rates_fall_to_the_share_that_was_asked_for():
    falling = Rates(small_config(final_rate=0.05).trainer, timed=False)
    rates = [falling.factor(progress / 10) for progress in range(11)]
    assert rates[0] == 1.0
    assert rates[-1] == pytest.approx(0.05)
    assert rates == sorted(rates, reverse=True)


@pytest.mark.parametrize("steps", [60, 80, 400, 20_000])
def test_the_surface_settles_however_long_the_run(steps: int):
    assert Rates(small_config(surface_steps=0.0).trainer, timed=False).surface(0.9, 10_000, 1.0) == 0.9
    falling = Rates(small_config(surface_steps=40.0).trainer, timed=False)
    rates = [falling.surface(1.0, outer, outer / steps) for outer in range(steps)]
    assert rates[0] == 1.0
    assert rates == sorted(rates, reverse=True)
    assert sum(rates) == pytest.approx(40, rel=0.03)
    assert falling.surface(0.01 * rates[-1], steps, 1.0) == 0.01 * rates[-1]


def test_a_short_run_keeps_its_rates():
    rates = Rates(small_config(surface_steps=40.0).trainer, timed=False)
    assert [rates.surface(0.5, outer, outer / 40) for outer in (0, 20, 40)] == [0.5, 0.5, 0.5]


def test_colours_are_warmed_up_for_a_quarter_of_the_time_at_most(monkeypatch: pytest.MonkeyPatch):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    schedule = Schedule(8, 100.0)
    timed, counted = (Rates(small_config().trainer, timed=timed) for timed in (True, False))
    now = 20.0
    schedule.begin()
    for instant, warm in ((20.0, False), (39.0, False), (41.0, True), (200.0, True)):
        now = instant
        assert timed.warm(schedule.progress(0)) is warm
        assert not counted.warm(schedule.progress(0))


def test_with_a_deadline_the_pace_says_how_many_steps_there_will_be(monkeypatch: pytest.MonkeyPatch):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    timed, counted = Schedule(8, deadline=100.0), Schedule(400, None)
    rates = Rates(small_config(surface_steps=40.0).trainer, timed=True)
    assert rates.surface(1.0, 3, timed.progress(3)) == 1.0
    timed.begin()
    for step in (0, 20, 200, 400):
        now = step / 4
        by_clock = rates.surface(1.0, step, timed.progress(step))
        assert by_clock == pytest.approx(rates.surface(1.0, step, counted.progress(step)))


def test_time_makes_progress(monkeypatch: pytest.MonkeyPatch):
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    schedule = Schedule(8, deadline=120.0)
    assert schedule.total_steps is None
    assert schedule.progress(1000) == 0.0
    schedule.begin()
    now = 105.0
    assert schedule.progress(0) == pytest.approx(0.25)
    now = 130.0
    assert schedule.progress(0) == 1.0
    now = 110.0
    schedule.begin(done=0.8)
    now = 111.0
    assert schedule.progress(0) == pytest.approx(0.9)


def test_a_deadline_in_the_past_is_the_end():
    schedule = Schedule(8, deadline=time.monotonic() - 5)
    schedule.begin()
    assert schedule.progress(0) == 1.0


def test_a_run_that_is_cut_short_has_a_fifth_left(monkeypatch: pytest.MonkeyPatch):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    schedule = Schedule(8, deadline=100.0)
    assert schedule.cut_short() is None
    schedule.begin()
    assert schedule.cut_short() is None
    now = 40.0
    assert schedule.cut_short() == pytest.approx(2.0)
    assert schedule.progress(0) == pytest.approx(0.8)
    now = 45.0
    assert schedule.progress(0) == pytest.approx(0.9)
    assert schedule.cut_short() is None
    now = 50.0
    assert schedule.progress(0) == pytest.approx(1.0)
    # What is done by count stays as long as it was asked for.
    counted = Schedule(8, None)
    counted.begin()
    assert counted.cut_short() is None


def test_a_run_gone_on_with_is_cut_short_too(monkeypatch: pytest.MonkeyPatch):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    schedule = Schedule(8, deadline=100.0)
    schedule.begin(done=0.3)
    now = 10.0
    assert schedule.progress(0) == pytest.approx(0.4)
    assert schedule.cut_short() == pytest.approx(2.0)
    # Four fifths of the new length are what 40 of 100 seconds were.
    now = 20.0
    assert schedule.progress(0) == pytest.approx(1.0)


def test_stages_need_shares():
    stage = StageConfig(share=0.0, level=0, image_scale=1.0, inner_steps=1, outer_views=1)
    with pytest.raises(ValueError, match="positive shares"):
        Rates(small_config(stages=(stage,)).trainer, timed=False)


def test_shares_are_measured_however_fast_the_machine_is():
    for seconds_per_step in (1e-4, 0.5, 30.0):
        milestones = Milestones()
        milestones.charge(1e9 if seconds_per_step < 1 else 0.0)
        measured = []
        for step in range(1, 101):
            reason = milestones.due(step / 100, step * seconds_per_step)
            if reason is not None:
                milestones.add(step / 100, {"chamfer_ps": None, "psnr": None, "iou": None})
            if reason == "share":
                measured.append(step)
        assert measured == [25, 50, 75, 90]


def test_a_run_of_known_length_is_measured_twelve_times():
    milestones = Milestones(given=120.0)
    times = [second for second in range(1, 121) if milestones.due(0.0, float(second)) == "time"]
    assert times[:5] == [1, 2, 3, 4, 6]
    assert {later - before for before, later in itertools.pairwise(times[9:])} == {10}
    free = Milestones()
    times = [second for second in range(1, 1000) if free.due(0.0, float(second)) == "time"]
    assert times[-1] > 1.4 * times[-2]


def test_a_run_of_known_length_owes_no_late_shares():
    milestones, measured = Milestones(given=100.0), []
    for step in range(1, 101):
        if milestones.due(step / 100, 0.0) == "share":
            measured.append(step)
            milestones.add(step / 100, {})
    assert measured == [25, 50]


def test_the_first_surface_of_a_stage_is_measured_once():
    milestones = Milestones()
    milestones.charge(1e9)
    assert milestones.due(0.0, 0.0) is None
    milestones.enter_stage()
    assert [milestones.due(0.3, 2.0) for _ in range(2)] == ["stage", "share"]


def test_times_are_measured_where_that_is_cheap():
    milestones = Milestones()
    assert milestones.due(0.01, 0.5) is None
    assert milestones.due(0.01, 1.1) == "time"
    assert milestones.due(0.01, 1.4) is None
    milestones.charge(0.3)
    assert milestones.due(0.01, 2.1) is None
    assert milestones.due(0.01, 9.0) == "time"


def test_a_run_of_known_length_keeps_time_for_its_end():
    """With rows of 0.88 s, the last, the result and those in between come to 9 % of 120 s at most."""
    milestones = Milestones(given=120.0)
    spent = 0.0
    for second in range(1, 120):
        if milestones.due(0.0, float(second)) is not None:
            milestones.add(0.0, {})
            milestones.charge(0.88)
            spent += 0.88
    assert len(milestones.rows) == 6
    assert spent + 6 * 0.88 <= 0.09 * 120


def test_a_start_that_is_dear_to_measure_is_measured_once():
    """A row of it takes several of the others, each of which is worth more."""
    cheap, dear, free = Milestones(given=120.0), Milestones(given=120.0), Milestones()
    for milestones, seconds in ((cheap, 0.9), (dear, 1.2), (free, 3.0)):
        assert milestones.start_due()
        milestones.charge(seconds)
    assert [milestones.start_due() for milestones in (cheap, dear, free)] == [True, False, True]
    dear.charge(0.8)
    assert dear.due(0.0, 1.0) == "time"


def test_milestones_are_the_first_rows_at_a_share_and_the_last_of_all():
    milestones = Milestones()
    for progress, psnr in ((0.0, 1.0), (0.3, 2.0), (0.5, 3.0), (1.0, 4.0), (1.0, 5.0)):
        milestones.add(progress, {"chamfer_ps": None, "psnr": psnr, "iou": None})
    assert [(row["share"], row["psnr"]) for row in milestones.shares()] == [(0.25, 2.0), (0.5, 3.0), (1.0, 5.0)]
    assert milestones.latest("psnr") == 5.0
    stopped = Milestones(milestones.rows[:2])
    assert [row["share"] for row in stopped.shares()] == [0.25]
    assert Milestones().latest("psnr") is None


def test_what_a_stage_has_measured_begins_with_it():
    milestones = Milestones()
    assert milestones.of_stage("psnr") == []
    told = [("start", None), ("stage", 30.0), ("time", 33.0), ("stage", 31.0), ("time", None), ("share", 34.0)]
    for number, (reason, psnr) in enumerate(told):
        milestones.add(0.1 * number, {"reason": reason, "psnr": psnr})
    assert milestones.of_stage("psnr") == [(pytest.approx(0.3), 31.0), (0.5, 34.0)]


def test_what_is_cut_short_is_further_along():
    milestones = Milestones()
    for progress in (0.0, 0.1, 0.4):
        milestones.add(progress, {"reason": "time"})
    milestones.cut_short(2.0)
    assert [row["progress"] for row in milestones.rows] == [0.0, 0.2, 0.8]
    # What was to be measured on the way is behind it now.
    assert milestones.due(0.85, 0.0) is None
    assert milestones.due(0.9, 0.0) == "share"


def test_the_clock_leaves_pauses_out(monkeypatch: pytest.MonkeyPatch):
    now = 10.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    clock = TrainingClock(started=4.0, trained=2.0)
    assert clock.train_seconds == 2.0
    clock.start()
    now = 13.0
    with clock.pause():
        now = 20.0
        with clock.pause():
            now = 21.0
        assert clock.train_seconds == 5.0
    now = 22.0
    clock.stop()
    now = 30.0
    assert clock.train_seconds == 6.0
    assert clock.wall_seconds == 26.0


def test_the_process_began_before_now():
    assert 0 < process_start() < IMPORTED


def test_views_are_held_out_evenly():
    chosen, held = split_views(25, 10)
    assert list(held) == [5, 15]
    assert sorted([*chosen, *held]) == list(range(25))
    assert split_views(9, 10) == (range(9), ())
    assert split_views(30, 0) == (range(30), ())


def test_held_out_views_are_as_many_as_may_be_looked_at(scene: Scene):
    views = [replace(scene.train[0], name=str(number)) for number in range(15)]
    pixels = views[0].camera.width * views[0].camera.height
    assert some_views(views, 5, 100 * pixels) == views[::3]
    assert some_views(views, 15, 100 * pixels) == views
    assert some_views(views[:12], 10, 4 * pixels) == views[:12:3]
    assert some_views(views, 10, 1) == views[::5]
    assert some_views(views[:2], 10, 1) == views[:2]
    assert some_views([], 10, 1) == []


def test_what_is_no_surface_yet_is_not_measured():
    milestones = Milestones(given=60.0)
    milestones.wait()
    assert [milestones.due(0.0, float(second)) for second in range(5)] == [None] * 5
    assert milestones.due(0.0, 5.0) == "time"
    free = Milestones()
    free.wait()
    assert free.due(0.2, 9.0) is None
    assert free.due(0.3, 9.0) == "share"


def test_measurements_leave_half_of_a_known_length_to_learn_in():
    milestones = Milestones(given=100.0)
    milestones.charge(15.0)
    assert milestones.due(0.3, 0.5) is None  # 15 so far, 15 more, twice that at the end.
    cheap = Milestones(given=100.0)
    cheap.charge(12.0)
    assert cheap.due(0.3, 0.5) == "share"
    assert cheap.seconds_of_end == 24.0


def test_a_deadline_moves_only_to_the_front(monkeypatch: pytest.MonkeyPatch):
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    schedule = Schedule(8, 100.0)
    schedule.begin()
    now = 40.0
    schedule.end_by(200.0)
    assert schedule.progress(1) == 0.4
    schedule.end_by(80.0)
    assert schedule.progress(1) == 0.5
    counted = Schedule(8, None)
    counted.end_by(1.0)
    assert counted.progress(2) == 0.25


def test_what_costs_more_each_time_is_not_measured_as_if_it_cost_what_it_did():
    """Surfaces of Gaussians grow: the latest measurement tells what the next one costs, where it cost more."""
    grown = Milestones(given=600.0)
    for seconds in (22.0, 50.0, 150.0):
        grown.charge(seconds)
    assert grown.seconds_of_end == 300.0
    grown.enter_stage()
    assert grown.due(0.8, 0.5) is None
    assert grown.due(0.9, 0.5) is None  # Nor is it made up for later.
    shrunk = Milestones(given=600.0)
    for seconds in (30.0, 2.0, 2.0):
        shrunk.charge(seconds)
    assert shrunk.seconds_of_end == 4.0
    shrunk.enter_stage()
    assert shrunk.due(0.8, 0.5) == "stage"
