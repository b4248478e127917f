"""Every component and every switch trains on a small scene: a valid mesh, and a loss that went down."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_runs import FIELDS, ONE_STAGE, TWO_STAGES, Outcome, small_config, train

from sculpt_framework import registry
from sculpt_framework.config import MethodConfig
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.sculpting.config import StageConfig
from sculpt_framework.shape_from_images import field_fit
from sculpt_framework.types import Scene, View
from sculpt_plugins.appearances.per_gaussian.config import PerGaussianConfig
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.initializers.sphere.config import SphereConfig
from sculpt_plugins.losses.silhouette.config import SilhouetteConfig

BASE = small_config()
EXTRACTORS = {"flexicubes": FlexiCubesConfig(), "marching-tetrahedra": MarchingTetrahedraConfig()}
SILHOUETTES_FIRST = (
    StageConfig(share=0.5, level=0, image_scale=0.5, inner_steps=0, outer_views=2, silhouette_only=True),
    StageConfig(share=0.5, level=0, image_scale=1.0, inner_steps=2, outer_views=2),
)
SWITCHES = {
    "per-gaussian": small_config(appearance=PerGaussianConfig(sh_degree=1), sh_degree_every=4),
    "three-gaussians": small_config(binder=FaceBarycentricConfig(gaussians_per_face=3)),
    "learnable-opacity": small_config(binder=FaceBarycentricConfig(opacity="learnable")),
    "cold-start": small_config(warm_start=False, appearance=PerGaussianConfig(sh_degree=0)),
    "no-isolation": small_config(gradient_isolation=False),
    "learnable-extractor": small_config(
        extractor=FlexiCubesConfig(split="center", learn_weights=True, learn_deformation=True)
    ),
    "white-background": small_config(random_background=False),
}


def require_valid(outcome: Outcome) -> None:
    certificate = certify(outcome.result.vertices, outcome.result.faces)
    assert certificate.watertight
    assert certificate.outward
    assert certificate.vertex_manifold
    assert np.isfinite(outcome.result.colors).all()
    gaussians = outcome.result.gaussians
    assert torch.isfinite(gaussians.means).all()
    assert int(gaussians.face.max()) < len(outcome.result.faces)


def require_progress(losses: Sequence[float]) -> None:
    assert np.mean(losses[-3:]) < np.mean(losses[:3])


@pytest.mark.parametrize("extractor", EXTRACTORS)
@pytest.mark.parametrize("field", FIELDS)
def test_every_pair_of_field_and_extractor(scene: Scene, field: str, extractor: str, monkeypatch: pytest.MonkeyPatch):
    # From the start of real runs: what four steps learn of a rougher one is not told from noise.
    monkeypatch.setattr(field_fit, "SAMPLES", 20_000)
    parts = {"field": FIELDS[field], "extractor": EXTRACTORS[extractor]}
    if field == "mlp":
        # The MLP starts from the hull so closely that eight steps have too little left to learn to be told from noise,
        # and a sphere would be shaped by a silhouette loss before the first of them.
        losses = tuple(loss for loss in BASE.losses if not isinstance(loss, SilhouetteConfig))
        parts |= {"initializer": SphereConfig(), "losses": losses}
    outcome = train(small_config(stages=TWO_STAGES, **parts), scene)
    require_valid(outcome)
    # Images grow between the stages: losses are compared inside the first.
    require_progress(outcome.losses[:4] if len(outcome.losses) < 8 else [*outcome.losses[:3], *outcome.losses[-3:]])


@pytest.mark.parametrize("name", [registry.name_of(each) for each in BASE.constraints])
def test_without_one_constraint(scene: Scene, name: str):
    left = tuple(each for each in BASE.constraints if registry.name_of(each) != name)
    outcome = train(small_config(constraints=left, binder=FaceBarycentricConfig(gaussians_per_face=2)), scene)
    require_valid(outcome)
    require_progress(outcome.losses)


def test_without_any_constraint(scene: Scene):
    outcome = train(small_config(constraints=()), scene)
    require_valid(outcome)
    require_progress(outcome.losses)


@pytest.mark.parametrize(
    "name", [registry.name_of(each) for each in BASE.losses if registry.name_of(each) != "photometric"]
)
def test_without_one_loss(scene: Scene, name: str):
    left = tuple(each for each in BASE.losses if registry.name_of(each) != name)
    outcome = train(small_config(losses=left), scene)
    require_valid(outcome)
    require_progress(outcome.losses)
    assert name not in outcome.of("outer_step")[0].data["terms"]


@pytest.mark.parametrize("config", SWITCHES.values(), ids=SWITCHES.keys())
def test_switches(scene: Scene, config: MethodConfig):
    outcome = train(config, scene)
    require_valid(outcome)
    require_progress(outcome.losses)


def test_a_sphere_is_shaped_by_silhouettes_first(scene: Scene):
    outcome = train(small_config(initializer=SphereConfig(), stages=SILHOUETTES_FIRST, steps=16), scene)
    require_valid(outcome)
    terms = [event.data["terms"] for event in outcome.of("outer_step")]
    assert "photometric" not in terms[0]
    assert "photometric" in terms[-1]
    require_progress([each["silhouette"] for each in terms[:8]])


@pytest.mark.slow
def test_a_cold_start_is_measured_with_the_colours_it_learned(scene: Scene):
    scores: list[float] = []
    for inner_steps in (1, 300):
        stage = (replace(ONE_STAGE[0], inner_steps=inner_steps),)
        config = small_config(
            warm_start=False,
            appearance=PerGaussianConfig(),
            steps=1,
            warm_up_steps=0,
            stages=stage,
            polish_steps=0,
        )
        rows = [each.data for each in train(config, scene).of("evaluation")]
        scores.append(next(row["psnr"] for row in rows if row["reason"] == "stage"))
    assert scores[1] > scores[0] + 0.5


# -- unusual input ---------------------------------------------------------------------------------------------------


def test_without_alpha(scene: Scene):
    opaque = [replace(view, rgb=view.rgb * view.alpha[..., None] + 1 - view.alpha[..., None]) for view in scene.train]
    views = tuple(replace(view, alpha=None) for view in opaque)
    outcome = train(small_config(initializer=SphereConfig()), replace(scene, train=views))
    require_valid(outcome)


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_views(scene: Scene, count: int):
    outcome = train(BASE, replace(scene, train=scene.train[:count], test=()))
    require_valid(outcome)
    assert outcome.of("evaluation")[-1].data["psnr"] is None


def test_images_of_different_sizes(scene: Scene):
    def enlarged(view: View, factor: int) -> View:
        camera = view.camera.resized(view.camera.width * factor, view.camera.height * factor)
        rgb = view.rgb.repeat_interleave(factor, 0).repeat_interleave(factor, 1)
        alpha = view.alpha.repeat_interleave(factor, 0).repeat_interleave(factor, 1)
        return View(name=view.name, camera=camera, rgb=rgb, alpha=alpha)

    views = tuple(enlarged(view, 1 + index % 2) for index, view in enumerate(scene.train))
    outcome = train(BASE, replace(scene, train=views))
    require_valid(outcome)
    require_progress(outcome.losses)
