"""Stopping, resuming, failing: a run's directory is always worth having."""

import json
import os
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_runs import ONE_STAGE, TWO_STAGES, files_of, finished, method_of, small_config, train
from torch import Tensor

from sculpt_framework.cli.data import write_masks
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine import steering as steering_module
from sculpt_framework.engine.checkpoint import Progress, read_checkpoint, write_checkpoint
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.engine.run import load_finished, run, run_status
from sculpt_framework.engine.session import Session
from sculpt_framework.engine.steering import Steering
from sculpt_framework.errors import CheckpointError, ConfigError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.curve import read_curve
from sculpt_framework.evaluation.evaluator import Evaluator
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.events import Event
from sculpt_framework.folder_lock import only_one
from sculpt_framework.frame import WorldFrame, write_frame
from sculpt_framework.reconstructor import Moment, StepReport
from sculpt_framework.sculpting.method import Sculpting
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.stop_rule import StopRule
from sculpt_framework.types import Scene
from sculpt_framework.viewing.run_folder import RunFolder
from sculpt_plugins.appearances.per_gaussian.config import PerGaussianConfig
from sculpt_plugins.backgrounds.gaussians.config import GaussiansBackgroundConfig
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig

LEARNABLE = FlexiCubesConfig(split="center", learn_weights=True, learn_deformation=True)
VARIANTS = {
    "default": small_config(steps=6, stages=TWO_STAGES),
    "background": small_config(steps=6, stages=TWO_STAGES, background=GaussiansBackgroundConfig(near=0, far=50)),
    "learnable": small_config(steps=6, stages=TWO_STAGES, extractor=LEARNABLE, appearance=PerGaussianConfig()),
}
Saved = tuple[Mapping[str, Tensor], Progress]


def stopped_after(config: MethodConfig, scene: Scene, steps: int, saved: Saved | None = None) -> Saved:
    """The checkpoint of a run that is told to stop after so many outer steps."""
    kept: list[Saved] = []
    outer = 0

    def count(event: Event) -> None:
        nonlocal outer
        outer += event.event == "outer_step"

    session = Session(scene, config, emit=count, save_state=lambda *state: kept.append(state), saved=saved)
    finished(session, lambda: outer >= steps)
    return kept[-1]


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_resumed_run_ends_as_an_unbroken_one(scene: Scene, variant: str, tmp_path: Path):
    config = VARIANTS[variant]
    whole = train(config, scene).result
    # At the very end of a stage, in the middle of one, and before the first step of all.
    saved = None
    for steps in (0, 3, 1):
        write_checkpoint(tmp_path, *stopped_after(config, scene, steps, saved))
        saved = read_checkpoint(tmp_path)
    assert saved[1].outer == 4
    resumed = finished(Session(scene, config, saved=saved))
    np.testing.assert_array_equal(whole.vertices, resumed.vertices)
    np.testing.assert_array_equal(whole.faces, resumed.faces)
    np.testing.assert_array_equal(whole.colors, resumed.colors)


def test_a_saved_run_with_cells_of_several_sizes_can_be_looked_at(scene: Scene):
    """Before its next step: the seeds are cells that only the images of its stage explain."""
    stage = replace(ONE_STAGE[0], level=2)
    config = small_config(steps=2, stages=(stage,), cell_pixels=4.0, base_cells=6)
    saved = stopped_after(config, scene, 2)
    session = Session(scene, config, saved=saved)
    session.show_saved()
    method = method_of(session)
    assert method.snapshot() is not None
    assert len(method.mesh().faces) > 100
    assert method.trainer.scene.blur > 0


