"""Without gradient isolation there is no inner loop, and the constraints on Gaussians act in the one step there is."""

from collections.abc import Mapping

import pytest
import torch
from torch import Tensor

from sculpt_framework import registry
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.geometry.band import discover
from sculpt_framework.posed_images.training_images import prepare_image
from sculpt_framework.sculpting.assembly import build_parts
from sculpt_framework.sculpting.config import SculptingConfig, of_sculpting
from sculpt_framework.types import Scene
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.constraints.boundary.config import BoundaryConfig
from sculpt_plugins.constraints.spacing.config import SpacingConfig
from sculpt_plugins.datasets.blender.config import BlenderConfig


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("scene") / "blob"
    write_scene(
        demo_object("blob"), DemoSettings(train_views=4, test_views=0, resolution=32, reference_cells=16), folder
    )
    return BlenderConfig().build(str(folder)).load()


def step(
    scene: Scene, isolated: bool, weight: float, silhouettes: bool = False, per_face: int = 3
) -> tuple[Mapping[str, float], Tensor]:
    """The terms of one outer step, and the Gaussians' places after it."""
    base = of_sculpting(registry.load_method("gaussian-sculpting-tiny")())
    changes = {"gradient_isolation": isolated, "base_cells": 10}
    config = SculptingConfig(
        **{
            **vars(base),
            "trainer": type(base.trainer)(**{**vars(base.trainer), **changes}),
            "binder": FaceBarycentricConfig(gaussians_per_face=per_face),
            "constraints": (BoundaryConfig(weight=weight), SpacingConfig()),
        }
    )
    parts = build_parts(config, scene.box, torch.Generator().manual_seed(0))
    trainer = parts.trainer
    trainer.seeds = discover(trainer.field, trainer.extractor.grid, 0)
    trainer.scene.blur = 0.01
    images = [prepare_image(view, scene.box, 0.5, parts.device) for view in scene.train]
    stage = config.trainer.stages[0]
    stage = type(stage)(**{**vars(stage), "silhouette_only": silhouettes, "inner_steps": 0})
    report = trainer.update(trainer.settle(images, stage, 1.0), images, stage, 1.0)
    return report.terms, trainer.scene.geometry_rows.leaves["barycentric_logits"].detach()


def test_constraints_count_where_there_is_no_inner_loop(scene: Scene):
    terms, places = step(scene, isolated=False, weight=1.0)
    assert terms["boundary"] == pytest.approx(float(boundary_at_start()), rel=1e-4)
    free, unconstrained = step(scene, isolated=False, weight=0.0)
    assert free["boundary"] == 0.0
    assert not torch.equal(places, unconstrained)


def test_a_constraint_that_has_nothing_to_say_is_no_obstacle(scene: Scene):
    """With one Gaussian per face its spacing is a constant, without a gradient."""
    terms, _ = step(scene, isolated=False, weight=1.0, per_face=1)
    assert terms["spacing"] == 0.0


@pytest.mark.parametrize(("isolated", "silhouettes"), [(True, False), (False, True)])
def test_and_nowhere_else_outside_of_it(isolated: bool, silhouettes: bool, scene: Scene):
    terms, _ = step(scene, isolated=isolated, weight=1.0, silhouettes=silhouettes)
    assert "boundary" not in terms


def boundary_at_start() -> Tensor:
    """The mean of exp(-10 a) over the table of places for three Gaussians: two thirds and twice a sixth."""
    weights = torch.tensor([2 / 3, 1 / 6, 1 / 6])
    return (-10 * weights).exp().mean()
