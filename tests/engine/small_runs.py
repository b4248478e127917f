"""Runs of seconds: a small scene, small components, few steps."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch

from sculpt_framework import registry
from sculpt_framework.engine.session import Session
from sculpt_framework.events import Event
from sculpt_framework.export import atomic
from sculpt_framework.geometry.band import discover
from sculpt_framework.losses import TrainingImage
from sculpt_framework.posed_images.training_images import prepare_image
from sculpt_framework.sculpting.assembly import Parts, build_parts
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig, of_sculpting
from sculpt_framework.sculpting.method import Sculpting
from sculpt_framework.sculpting.reconstruction import Reconstruction
from sculpt_framework.types import Scene
from sculpt_plugins.appearances.color_field.config import ColorFieldConfig
from sculpt_plugins.fields.dense_grid.config import DenseGridFieldConfig
from sculpt_plugins.fields.hash_grid.config import HashGridFieldConfig
from sculpt_plugins.fields.mlp.config import MlpFieldConfig

FIELDS = {
    "hash-grid": HashGridFieldConfig(num_levels=4, log2_table=13, finest_resolution=32),
    "dense-grid": DenseGridFieldConfig(resolution=24),
    "mlp": MlpFieldConfig(hidden_layers=3, hidden_units=32, skip_layer=2, frequencies=3),
}
TWO_STAGES = (
    StageConfig(share=0.5, level=0, image_scale=0.5, inner_steps=2, outer_views=2),
    StageConfig(share=0.5, level=1, image_scale=1.0, inner_steps=2, outer_views=2),
)
ONE_STAGE = (StageConfig(share=1.0, level=0, image_scale=1.0, inner_steps=2, outer_views=2),)


def small_config(**changes: object) -> SculptingConfig:
    """The tiny method made smaller still. Names of fields of the trainer change the trainer, others the method."""
    base = of_sculpting(registry.load_method("gaussian-sculpting-tiny")())
    trainer = replace(base.trainer, base_cells=10, fit_steps=60, polish_steps=4, stages=ONE_STAGE)
    inside = {name: value for name, value in changes.items() if name in type(trainer).__dataclass_fields__}
    around = {name: value for name, value in changes.items() if name not in inside}
    return replace(
        base,
        **{
            "field": FIELDS["hash-grid"],
            "appearance": ColorFieldConfig(num_levels=3, log2_table=12, finest_resolution=32),
            "observers": (),
            "trainer": replace(trainer, **inside),
            "steps": 8,
            "data": "small",
            **around,
        },
    )


def on_a_sphere(config: SculptingConfig, scene: Scene) -> tuple[Parts, list[TrainingImage]]:
    """Components on a sphere, as the hash grid is built, with images to learn from."""
    parts = build_parts(config, scene.box, torch.Generator().manual_seed(0))
    trainer = parts.trainer
    trainer.seeds = discover(trainer.field, trainer.extractor.grid, 0)
    trainer.scene.blur = 0.01
    return parts, [prepare_image(view, scene.box, 0.5, parts.device) for view in scene.train]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    result: Reconstruction
    events: list[Event]

    def of(self, name: str) -> list[Event]:
        return [event for event in self.events if event.event == name]

    @property
    def losses(self) -> list[float]:
        return [event.data["loss"] for event in self.of("outer_step")]


def train(config: SculptingConfig, scene: Scene) -> Outcome:
    events: list[Event] = []
    session = Session(scene, config, emit=events.append)
    return Outcome(result=finished(session), events=events)


def method_of(session: Session) -> Sculpting:
    """What a session hosts, in these runs."""
    assert isinstance(session.reconstructor, Sculpting)
    return session.reconstructor


def finished(session: Session, stop: Callable[[], bool] = lambda: False) -> Reconstruction:
    """What the session ends with, told to stop where ``stop`` says so after the start or a step."""
    for _ in session:
        if stop():
            session.stop()
    return method_of(session).reconstruction()


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def fail_for(monkeypatch: pytest.MonkeyPatch, name: str, error: OSError) -> Callable[[], None]:
    """Let the system refuse files of that name."""
    original = os.replace

    def refuse(source: Path, target: Path) -> None:
        if Path(target).name == name:
            raise error
        original(source, target)

    monkeypatch.setattr(atomic.os, "replace", refuse)
    return lambda: monkeypatch.setattr(atomic.os, "replace", original)
