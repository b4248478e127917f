"""When what happens: progress, stages, rates, measurements, clocks."""

import time

import pytest
from small_runs import ONE_STAGE, TWO_STAGES, small_config

from sculpt_framework.config import StageConfig
from sculpt_framework.engine.assembly import split_views
from sculpt_framework.engine.clock import TrainingClock, process_start
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.engine.schedule import Schedule


def test_steps_make_progress():
    schedule = Schedule(small_config(outer_steps=10, stages=TWO_STAGES).trainer, None)
    assert schedule.total_steps == 10
    assert [schedule.progress(outer) for outer in (0, 5, 10, 12)] == [0.0, 0.5, 1.0, 1.0]
    assert [schedule.stage_index(p) for p in (0.0, 0.49, 0.5, 1.0)] == [0, 0, 1, 1]
    assert schedule.stage(0.7) is TWO_STAGES[1]


def test_rates_fall_to_the_share_that_was_asked_for():
    schedule = Schedule(small_config(final_rate=0.05).trainer, None)
    rates = [schedule.rate_factor(progress / 10) for progress in range(11)]
    assert rates[0] == 1.0
    assert rates[-1] == pytest.approx(0.05)
    assert rates == sorted(rates, reverse=True)


def test_time_makes_progress_and_has_its_own_shares(monkeypatch: pytest.MonkeyPatch):
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    stages = (
        StageConfig(share=0.5, time_share=0.1, level=0, image_scale=1.0, inner_steps=1, outer_views=1),
        StageConfig(share=0.5, time_share=0.9, level=0, image_scale=1.0, inner_steps=1, outer_views=1),
    )
    schedule = Schedule(small_config(stages=stages).trainer, deadline=120.0)
    assert schedule.total_steps is None
    assert schedule.progress(1000) == 0.0
    schedule.begin()
    now = 105.0
    assert schedule.progress(0) == pytest.approx(0.25)
    assert schedule.stage_index(0.25) == 1
    now = 130.0
    assert schedule.progress(0) == 1.0
    now = 110.0
    schedule.begin(done=0.8)
    now = 111.0
    assert schedule.progress(0) == pytest.approx(0.9)


def test_a_deadline_in_the_past_is_the_end():
    schedule = Schedule(small_config(stages=ONE_STAGE).trainer, deadline=time.monotonic() - 5)
    schedule.begin()
    assert schedule.progress(0) == 1.0


def test_stages_need_shares():
    stage = StageConfig(share=0.0, level=0, image_scale=1.0, inner_steps=1, outer_views=1)
    with pytest.raises(ValueError, match="positive shares"):
        Schedule(small_config(stages=(stage,)).trainer, None)


def test_shares_are_measured_however_fast_the_machine_is():
    for seconds_per_step in (1e-4, 0.5, 30.0):
        milestones = Milestones()
        measured = []
        for step in range(1, 101):
            reason = milestones.due(step / 100, step * seconds_per_step, spent=1e9 if seconds_per_step < 1 else 0.0)
            if reason is not None:
                milestones.add(step / 100, {"chamfer_ps": None, "psnr": None, "iou": None})
            if reason == "share":
                measured.append(step)
        assert measured == [25, 50, 75, 90]


def test_times_are_measured_where_that_is_cheap():
    milestones = Milestones()
    assert milestones.due(0.01, 0.5, 0.0) is None
    assert milestones.due(0.01, 1.1, 0.0) == "time"
    assert milestones.due(0.01, 1.5, 0.0) is None
    assert milestones.due(0.01, 2.1, 1.0) is None
    assert milestones.due(0.01, 9.0, 0.1) == "time"


def test_a_run_of_known_length_may_measure_ahead():
    milestones = Milestones(given=120.0)
    assert milestones.due(0.01, 1.1, 2.0) == "time"
    assert milestones.due(0.02, 2.1, 3.5) == "time"
    assert milestones.due(0.03, 4.1, 4.0) is None
    assert milestones.due(0.1, 60.0, 4.0) == "time"


def test_milestones_are_the_first_rows_at_a_share_and_the_last_of_all():
    milestones = Milestones()
    for progress, psnr in ((0.0, 1.0), (0.3, 2.0), (0.5, 3.0), (1.0, 4.0), (1.0, 5.0)):
        milestones.add(progress, {"chamfer_ps": None, "psnr": psnr, "iou": None})
    assert [(row["share"], row["psnr"]) for row in milestones.shares()] == [(0.25, 2.0), (0.5, 3.0), (1.0, 5.0)]
    assert milestones.latest("psnr") == 5.0
    stopped = Milestones(milestones.rows[:2])
    assert [row["share"] for row in stopped.shares()] == [0.25]
    assert Milestones().latest("psnr") is None


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
    assert 0 <= time.monotonic() - process_start() < 24 * 3600


def test_views_are_held_out_evenly():
    chosen, held = split_views(25, 10)
    assert list(held) == [5, 15]
    assert sorted([*chosen, *held]) == list(range(25))
    assert split_views(9, 10) == (range(9), ())
    assert split_views(30, 0) == (range(30), ())
