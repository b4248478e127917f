"""Scenes of a few small pictures and runs of a few seconds on them, with everything they tell kept."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from sculpt_framework import registry
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.objects import DemoObject, demo_object
from sculpt_framework.demo_scenes.reference import reference_mesh
from sculpt_framework.demo_scenes.tracing import render
from sculpt_framework.engine.session import Session
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.mesh_report import mesh_measures
from sculpt_framework.events import Event
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig, of_sculpting
from sculpt_framework.sculpting.method import Sculpting
from sculpt_framework.sculpting.reconstruction import Reconstruction
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.types import Box, Camera, Scene, View

PIXELS, VIEWS = 48, 12
_METHOD = "gaussian-sculpting-tiny"
_PARTS = {
    "field": {"num_levels": 4, "log2_table": 13, "finest_resolution": 32},
    "appearance": {"num_levels": 3, "log2_table": 12, "finest_resolution": 32},
}
"""Smaller grids than the method's: a run on tiny pictures needs no more."""

_TRUTH_CELLS, _SAMPLES = 64, 20_000

Before = Callable[[Session], None]
"""Called before every outer step."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A run that came to an end, well or not."""

    result: Reconstruction
    events: Sequence[Event]
    failure: str | None

    def of(self, name: str) -> list[Event]:
        return [event for event in self.events if event.event == name]

    @property
    def psnr(self) -> float:
        """Of held-out views at the end of optimisation, dB; of train views none is held out without enough of them."""
        return float(self.of("evaluation")[-1].data["psnr"])

    @property
    def sound(self) -> bool:
        """The mesh is closed and all its numbers are finite."""
        return bool(certify(self.result.vertices, self.result.faces).watertight)


def ball_box() -> Box:
    """What holds the demo objects."""
    return Box(minimum=torch.full((3,), -1.0), maximum=torch.full((3,), 1.0))


def view_of(item: DemoObject, camera: Camera, name: str) -> View:
    rgb, alpha = render(item, camera)
    return View(name=name, camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(alpha))


def small_scene(name: str = "blob", views: int = VIEWS, pixels: int = PIXELS) -> Scene:
    """A demo object in memory."""
    return scene_of(demo_object(name), demo_cameras(views, pixels))


def scene_of(item: DemoObject, cameras: Sequence[Camera]) -> Scene:
    train = tuple(view_of(item, camera, f"r_{index}") for index, camera in enumerate(cameras))
    return Scene(name=item.name, train=train, test=(), box=ball_box())


def small_method(steps: int = 16, inner_steps: int = 2, **changes: object) -> SculptingConfig:
    """The tiny method, smaller still. ``changes`` are fields of the method, or of its trainer."""
    base = of_sculpting(registry.load_method(_METHOD)())
    stage = StageConfig(share=1.0, level=0, image_scale=1.0, inner_steps=inner_steps, outer_views=2)
    trainer = replace(base.trainer, base_cells=14, fit_steps=60, polish_steps=4, stages=(stage,))
    parts = {slot: replace(getattr(base, slot), **options) for slot, options in _PARTS.items()}
    config = replace(base, **parts, observers=(), steps=steps, trainer=trainer, data="small")
    return changed(config, changes)


def changed(config: SculptingConfig, changes: Mapping[str, object]) -> SculptingConfig:
    """With fields of the method, or of its trainer, set to other values."""
    inside = {name: value for name, value in changes.items() if name in type(config.trainer).__dataclass_fields__}
    around = {name: value for name, value in changes.items() if name not in inside}
    return replace(config, trainer=replace(config.trainer, **inside), **around)  # pyright: ignore[reportArgumentType]


def train(config: SculptingConfig, scene: Scene, before: Before | None = None) -> Outcome:
    """Run to the end. Raises TrainingFailed if there never was a surface."""
    events: list[Event] = []
    session = Session(scene, config, emit=events.append)
    for report in session:
        if before is not None and report.progress < 1:
            before(session)
    return Outcome(result=method_of(session).reconstruction(), events=events, failure=session.failure)


def truth_of(item: DemoObject) -> MeasuredMesh:
    """A fine mesh of the object, to measure against."""
    vertices, faces = reference_mesh(item.distance, _TRUTH_CELLS)
    return MeasuredMesh(Mesh(vertices=vertices, faces=faces), _SAMPLES)


def chamfer(outcome: Outcome, truth: MeasuredMesh) -> float:
    """Of a run's result, world units."""
    mesh = Mesh(vertices=outcome.result.vertices, faces=outcome.result.faces)
    return float(mesh_measures(mesh, truth, _SAMPLES)["chamfer_ps"] or math.nan)


def method_of(session: Session) -> Sculpting:
    """What a run is made of, for those who break it on purpose."""
    assert isinstance(session.reconstructor, Sculpting), "methods here are of this kind"  # noqa: S101
    return session.reconstructor


def trainer_of(session: Session) -> BiLevelTrainer:
    return method_of(session).trainer
