"""``gaussian-sculpting-paper``: each number the paper gives, and a run of a few of its steps."""

from dataclasses import replace

import pytest
from small_runs import train

from sculpt_framework import registry
from sculpt_framework.config import MethodConfig
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.types import Scene


@pytest.fixture
def paper() -> MethodConfig:
    return registry.load_method("gaussian-sculpting-paper")()


def value(config: object, path: str) -> object:
    for name in path.split("."):
        if isinstance(config, tuple):
            found = {registry.name_of(each): each for each in config}
            config = found[name]
        else:
            config = getattr(config, name)
    return config


@pytest.mark.parametrize(
    ("path", "number"),
    [
        ("field.hidden_layers", 8),
        ("field.hidden_units", 256),
        ("field.rate", 1e-4),
        ("trainer.base_cells", 128),
        ("trainer.gradient_isolation", True),
        ("trainer.warm_start", False),
        ("trainer.final_rate", 1.0),
        ("trainer.low_pass_px2", 0.3),
        ("trainer.random_background", False),
        ("trainer.sh_degree_every", 1000),
        ("binder.reference", "edges"),
        ("binder.scale", 1.0),
        ("binder.opacity", "fixed"),
        ("binder.rotation_rate", 0.0),
        ("binder.scale_rate", 5e-3),
        ("appearance.sh_degree", 3),
        ("appearance.rate", 2.5e-3),
        ("appearance.rest_rate", 1.25e-4),
        ("extractor.learn_weights", True),
        ("extractor.learn_deformation", True),
        ("extractor.damp_grazing", False),
        ("losses.photometric.dssim", 0.2),
        ("constraints.mee-scale.form", "edges"),
        ("constraints.mee-scale.limit", 1.0),
        ("constraints.boundary.steepness", 10.0),
        ("constraints.coverage.threshold", 0.8),
    ],
)
def test_numbers_of_the_paper(paper: MethodConfig, path: str, number: object):
    assert value(paper, path) == number


def test_choices_the_paper_describes_without_a_number(paper: MethodConfig):
    assert 0.98 <= float(str(value(paper, "binder.theta"))) < 1
    assert {registry.name_of(each) for each in paper.constraints} == {"mee-scale", "boundary", "spacing", "coverage"}
    assert [registry.name_of(getattr(paper, slot)) for slot in ("field", "extractor", "appearance", "initializer")] == [
        "mlp",
        "flexicubes",
        "per-gaussian",
        "sphere",
    ]
    first, second = paper.trainer.stages
    assert first.silhouette_only
    assert not second.silhouette_only
    assert second.inner_steps == 1000
    assert {stage.level for stage in paper.trainer.stages} == {0}
    assert {stage.image_scale for stage in paper.trainer.stages} == {1.0}


@pytest.mark.slow
def test_it_runs(paper: MethodConfig, scene: Scene):
    """The method as it is, but for the counts that make it take hours."""
    first, second = paper.trainer.stages
    trainer = replace(
        paper.trainer,
        base_cells=10,
        fit_steps=3,
        polish_steps=5,
        stages=(replace(first, share=0.5, outer_views=2), replace(second, share=0.5, inner_steps=6, outer_views=2)),
    )
    outcome = train(replace(paper, steps=2, trainer=trainer, observers=(), data="small"), scene)
    certificate = certify(outcome.result.vertices, outcome.result.faces)
    assert certificate.watertight
    assert certificate.outward
    assert outcome.of("run_started")[0].data["method"] == "gaussian-sculpting-paper"
    assert [event.data["silhouette_only"] for event in outcome.of("stage")] == [True, False]
