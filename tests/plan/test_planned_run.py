"""A planned run: what is left out is not there, the plan is kept, told, priced and honoured on resume."""

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from sculpt_framework import registry
from sculpt_framework.command_line.request import read_request
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.run import run
from sculpt_framework.engine.session import Session
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.events import Event
from sculpt_framework.plan.make import plan_scene
from sculpt_framework.plan.options import with_options
from sculpt_framework.plan.savings import savings
from sculpt_framework.sculpting.assembly import build_parts
from sculpt_framework.sculpting.config import PlanConfig
from sculpt_framework.sculpting.term_gating import TermGating
from sculpt_framework.serialization import read_config
from sculpt_framework.types import Scene
from sculpt_plugins.observers.recorder.config import RecorderConfig


def small(mode: str = "on", **trainer: object) -> MethodConfig:
    base = registry.load_method("gaussian-sculpting-tiny")()
    stage = replace(base.trainer.stages[0], share=1.0, image_scale=1.0, level=0, inner_steps=4)
    short = replace(base.trainer, base_cells=14, fit_steps=40, polish_steps=40, stages=(stage,))
    return replace(
        base,
        method="no-method-of-the-registry",  # so that nothing counts as set by hand
        plan=PlanConfig(mode="on" if mode == "on" else "off"),
        observers=(RecorderConfig(step_seconds=0.0),),
        steps=4,
        holdout_every=5,
        trainer=replace(short, **trainer),
    )


def test_the_default_is_planned_and_the_yardstick_is_not() -> None:
    assert set(registry.load_method("gaussian-sculpting")().plan.items) == {
        *("silhouette", "stereo", "light", "views", "level", "images", "refinement", "sh_degree"),
        *("gaussians", "constraints", "places", "polish"),
    }
    for name in ("gaussian-sculpting-everything", "gaussian-sculpting-paper", "gaussian-sculpting-tiny"):
        assert registry.load_method(name)().plan.items == ()


def test_what_is_left_out_has_no_parameters(scene: Scene) -> None:
    config = replace(small(), plan=PlanConfig(places="on", sh_degree="on"))
    rich = with_options(config, "appearance", sh_degree=2)
    full = build_parts(rich, scene.box, torch.Generator()).trainer
    planned, _ = plan_scene(with_options(config, "appearance", sh_degree=0), scene)
    lean = build_parts(planned, scene.box, torch.Generator()).trainer
    assert full.scene.geometry_rows.rates
    assert lean.scene.geometry_rows.rates == {}
    assert not lean.scene.learns_places
    assert lean.objectives.constraints == []
    means = torch.zeros(5, 1, 3)
    numbers = [
        sum(row.numel() for row in [*t.scene.binder.new_rows(5, means.device, means.dtype).values()])
        + sum(row.numel() for row in t.scene.appearance.new_rows(means).values())
        for t in (full, lean)
    ]
    # Logits, ratios and angle of the places; 9 and 1 colours.
    assert numbers == [5 * (3 + 2 + 1 + 27), 5 * 3]


@pytest.mark.slow
def test_what_is_left_out_is_not_imported(scene_folder: Path) -> None:
    script = (
        "import sys, torch\nfrom sculpt_framework.command_line.request import parse\n"
        "from sculpt_framework.plan.make import plan_scene\n"
        "from sculpt_framework.sculpting.assembly import build_parts\n"
        f"config = parse(['gaussian-sculpting-tiny', '--data', {str(scene_folder)!r}, '--plan', sys.argv[1]])\n"
        "scene = config.dataset.build(config.data).load()\n"
        "config, plan = plan_scene(config, scene)\n"
        "build_parts(config, scene.box, torch.Generator())\n"
        "print(*sys.modules)"
    )
    modules = {}
    for mode in ("on", "off"):
        done = subprocess.run(
            [sys.executable, "-c", script, mode],
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
            encoding="utf-8",
        )
        assert done.returncode == 0, done.stderr
        modules[mode] = set(done.stdout.split())
    gone = modules["off"] - modules["on"]
    assert {f"sculpt_plugins.constraints.{name}.constraint" for name in ("mee_scale", "boundary", "spacing")} <= gone