@pytest.mark.slow
def test_measuring_saving_and_watching_leave_training_as_it_is(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    config = VARIANTS["learnable"]
    plain = train(config, scene).result
    due = Milestones.due
    monkeypatch.setattr(Milestones, "due", lambda self, *where: due(self, *where) or "time")
    hasty = replace(config, checkpoint_seconds=1e-9)
    events: list[Event] = []
    session = Session(scene, hasty, emit=events.append, save_state=lambda *state: None)
    monkeypatch.setattr(steering_module, "SNAPSHOT_SHARE", 1e9)
    steering = Steering(session, folder=tmp_path, snapshot_seconds=0.0)
    watched = finished(session, steering)
    # Of the start, and after every step.
    assert sum(event.event == "snapshot" for event in events) == config.steps + 1
    np.testing.assert_array_equal(plain.vertices, watched.vertices)


def test_the_best_state_survives_a_stop(scene: Scene):
    _, progress = stopped_after(small_config(stages=ONE_STAGE), scene, 6)
    state, _ = stopped_after(small_config(stages=ONE_STAGE), scene, 6)
    assert progress.best_psnr is not None
    assert any(name.startswith("best/field/") for name in state)


def test_time_left_is_the_share_that_was_left(scene: Scene):
    state, progress = stopped_after(small_config(stages=TWO_STAGES), scene, 4)
    events: list[Event] = []
    # Within this time nothing can be trained any more: what was done counts, and no stage is gone back to.
    config = small_config(stages=TWO_STAGES, max_time=1.0)
    saved = (state, replace(progress, progress=0.6))
    Session(scene, config, emit=events.append, started=time.monotonic() - 60.0, saved=saved).run()
    assert next(event.data["index"] for event in events if event.event == "stage") == int(state["stage"])
    assert all(event.data["progress"] >= 0.6 for event in events if event.event == "evaluation")


@pytest.mark.parametrize(("level_gain_db", "limit"), [(0.1, 1e6), (0.0, 4e3)])
def test_a_curve_that_is_level_ends_a_run_early(
    scene: Scene,
    level_gain_db: float,
    limit: float,
    monkeypatch: pytest.MonkeyPatch,
    time_passes: Callable[[float], None],
):
    """Its steps take a few minutes each, by a clock that waits for nobody."""
    update = BiLevelTrainer.update

    def slow(*arguments: Any) -> Any:
        time_passes(300.0)
        return update(*arguments)

    monkeypatch.setattr(BiLevelTrainer, "update", slow)
    monkeypatch.setattr(StopRule, "gain", lambda self, watched: -1.0)
    events: list[Event] = []
    config = small_config(max_time=limit, steps=4, level_gain_db=level_gain_db, polish_steps=0)
    Session(scene, config, emit=events.append).run()
    told = [event for event in events if event.event == "decision" and event.data["item"] == "time"]
    if level_gain_db == 0.0:
        # Not asked for: all the time is taken.
        assert not told
        return
    # After as many steps as it takes anyway, it ends in a fifth of its new length, not after hours.
    [early] = told
    assert early.outer >= 4
    last = events[-1]
    assert last.data["progress"] == 1.0
    assert last.t_wall < 0.1 * limit
    began = next(event.t_wall for event in events if event.event == "stage")
    assert early.data["run_cut_to"] == pytest.approx((early.t_wall - began) / 0.8 / limit, rel=0.5)


@pytest.mark.parametrize(("lead_db", "gone_back"), [(0.1, False), (1.0, True)])
def test_an_earlier_state_is_kept_if_it_is_clearly_better(
    scene: Scene, lead_db: float, gone_back: bool, monkeypatch: pytest.MonkeyPatch
):
    """The last one has lower rates behind it; a tenth of a decibel on a few held-out views is chance."""
    events: list[Event] = []
    session = Session(scene, small_config(steps=4, polish_steps=0), emit=events.append)
    measure = Evaluator.measure

    def scripted(evaluator: Evaluator, *words: Any) -> dict[str, Any]:
        return {**measure(evaluator, *words), "psnr": 30.0 - lead_db * (session.step == 4)}

    monkeypatch.setattr(Evaluator, "measure", scripted)
    session.run()
    told = [event for event in events if event.event == "decision" and event.data["item"] == "kept state"]
    assert bool(told) is gone_back


@pytest.mark.parametrize("steps", [4, 10, 13])
def test_colours_are_polished_for_as_many_steps_as_asked_for(scene: Scene, steps: int):
    taken = []
    for asked in (0, steps):
        session = Session(scene, small_config(steps=1, polish_steps=asked))
        finished(session)
        taken.append(method_of(session).trainer.inner_total)
    assert taken[1] - taken[0] == steps


@pytest.mark.parametrize(("first", "rates"), [(3.0, [3.0 * 0.1**0.5, 0.3]), (0.2, [0.2, 0.2])])
def test_rates_of_polishing_fall_to_the_last_ones(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, first: float, rates: list[float]
):
    inner_loop, taken = BiLevelTrainer.inner_loop, []

    def watched(trainer: BiLevelTrainer, surface: Any, images: Any, steps: int, rate_factor: float, *rest: Any) -> Any:
        taken.append(rate_factor)
        return inner_loop(trainer, surface, images, steps, rate_factor, *rest)

    monkeypatch.setattr(BiLevelTrainer, "inner_loop", watched)
    finished(Session(scene, small_config(steps=1, polish_steps=20, polish_rate=first, final_rate=0.3)))
    assert taken[-2:] == pytest.approx(rates)


def test_colours_may_be_polished_on_more_gaussians(scene: Scene):
    session = Session(scene, small_config(steps=2, polish_steps=10, polish_gaussians=3))
    result = finished(session)
    assert len(result.gaussians) == 3 * len(result.faces)
    assert torch.isfinite(result.gaussians.sh).all()


def test_colours_that_break_are_those_of_training_on_as_many_gaussians(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    from sculpt_framework.sculpting import method

    def breaking(*arguments: Any, **options: Any) -> Any:
        raise FloatingPointError("the objective is not finite")

    monkeypatch.setattr(method, "polish", breaking)
    events: list[Event] = []
    session = Session(scene, small_config(steps=2, polish_steps=10, polish_gaussians=3), emit=events.append)
    result = finished(session)
    assert len(result.gaussians) == len(result.faces)
    assert any("colours are as training left them" in str(event.data) for event in events)


def test_a_slow_start_takes_nothing_from_the_rates(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, time_passes: Callable[[float], None]
):
    """A tenth of the time given is gone when optimisation begins; it begins with full rates."""
    from sculpt_framework.sculpting import method

    fit, settle = method.fit_to_views, BiLevelTrainer.settle
    rates: list[float] = []

    def slow_fit(*arguments: Any) -> float:
        time_passes(600.0)
        return fit(*arguments)

    def watched(trainer: BiLevelTrainer, images: Any, stage: Any, rate: float, warm: Any) -> Any:
        rates.append(rate)
        return settle(trainer, images, stage, rate, warm)

    monkeypatch.setattr(method, "fit_to_views", slow_fit)
    monkeypatch.setattr(BiLevelTrainer, "settle", watched)
    config = small_config(max_time=6000.0, polish_steps=0)
    finished(Session(scene, config), lambda: bool(rates))
    assert rates[0] > 0.9
    assert config.trainer.final_rate**0.1 < 0.9


# -- run directories -------------------------------------------------------------------------------------------------


def interrupt_after(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """A Ctrl-C in the middle of an outer step."""
    original = Sculpting.step

    def step(self: Sculpting, moment: Moment) -> StepReport:
        if moment.step == steps:
            os.kill(os.getpid(), signal.SIGINT)
        return original(self, moment)

    monkeypatch.setattr(Sculpting, "step", step)


def test_ctrl_c_saves_and_resume_ends_as_if_unbroken(
    config: MethodConfig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    unbroken, folder = tmp_path / "unbroken", tmp_path / "run"
    run(replace(config, output=unbroken), resume=None, started=0.0)
    with monkeypatch.context() as patch:
        interrupt_after(patch, 1)
        run(config, resume=None, started=0.0)
    assert run_status(folder) == "stopped"
    assert certify(load_mesh(folder / "mesh.ply").vertices, load_mesh(folder / "mesh.ply").faces).watertight
    assert load_finished(folder).test_measures()["psnr"] > 10

    half = folder / "checkpoints" / ".latest.safetensors.1.partial"
    half.touch()
    with (
        only_one(folder / "checkpoints", ""),
        pytest.raises(ConfigError, match=r"another process works in .*; wait for it, or stop it"),
    ):
        run(config, resume=folder, started=0.0)
    assert half.is_file()
    run(config, resume=folder, started=0.0)
    assert not half.is_file()
    assert run_status(folder) == "finished"
    assert (folder / "mesh.ply").read_bytes() == (unbroken / "mesh.ply").read_bytes()
    times = [row["t_train_s"] for row in read_curve(folder / "curve.csv")]
    assert times == sorted(times)
    assert write_masks(str(folder), tmp_path / "masks", None)[0] == f"{tmp_path / 'masks'}: 13 masks"
    assert len(list((tmp_path / "masks").rglob("*.png"))) == 13

    before = files_of(folder)
    capsys.readouterr()
    run(config, resume=folder, started=0.0)
    assert files_of(folder) == before
    assert capsys.readouterr().out.count("\n") == 1


@pytest.mark.slow
def test_a_run_without_a_recorder_can_be_looked_at_and_gone_on_with(
    config: MethodConfig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    folder, silent = tmp_path / "run", replace(config, observers=())
    with monkeypatch.context() as patch:
        interrupt_after(patch, 1)
        run(silent, resume=None, started=0.0)
    stopped = RunFolder(folder)
    assert stopped.read_news() == []
    result = stopped.newest()
    assert result is not None
    # As if it had been killed: a checkpoint is all there is.
    (folder / "mesh.ply").unlink()
    frame = stopped.newest()
    assert frame is not None
    assert frame.outer == 2
    np.testing.assert_allclose(frame.vertices, result.vertices, atol=1e-5)
    np.testing.assert_array_equal(frame.faces, result.faces)
    run(silent, resume=folder, started=0.0)
    assert (folder / "mesh.ply").is_file()


def test_nothing_is_learned_from_test_views_the_reference_or_the_frame(
    config: MethodConfig, scene_folder: Path, tmp_path: Path
):
    import shutil

    bare = tmp_path / "bare" / scene_folder.name
    shutil.copytree(scene_folder, bare)
    shutil.rmtree(bare / "test")
    (bare / "transforms_test.json").unlink()
    (bare / "gt_mesh.ply").unlink()
    write_frame(WorldFrame(metres_per_unit=0.25, up=(0.0, 0.6, 0.8)), bare)
    run(config, resume=None, started=0.0)
    run(replace(config, data=str(bare), output=tmp_path / "without"), resume=None, started=0.0)
    assert (tmp_path / "run" / "mesh.ply").read_bytes() == (tmp_path / "without" / "mesh.ply").read_bytes()
    final = json.loads((tmp_path / "run" / "metrics.json").read_text(encoding="utf-8"))["final"]
    assert final["point_to_point"] > 0
    assert final["accuracy"] > 0
    assert (
        "point_to_point" not in json.loads((tmp_path / "without" / "metrics.json").read_text(encoding="utf-8"))["final"]
    )
    # Those who look at the run find the frame in it.
    taken = json.loads((tmp_path / "without" / "frame.json").read_text(encoding="utf-8"))
    assert taken == {"metres_per_unit": 0.25, "up": [0.0, 0.6, 0.8]}
    assert not (tmp_path / "run" / "frame.json").exists()


def test_a_checkpoint_of_other_components_is_one_line(scene: Scene):
    saved = stopped_after(small_config(), scene, 2)
    with pytest.raises(CheckpointError, match=r"does not fit the run's config\.json"):
        Session(scene, small_config(appearance=PerGaussianConfig()), saved=saved).run()


def test_a_start_that_takes_all_the_time_is_told_of(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    """What is left is colours, for a few steps, which learn as they do at the beginning of a run."""
    inner_loop, rates = BiLevelTrainer.inner_loop, list[float]()

    def watched(trainer: BiLevelTrainer, surface: Any, images: Any, steps: int, rate: float, *more: Any) -> Any:
        rates.append(rate)
        return inner_loop(trainer, surface, images, steps, rate, *more)

    monkeypatch.setattr(BiLevelTrainer, "inner_loop", watched)
    events: list[Event] = []
    config = small_config(max_time=1.0, warm_up_steps=300, polish_steps=0)
    Session(scene, config, emit=events.append, started=time.monotonic() - 60.0).run()
    [warning] = [event.data["message"] for event in events if event.event == "warning"]
    assert warning.startswith("--max-time 1 was over before the start was made")
    assert events[-1].outer == 0
    assert events[-1].data["inner"] == 30 + config.trainer.stages[0].inner_steps
    assert rates == [1.0, 1.0, 1.0, config.trainer.final_rate]
