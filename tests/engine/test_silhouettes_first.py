"""A start from a sphere takes its shape from the masks before colours count; other starts do not need it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from small_runs import TWO_STAGES, Outcome, small_config, train

from sculpt_framework.engine.session import Session
from sculpt_framework.errors import TrainingFailed
from sculpt_framework.events import Event
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.sculpting import silhouettes_first
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.stop_rule import StopRule
from sculpt_framework.types import Scene
from sculpt_plugins.initializers.sphere.config import SphereConfig
from sculpt_plugins.losses.silhouette.config import SilhouetteConfig


def shaping(outcome: Outcome) -> list[str]:
    return [event.data["value"] for event in outcome.of("decision") if event.data["item"] == "silhouettes first"]


def first_error(outcome: Outcome) -> float:
    """Chamfer distance of the surface that the first stage begins with."""
    return next(event.data["chamfer_ps"] for event in outcome.of("evaluation") if event.data["reason"] == "stage")


def from_sphere(scene: Scene, **changes: object) -> Outcome:
    config = small_config(initializer=SphereConfig(fill=0.4), steps=1, stages=TWO_STAGES, **changes)
    return train(config, scene)


@pytest.mark.slow
def test_a_sphere_comes_near_the_object_before_the_first_stage(scene: Scene):
    shaped = from_sphere(scene)
    assert len(shaping(shaped)) == 1
    losses = tuple(loss for loss in small_config().losses if not isinstance(loss, SilhouetteConfig))
    plain = from_sphere(scene, losses=losses)
    assert not shaping(plain)
    assert first_error(shaped) < 0.4 * first_error(plain)


@pytest.mark.slow
def test_it_is_repeatable(scene: Scene):
    first, second = (from_sphere(scene) for _ in range(2))
    assert torch.equal(torch.as_tensor(first.result.mesh.vertices), torch.as_tensor(second.result.mesh.vertices))


def test_without_masks_there_is_nothing_to_go_by(scene: Scene):
    bare = replace(scene, train=tuple(replace(view, alpha=None) for view in scene.train))
    assert not shaping(from_sphere(bare))


def test_starts_that_know_the_silhouettes_are_left_alone(scene: Scene):
    assert not shaping(train(small_config(steps=1), scene))


def test_a_method_that_begins_with_silhouettes_itself_is_left_alone(scene: Scene):
    own = (replace(TWO_STAGES[0], silhouette_only=True, inner_steps=0), TWO_STAGES[1])
    assert not shaping(train(small_config(initializer=SphereConfig(), steps=2, stages=own), scene))


def test_a_time_limit_leaves_most_for_the_stages(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, time_passes: Callable[[float], None]
):
    """With steps that take long and do not end of themselves."""
    update = BiLevelTrainer.update

    def slow(*arguments: Any) -> Any:
        time_passes(100.0)
        return update(*arguments)

    monkeypatch.setattr(BiLevelTrainer, "update", slow)
    monkeypatch.setattr(silhouettes_first, "STEPS", 1_000_000)
    monkeypatch.setattr(silhouettes_first, "RULE", StopRule(least_gain=0.0))
    config = small_config(initializer=SphereConfig(), stages=TWO_STAGES, max_time=2000.0)
    events: list[Event] = []
    Session(scene, config, emit=events.append).run()
    shaped = next(event.t_wall for event in events if event.data.get("item") == "silhouettes first")
    assert 250.0 < shaped < 1000.0
    assert any(event.event == "outer_step" for event in events)


def test_a_surface_that_is_lost_is_one_message(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    def lose(*_: object) -> None:
        raise EmptySurfaceError("no surface")

    monkeypatch.setattr(silhouettes_first, "find_seeds", lose)
    with pytest.raises(TrainingFailed, match="--initializer visual-hull"):
        from_sphere(scene)
