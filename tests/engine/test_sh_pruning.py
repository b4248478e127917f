"""Bands of the spherical harmonics that no held-out view sees are given up, and leave nothing behind."""

from collections.abc import Mapping

import pytest
from small_runs import ONE_STAGE, finished, small_config
from torch import Tensor

from sculpt_framework.appearances import bands
from sculpt_framework.config import AppearanceConfig, MethodConfig
from sculpt_framework.engine.checkpoint import Progress
from sculpt_framework.engine.session import Session
from sculpt_framework.events import Event
from sculpt_framework.sculpting.method import Sculpting
from sculpt_framework.types import Gaussians, Scene
from sculpt_plugins.appearances.color_field.config import ColorFieldConfig
from sculpt_plugins.appearances.per_gaussian.config import PerGaussianConfig

Saved = tuple[Mapping[str, Tensor], Progress]


def config_for(appearance: AppearanceConfig, rest_after: int = 2) -> MethodConfig:
    """All bands are active from the second inner step on."""
    return small_config(
        appearance=appearance,
        stages=ONE_STAGE,
        steps=4,
        polish_steps=10,
        rest_after=rest_after,
        sh_degree_every=1,
    )


def decisions(events: list[Event]) -> list[Event]:
    return [event for event in events if event.event == "decision" and event.data["item"] == "sh-degree"]


def worth(monkeypatch: pytest.MonkeyPatch, decibels: Mapping[int, float]) -> None:
    """Have held-out views be as good as this, by the degree they are rendered with."""

    def scripted(gaussians: Gaussians) -> float:
        return next(value for degree, value in decibels.items() if bands(degree) == gaussians.sh.shape[1])

    monkeypatch.setattr(Sculpting, "judge", property(lambda method: scripted))


@pytest.mark.parametrize("appearance", [ColorFieldConfig(sh_degree=2), PerGaussianConfig(sh_degree=2)])
def test_idle_bands_leave_no_rows_and_no_moments(
    scene: Scene, appearance: AppearanceConfig, monkeypatch: pytest.MonkeyPatch
):
    worth(monkeypatch, {0: 29.0, 1: 29.995, 2: 30.0})
    events: list[Event] = []
    saved: list[Saved] = []
    session = Session(scene, config_for(appearance), emit=events.append, save_state=lambda *state: saved.append(state))
    result = finished(session)
    [told] = decisions(events)
    assert told.outer == 2
    assert told.data["value"] == "degree 1, not 2"
    assert told.data["lost_db"] == pytest.approx(0.005)
    assert told.data["spared"] == 15
    assert result.gaussians.sh.shape[1] == 4
    state, _ = saved[-1]
    kept = {name.rpartition(".")[2] for name in state if name.startswith("scene/appearance.")}
    assert "band_1" in kept
    assert "band_2" not in kept


def test_bands_that_are_idle_together_go_together(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    worth(monkeypatch, {0: 30.0, 1: 30.01, 2: 30.0})
    events: list[Event] = []
    finished(Session(scene, config_for(ColorFieldConfig(sh_degree=2)), emit=events.append))
    assert [event.data["value"] for event in decisions(events)] == ["degree 0, not 2"]


def test_bands_that_are_seen_stay(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    worth(monkeypatch, {0: 30.0, 1: 30.0, 2: 30.1})
    events: list[Event] = []
    result = finished(Session(scene, config_for(ColorFieldConfig(sh_degree=2)), emit=events.append))
    assert not decisions(events)
    assert result.gaussians.sh.shape[1] == 9


def test_nothing_is_given_up_unasked(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    worth(monkeypatch, {0: 30.0, 1: 30.0, 2: 30.0})
    events: list[Event] = []
    finished(Session(scene, config_for(ColorFieldConfig(sh_degree=2), rest_after=0), emit=events.append))
    assert not decisions(events)


def test_a_run_is_gone_on_with_at_the_degree_it_had(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    """The config says 2, the checkpoint 0; what comes after is as if there had been no stop."""
    worth(monkeypatch, {0: 30.0, 1: 30.0, 2: 30.0})
    config = config_for(ColorFieldConfig(sh_degree=2))
    whole = finished(Session(scene, config))
    saved: list[Saved] = []
    outer = 0

    def count(event: Event) -> None:
        nonlocal outer
        outer += event.event == "outer_step"

    stopped = Session(scene, config, emit=count, save_state=lambda *state: saved.append(state))
    finished(stopped, lambda: outer >= 3)
    resumed = finished(Session(scene, config, saved=saved[-1]))
    assert resumed.gaussians.sh.shape[1] == 1
    assert (resumed.vertices == whole.vertices).all()
    assert (resumed.gaussians.sh == whole.gaussians.sh).all()
