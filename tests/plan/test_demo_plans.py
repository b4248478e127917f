"""On demo scenes made for it the plan decides rightly; also on those made to mislead it."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from planned_scenes import decided, evidence_of, method, scene_of

from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.plan.evidence import gather
from sculpt_framework.plan.pictures import blind_views, repeated_views
from sculpt_framework.registry import name_of
from sculpt_plugins.datasets.blender.config import BlenderConfig


def test_a_matt_scene_gets_degree_0_and_one_gaussian() -> None:
    # As many as it takes for eight of them to see a place.
    config, _ = decided(evidence_of("blob", views=24))
    assert vars(config.appearance)["sh_degree"] == 0
    assert vars(config.binder)["gaussians_per_face"] == 1
    assert name_of(config.initializer) == "photo-hull"


def test_a_shiny_scene_gets_a_higher_degree() -> None:
    config, changed = decided(evidence_of("flask", 24))
    assert vars(config.appearance)["sh_degree"] >= 2
    assert changed["sh-degree"].measured["gloss"] > 0.1


def test_a_plain_scene_gets_one_gaussian_and_no_stereo() -> None:
    config, _ = decided(evidence_of("pebble"))
    assert vars(config.binder)["gaussians_per_face"] == 1
    assert name_of(config.initializer) == "visual-hull"
    assert config.trainer.stages[0].inner_steps == 1


def test_fine_texture_gets_more_gaussians_and_all_pixels() -> None:
    config, changed = decided(evidence_of("granite"))
    assert vars(config.binder)["gaussians_per_face"] >= 2
    assert config.trainer.stages[0].image_scale == 1.0
    assert changed["gaussians"].measured["contrast"] > 0.02


def test_a_wall_of_one_colour_is_as_good_as_alpha(tmp_path: Path) -> None:
    settings = DemoSettings(train_views=10, test_views=0, resolution=96, reference_cells=16)
    write_scene(demo_object("studio"), settings, tmp_path / "studio")
    write_scene(demo_object("blob"), settings, tmp_path / "blob")
    keyed, given = (BlenderConfig().build(str(tmp_path / name)).load() for name in ("studio", "blob"))
    config, _ = decided(gather(keyed))
    assert "silhouette" in [name_of(loss) for loss in config.losses]
    for one, other in zip(keyed.train, given.train, strict=True):
        assert one.alpha is not None and other.alpha is not None  # noqa: PT018
        assert float((one.alpha - other.alpha).abs().mean()) < 0.01


def test_texture_on_one_side_is_not_overlooked() -> None:
    config, _ = decided(evidence_of("two-faced", views=24))
    assert name_of(config.initializer) == "photo-hull"


def test_a_thin_part_keeps_the_finest_level() -> None:
    found = evidence_of("needle")
    assert found.thinnest is not None
    config, changed = decided(found)
    assert config.trainer.stages[0].level == method().trainer.stages[0].level
    # Without the rods pictures as small as these would not have asked for it.
    coarse = decided(replace(found, thinnest=None))[0]
    assert coarse.trainer.stages[0].level < method().trainer.stages[0].level
    assert "level" not in changed


@pytest.mark.parametrize("name", ["blob", "pebble"])
def test_no_thin_part_is_seen_where_there_is_none(name: str) -> None:
    assert gather(scene_of(name, 8)).thinnest is None


def test_views_that_show_nothing_or_the_same_again_are_found() -> None:
    scene = scene_of("pebble", 4)
    first = scene.train[0]
    assert first.alpha is not None
    again = replace(first, name="again")
    dark = replace(first, name="dark", rgb=0.7 * first.rgb)
    empty = replace(first, name="empty", alpha=torch.zeros_like(first.alpha))
    turned = first.camera.world_to_camera.clone()
    turned[:3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0], dtype=turned.dtype)) @ turned[:3, :3]
    turned[:3, 3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0], dtype=turned.dtype)) @ turned[:3, 3]
    away = replace(first, name="away", alpha=None, camera=replace(first.camera, world_to_camera=turned))
    views = [*scene.train, again, dark, empty, away]
    assert blind_views(views, scene.box) == ("empty", "away")
    assert repeated_views([*scene.train, again, dark], scene.box) == (("again", "r_0"),)
