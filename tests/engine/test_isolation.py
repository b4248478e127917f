"""Gradient isolation: colours move Gaussians, images move the surface, and neither does the other's work."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
import torch
from small_runs import ONE_STAGE, on_a_sphere, small_config
from torch import Tensor

from sculpt_framework.losses import TrainingImage
from sculpt_framework.sculpting.assembly import Parts
from sculpt_framework.sculpting.gaussian_scene import assemble
from sculpt_framework.types import Scene, Surface
from sculpt_plugins.appearances.per_gaussian.config import PerGaussianConfig
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig

LEARNABLE = FlexiCubesConfig(split="center", learn_weights=True, learn_deformation=True)
STAGE = ONE_STAGE[0]


def shape_parameters(parts: Parts) -> dict[str, Tensor]:
    """What an image may move only through vertices: the field's and the extractor's parameters."""
    named = {f"field.{name}": value for name, value in parts.trainer.field.named_parameters()}
    for table, rows in parts.trainer.extractor.tables.items():
        named |= {f"extractor.{table}.{name}": leaf for name, leaf in rows.leaves.items()}
    return named


def values(named: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in named.items()}


def changed(before: Mapping[str, Tensor], after: Mapping[str, Tensor]) -> set[str]:
    return {name for name, value in before.items() if not torch.equal(value, after[name].detach())}


def test_inner_steps_leave_the_shape_alone(scene: Scene):
    parts, images = on_a_sphere(small_config(extractor=LEARNABLE), scene)
    trainer = parts.trainer
    surface = trainer.extract().surface
    trainer.scene.follow(surface)
    shape, rows = shape_parameters(parts), values(trainer.scene.appearance_rows.leaves)
    before = values(shape)
    assert surface.vertices.requires_grad
    trainer.inner_loop(surface, images, steps=5, rate_factor=1.0)
    assert all(parameter.grad is None for parameter in shape.values())
    assert changed(before, shape) == set()
    assert changed(rows, trainer.scene.appearance_rows.leaves) == set(rows)


def image_gradients(parts: Parts, images: list[TrainingImage], surface: Surface) -> list[Tensor]:
    """Backward of one view's images terms from Gaussians bound to ``surface``; what arrived at shape parameters."""
    trainer = parts.trainer
    binding = trainer.scene.bind(surface, learn=False)
    gaussians = assemble(binding, trainer.scene.harmonics(binding.means, degree=0, learn=False))
    deferred, _ = trainer.views.render_and_backward(
        gaussians, images, 2, trainer.objectives.images, trainer.processes, trainer.own
    )
    deferred.backward()
    return [parameter.grad for parameter in shape_parameters(parts).values() if parameter.grad is not None]


def test_images_reach_the_shape_through_vertices_only(scene: Scene):
    parts, images = on_a_sphere(small_config(extractor=LEARNABLE), scene)
    surface = parts.trainer.extract().surface
    parts.trainer.scene.follow(surface)
    assert image_gradients(parts, images, surface.detach()) == []
    arrived = image_gradients(parts, images, surface)
    assert arrived
    assert any(bool(gradient.any()) for gradient in arrived)


def test_colours_have_no_gradient_by_vertices(scene: Scene):
    parts, _ = on_a_sphere(small_config(), scene)
    surface = parts.trainer.extract().surface
    parts.trainer.scene.follow(surface)
    binding = parts.trainer.scene.bind(surface, learn=True)
    assert binding.means.requires_grad
    sh = parts.trainer.scene.harmonics(binding.means, degree=0, learn=True)
    found = torch.autograd.grad(sh.square().sum() + sh.sum(), [surface.vertices], allow_unused=True)
    assert found == (None,)
    assert assemble(binding, sh).sh.requires_grad


def test_the_outer_step_moves_the_shape_and_no_row(scene: Scene):
    parts, images = on_a_sphere(small_config(extractor=LEARNABLE), scene)
    trainer = parts.trainer
    trainer.scene.follow(trainer.extract().surface)
    rows = values({**trainer.scene.geometry_rows.leaves, **trainer.scene.appearance_rows.leaves})
    shared = values(dict(trainer.scene.appearance.named_parameters()))
    before = values(dict(trainer.field.named_parameters()))
    bare = replace(STAGE, inner_steps=0)
    trainer.update(trainer.settle(images, bare, 1.0), images, bare, 1.0)
    assert changed(before, dict(trainer.field.named_parameters()))
    assert changed(shared, dict(trainer.scene.appearance.named_parameters())) == set()
    after = {**trainer.scene.geometry_rows.leaves, **trainer.scene.appearance_rows.leaves}
    assert changed(rows, after) == set()


def test_without_isolation_everything_moves_at_once(scene: Scene):
    parts, images = on_a_sphere(small_config(gradient_isolation=False), scene)
    trainer = parts.trainer
    trainer.scene.follow(trainer.extract().surface)
    field = values(dict(trainer.field.named_parameters()))
    colours = values(dict(trainer.scene.appearance.named_parameters()))
    report = trainer.update(trainer.settle(images, STAGE, 1.0), images, STAGE, 1.0)
    assert report.inner_loss is None
    assert trainer.inner_total == 0
    assert changed(field, dict(trainer.field.named_parameters()))
    assert changed(colours, dict(trainer.scene.appearance.named_parameters()))


def test_without_isolation_colours_reach_the_degrees_that_views_have_earned(scene: Scene):
    config = small_config(gradient_isolation=False, appearance=PerGaussianConfig(sh_degree=1), sh_degree_every=8)
    parts, images = on_a_sphere(config, scene)
    trainer = parts.trainer
    trainer.scene.follow(trainer.extract().surface)
    moved = []
    for _ in range(3):  # Of four views each.
        trainer.update(trainer.settle(images, STAGE, 1.0), images, STAGE, 1.0)
        moved.append(bool(trainer.scene.appearance_rows.leaves["band_1"].any()))
    assert moved == [False, False, True]


def test_a_gradient_that_is_not_finite_updates_nothing(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    parts, images = on_a_sphere(small_config(), scene)
    trainer = parts.trainer
    before = values(dict(trainer.field.named_parameters()))
    first = next(trainer.field.parameters())
    first.register_hook(lambda gradient: gradient * torch.nan)
    with pytest.raises(FloatingPointError, match="gradient of the field is not finite"):
        trainer.update(trainer.settle(images, STAGE, 1.0), images, STAGE, 1.0)
    assert changed(before, dict(trainer.field.named_parameters())) == set()