def test_without_a_plan_nobody_looks(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    def look(_: Scene) -> None:
        raise AssertionError("the scene was looked at")

    monkeypatch.setattr("sculpt_framework.plan.make.gather", look)
    config = small("off")
    assert plan_scene(config, scene) == (config, None)


@pytest.mark.slow
def test_a_run_keeps_its_plan_and_goes_on_with_it(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    config = replace(small(polish_gain_db=50.0), data=str(scene_folder), output=folder)
    run(config, resume=None, started=time.monotonic())
    kept, plan = read_config(folder / "config.json"), json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    decided = {decision["item"] for decision in plan["decisions"]}
    assert {"views", "places", "inner-steps"} <= decided
    assert kept.skip_views == ("train/again",)
    assert vars(kept.binder)["places"] == "fixed"
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "What this scene did not need" in page
    assert "--plan.places off" in page
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text(encoding="utf-8").splitlines()]
    assert [event["event"] for event in events[:2]] == ["plan", "run_started"]
    assert events[1]["data"]["views"] == 8
    # After thirty of forty steps the later half had gained less than fifty decibels.
    (polish,) = [each["data"] for each in events if each["data"].get("item") == "polish"]
    assert polish["spared"] == 10
    saved = {each.item: each for each in savings(plan, events)}
    assert saved["views"].megabytes == pytest.approx(48 * 48 * 32 / 2**20)
    seconds = saved["inner-steps"].seconds
    assert seconds is not None
    assert seconds > 0
    # As if it had been killed after its checkpoint.
    (folder / "metrics.json").unlink()

    def look(_: Scene) -> None:
        raise AssertionError("the scene was looked at again")

    monkeypatch.setattr("sculpt_framework.plan.make.gather", look)
    request = read_request(["--resume", str(folder)])
    assert replace(request.config, output=None) == replace(kept, output=None)
    before = (folder / "plan.json").read_bytes()
    run(request.config, resume=folder, started=time.monotonic())
    assert (folder / "plan.json").read_bytes() == before
    assert json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["status"] == "finished"


def test_a_plan_cannot_be_changed_on_resume(tmp_path: Path, scene_folder: Path) -> None:
    from sculpt_framework.serialization import config_to_json

    (tmp_path / "config.json").write_text(config_to_json(replace(small(), data=str(scene_folder))), encoding="utf-8")
    with pytest.raises(ConfigError, match="plan cannot be changed"):
        read_request(["--resume", str(tmp_path), "--plan", "off"])


def test_views_that_are_not_there_cannot_be_left_out(scene: Scene) -> None:
    with pytest.raises(ConfigError, match="--skip-views nobody"):
        Session(scene, replace(small("off"), skip_views=("nobody",)))
    with pytest.raises(ConfigError, match="names all"):
        Session(scene, replace(small("off"), skip_views=tuple(view.name for view in scene.train)))


def test_a_constraint_without_effect_rests_and_is_told(scene: Scene) -> None:
    events: list[Event] = []
    config = small("off", rest_after=2, bind_every=1, polish_steps=0)
    session = Session(scene, config, emit=events.append)
    session.run()
    told = {event.data["item"]: event.data for event in events if event.event == "decision"}
    # With one Gaussian on a face these two are constant.
    assert told["spacing"]["value"].startswith("rests")
    assert told["coverage"]["term"] == 0.0
    spared = session.reconstructor.trainer.gating.spared
    assert spared["spacing"] > 4
    assert "boundary" not in spared


def test_rest_ends_when_a_term_acts_again() -> None:
    gating = TermGating(after=3)
    for _ in range(3):
        assert gating.due("hinge")
        gating.saw("hinge", 0.0, 1.0)
    assert [gating.due("hinge") for _ in range(6)] == [False, False, True, False, False, True]
    again = TermGating(after=3)
    again.load_state(gating.state())
    assert [again.due("hinge") for _ in range(3)] == [False, False, True]
    gating.saw("hinge", 0.5, 1.0)
    assert [gating.due("hinge") for _ in range(4)] == [True] * 4
    assert [(told["item"], told["value"]) for told in gating.news()][-1] == ("hinge", "acts again")
    assert gating.news() == []
    assert gating.spared == {"hinge": 4}


def test_a_term_that_acts_now_and_then_never_rests() -> None:
    gating = TermGating(after=3)
    for value in (0.0, 0.0, 1.0) * 5:
        assert gating.due("hinge")
        gating.saw("hinge", value, 1.0)
    never = TermGating(after=0)
    for _ in range(10):
        never.saw("hinge", 0.0, 1.0)
        assert never.due("hinge")


def test_a_scene_that_no_view_shows_is_one_line(scene: Scene) -> None:
    blank = tuple(replace(view, alpha=torch.zeros_like(view.rgb[..., 0])) for view in scene.train)
    with pytest.raises(DataError, match="no train view shows anything of the object's box"):
        plan_scene(small("on"), replace(scene, train=blank))
