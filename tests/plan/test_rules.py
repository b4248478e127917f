"""What the rules make of evidence: no training, no pictures."""

from dataclasses import replace

import pytest
from planned_scenes import decided, method

from sculpt_framework import registry
from sculpt_framework.config import InitializerConfig, MethodConfig
from sculpt_framework.plan.agreement import FAR_APART, UNEVEN_COLORS, UNEVEN_LIGHT
from sculpt_framework.plan.directions import Gloss
from sculpt_framework.plan.evidence import Evidence
from sculpt_framework.plan.make import decide
from sculpt_framework.plan.options import option_of, with_options, without
from sculpt_framework.registry import name_of
from sculpt_framework.sculpting.config import PlanConfig, of_sculpting

USUAL = Evidence(
    views=100,
    masked=100,
    pixel_best=0.0082,
    pixel_worst=0.0089,
    contrast=(0.05, 0.08, 0.11, 0.13),
    speaking=0.9,
    gloss=Gloss(strength=0.01, points=800, unevenness=0.01),
)
"""Textured, matt, cells as wide as two pixels."""


def test_nothing_is_decided_twice() -> None:
    once, _ = decided(USUAL)
    again, _, _ = decide(once, USUAL, own=once)
    assert again == once


def test_without_masks_there_is_neither_hull_nor_silhouette() -> None:
    config, changed = decided(replace(USUAL, masked=0, gloss=None))
    assert name_of(config.initializer) == "sphere"
    assert "silhouette" not in [name_of(loss) for loss in config.losses]
    assert "0 of 100" in changed["silhouette"].evidence


def test_stereo_only_where_colours_say_something() -> None:
    assert name_of(decided(USUAL)[0].initializer) == "photo-hull"
    config, changed = decided(replace(USUAL, speaking=0.01))
    assert name_of(config.initializer) == "visual-hull"
    assert changed["stereo"].spared == {"depth maps": 50.0}


def test_objects_cut_by_the_images_borders_are_not_carved() -> None:
    config, changed = decided(replace(USUAL, cut=0.6))
    assert name_of(config.initializer) == "stereo"
    assert "60 % of the masks are cut by the border" in changed["stereo"].evidence
    assert name_of(decided(replace(USUAL, cut=0.4))[0].initializer) == "photo-hull"


def test_views_far_apart_are_explained_by_volume_rendering() -> None:
    config, changed = decided(replace(USUAL, views=8, masked=8, apart=1.01 * FAR_APART, gloss=None))
    assert name_of(config.initializer) == "volume-rendering"
    assert option_of(config.initializer, "max_views") == option_of(method().initializer, "max_views")
    assert "the view nearest to a view is 26 degrees away" in changed["stereo"].evidence
    assert changed["stereo"].measured["apart"] == 1.01 * FAR_APART
    assert weights(config) == weights(method()) | {"bending": 0.06}
    assert changed["light"].measured == {"apart": 1.01 * FAR_APART}
    assert name_of(decided(replace(USUAL, apart=0.99 * FAR_APART))[0].initializer) == "photo-hull"
    assert name_of(decided(replace(USUAL, apart=90.0, speaking=0.01))[0].initializer) == "visual-hull"
    assert name_of(decided(replace(USUAL, apart=90.0, masked=0, gloss=None))[0].initializer) == "sphere"


def uneven(share: float) -> Evidence:
    return replace(USUAL, gloss=Gloss(strength=0.01, points=800, unevenness=share))


def weights(config: MethodConfig) -> dict[str, float]:
    return {name_of(each): each.weight for each in config.losses}


def test_equal_colours_are_compared_where_light_is_even() -> None:
    config, changed = decided(uneven(0.99 * UNEVEN_COLORS))
    assert name_of(config.initializer) == "photo-hull"
    assert not {"stereo", "light"} & set(changed)


def test_correlation_is_compared_where_colours_differ() -> None:
    config, changed = decided(uneven(1.01 * UNEVEN_COLORS))
    assert name_of(config.initializer) == "stereo"
    assert option_of(config.initializer, "max_views") == option_of(method().initializer, "max_views")
    assert changed["stereo"].measured["unevenness"] == 1.01 * UNEVEN_COLORS


def test_the_start_is_as_fine_as_the_cells() -> None:
    usual = decided(uneven(1.01 * UNEVEN_COLORS))[0].initializer
    finer = with_options(method(), "trainer", base_cells=2 * method().trainer.base_cells)
    start = decided(uneven(1.01 * UNEVEN_COLORS), finer)[0].initializer
    for option in ("cells", "pixels"):
        assert option_of(start, option) == 2 * option_of(usual, option)


def test_the_surface_learns_from_agreement_where_light_is_uneven() -> None:
    config, changed = decided(uneven(0.99 * UNEVEN_LIGHT))
    assert weights(config) == weights(method())
    assert "light" not in changed
    config, changed = decided(uneven(1.01 * UNEVEN_LIGHT))
    assert weights(config) == weights(method()) | {"photometric": 0.0, "bending": 0.06}
    assert weights(config)["consistency"] == 1
    (stage,) = config.trainer.stages
    assert stage.inner_steps == 1
    assert changed["light"].measured == {"unevenness": 1.01 * UNEVEN_LIGHT}
    # Colours as fine as pixels would be nothing to the surface.
    assert option_of(config.binder, "gaussians_per_face") == 1


def test_nothing_is_compared_without_texture() -> None:
    config, changed = decided(replace(uneven(0.1), speaking=0.01))
    assert name_of(config.initializer) == "visual-hull"
    assert "consistency" not in weights(config)
    assert "colours alone" in changed["light"].value


def test_without_evidence_of_light_both_are_learned_from() -> None:
    config, changed = decided(replace(USUAL, gloss=None))
    assert weights(config) == weights(method())
    assert "light" not in changed


@pytest.mark.parametrize("told", [None, Gloss(strength=None, points=80, unevenness=0.005)])
def test_few_photographs_of_a_place_are_not_carved_from(told: Gloss | None) -> None:
    config, changed = decided(replace(USUAL, views=10, masked=10, apart=22.0, gloss=told))
    assert name_of(config.initializer) == "stereo"
    assert "fewer than eight views" in changed["stereo"].evidence
    assert "sh-degree" not in changed


def test_few_photographs_tell_whether_their_light_is_uneven() -> None:
    uneven_few = Gloss(strength=None, points=80, unevenness=1.01 * UNEVEN_LIGHT)
    config, changed = decided(replace(USUAL, views=10, masked=10, apart=22.0, gloss=uneven_few))
    assert name_of(config.initializer) == "stereo"
    assert weights(config)["photometric"] == 0.0
    assert "agreement between views" in changed["light"].value


def test_the_users_start_and_losses_are_kept_in_uneven_light() -> None:
    start = registry.default("initializer", "visual-hull")
    assert isinstance(start, InitializerConfig)
    config, changed = decided(uneven(0.1), replace(method(), initializer=start))
    assert name_of(config.initializer) == "visual-hull"
    assert "stereo" not in changed
    assert weights(config) == weights(method())
    assert "light" not in changed
    given = without(method(), "losses", ["eikonal"])
    config, changed = decided(uneven(0.1), given)
    assert weights(config) == weights(given)
    assert "stereo" in changed
    assert "light" not in changed


def test_learning_from_agreement_is_switched_by_itself() -> None:
    config, changed = decided(uneven(0.1), replace(method(), plan=PlanConfig(mode="on", light="off")))
    assert name_of(config.initializer) == "stereo"
    assert weights(config) == weights(method())
    assert "light" not in changed


def test_views_that_show_nothing_new_are_left_out_and_priced() -> None:
    config, changed = decided(replace(USUAL, blind=("a",), repeated=(("b", "c"), ("d", "c")), view_megabytes=5.0))
    assert config.skip_views == ("a", "b", "d")
    assert changed["views"].spared["megabytes"] == 15.0


def test_a_scene_is_never_left_without_views() -> None:
    config, _ = decided(replace(USUAL, views=2, blind=("a",)))
    assert config.skip_views == ()


@pytest.mark.parametrize(("pixel", "level"), [(0.0082, 2), (0.02, 1), (0.045, 0)])
def test_no_level_finer_than_the_pixels(pixel: float, level: int) -> None:
    config, _ = decided(replace(USUAL, pixel_best=pixel, pixel_worst=pixel))
    assert [stage.level for stage in config.trainer.stages] == [level]


def test_a_thin_part_keeps_its_level() -> None:
    coarse = replace(USUAL, pixel_best=0.02, pixel_worst=0.02)
    config, changed = decided(replace(coarse, thinnest=3))
    assert config.trainer.stages[0].level == 2
    assert "level" not in changed
    assert decided(replace(coarse, thinnest=12))[0].trainer.stages[0].level == 1


@pytest.mark.parametrize(("thinnest", "finer"), [(12, 1.0), (10, 1.2), (6, 1.375), (3, 1.0)])
def test_cells_narrow_for_a_part_that_they_come_to_hold(thinnest: int, finer: float) -> None:
    wide = replace(USUAL, pixel_best=0.0026, pixel_worst=0.0026, thinnest=thinnest)
    config, changed = decided(wide)
    assert config.trainer.base_cells == pytest.approx(finer * method().trainer.base_cells, abs=0.5)
    assert ("level" in changed) == (finer > 1)


def test_the_start_holds_the_thin_part_too() -> None:
    lit = Gloss(strength=0.01, points=800, unevenness=1.01 * UNEVEN_COLORS)
    wide = replace(USUAL, pixel_best=0.0026, pixel_worst=0.0026, thinnest=6, gloss=lit)
    config, _ = decided(wide)
    assert option_of(config.initializer, "cells") == config.trainer.base_cells << config.trainer.stages[-1].level


@pytest.mark.parametrize(("seconds", "narrow"), [(299.0, False), (600.0, True)])
def test_cells_do_not_narrow_where_the_time_is_short(seconds: float, narrow: bool) -> None:
    wide = replace(USUAL, pixel_best=0.0026, pixel_worst=0.0026, thinnest=6)
    config, _ = decided(wide, replace(method(), max_time=seconds))
    assert (config.trainer.base_cells > method().trainer.base_cells) == narrow


def test_large_images_are_reduced_unless_their_texture_would_go() -> None:
    fine = replace(USUAL, pixel_best=0.003, pixel_worst=0.003)
    soft = replace(fine, contrast=(0.005, 0.015, 0.03, 0.06))
    config, changed = decided(soft)
    assert config.trainer.stages[0].image_scale == pytest.approx(2 * 0.003 / (2 / 128))
    assert changed["images"].saves is not None
    assert decided(fine)[0].trainer.stages[0].image_scale == 1.0


@pytest.mark.parametrize(("strength", "degree"), [(0.01, 0), (0.07, 2), (0.2, 3)])
def test_degree_follows_gloss(strength: float, degree: int) -> None:
    config, _ = decided(replace(USUAL, gloss=Gloss(strength=strength, points=500, unevenness=0.01)))
    values = vars(config.appearance)
    assert values["sh_degree"] == degree
    if degree:
        # All of them must come to act before the run ends.
        steps = config.steps * config.trainer.stages[0].inner_steps
        assert degree * config.trainer.sh_degree_every < 1.2 * steps


def test_light_that_turns_relative_to_the_object_gets_three_degrees_that_learn_fast() -> None:
    config, _ = decided(uneven(0.022))
    values = vars(config.appearance)
    assert (values["sh_degree"], values["rest_rate"]) == (3, 5e-3)
    assert config.trainer.sh_degree_every == 20
    assert vars(decided(uneven(0.01))[0].appearance)["rest_rate"] < 1e-3


def test_a_degree_that_is_not_needed_is_left_out() -> None:
    rich = with_options(method(), "appearance", sh_degree=3)
    config, decisions, _ = decide(rich, USUAL, own=rich)
    assert vars(config.appearance)["sh_degree"] == 0
    (found,) = [decision for decision in decisions if decision.item == "sh-degree"]
    assert found.saves == "45 of 48 colour numbers per Gaussian"


def test_gaussians_follow_the_texture_finer_than_a_face() -> None:
    large = replace(USUAL, pixel_best=0.0036, pixel_worst=0.0038)
    config, changed = decided(large)
    assert vars(config.binder)["gaussians_per_face"] == 4
    assert {name_of(each) for each in config.constraints} == {"mee-scale", "boundary", "spacing", "coverage"}
    assert vars(config.binder)["places"] == "learned"
    plain = replace(large, contrast=(0.001, 0.002, 0.003, 0.004))
    assert vars(decided(plain)[0].binder)["gaussians_per_face"] == 1
    assert changed["gaussians"].measured["face_pixels"] == pytest.approx(0.7 * 2 / 128 / 0.0036)


def test_where_colours_teach_nothing_there_are_more_gaussians_only_to_be_polished() -> None:
    large = replace(USUAL, pixel_best=0.0036, pixel_worst=0.0038)
    bare = without(method(), "losses", ["photometric"])
    config, changed = decided(large, bare)
    assert vars(config.binder)["gaussians_per_face"] == 1
    assert (config.trainer.polish_gaussians, config.trainer.polish_gain_db) == (4, 0.0)
    steps = max(60, min(200, 3 * large.views))
    assert (config.trainer.polish_steps, config.trainer.polish_rate) == (steps, 3.0)
    assert changed["gaussians"].saves == "3 of 4 Gaussians until then"
    plain, _ = decided(replace(large, contrast=(0.001,) * 4), bare)
    assert (plain.trainer.polish_gaussians, plain.trainer.polish_rate) == (1, 3.0)
    assert plain.trainer.polish_steps == steps
    taught, _ = decided(large)
    assert taught.trainer.polish_rate == method().trainer.polish_rate


def test_small_faces_learn_no_places_and_need_no_constraints() -> None:
    config, changed = decided(USUAL)
    assert vars(config.binder)["places"] == "fixed"
    assert config.constraints == ()
    assert changed["places"].override == "--plan.places off"


def test_constraints_between_gaussians_go_where_there_is_one() -> None:
    given = replace(method(), plan=PlanConfig(constraints="on"))
    config, _, _ = decide(given, USUAL, own=given)
    assert [name_of(each) for each in config.constraints] == ["mee-scale", "boundary"]
    assert config.trainer.rest_after > 0


@pytest.mark.parametrize(("contrast", "steps"), [(0.08, 4), (0.02, 2), (0.001, 1)])
def test_inner_steps_follow_the_texture_finer_than_a_cell(contrast: float, steps: int) -> None:
    config, _ = decided(replace(USUAL, contrast=(contrast,) * 4))
    assert config.trainer.stages[0].inner_steps == steps


def test_what_the_user_set_is_not_decided() -> None:
    given = with_options(method(), "binder", gaussians_per_face=3)
    config, decisions, kept = decide(given, USUAL, own=method())
    assert vars(config.binder)["gaussians_per_face"] == 3
    assert "gaussians" not in [decision.item for decision in decisions]
    (found,) = [decision for decision in kept if decision.item == "gaussians"]
    assert "--binder.gaussians-per-face" in found.evidence


def test_an_item_is_switched_by_itself() -> None:
    off = replace(method(), plan=PlanConfig(mode="on", places="off"))
    assert vars(decided(USUAL, off)[0].binder)["places"] == "learned"
    alone = replace(method(), plan=PlanConfig(mode="off", places="on"))
    config, changed = decided(USUAL, alone)
    assert set(changed) == {"places"}
    assert config.trainer == alone.trainer
    assert decided(USUAL, replace(method(), plan=PlanConfig(mode="off")))[1] == {}


def test_a_start_whose_options_were_set_by_hand_is_kept() -> None:
    plain = of_sculpting(method())
    mine = with_options(plain, "initializer", neighbours=12)
    config, _, kept = decide(mine, uneven(0.1), own=plain)
    assert config.initializer == mine.initializer
    assert [each.evidence for each in kept if each.item == "stereo"] == ["--initializer was given"]
    # How many views are looked at is for any start.
    fewer = with_options(plain, "initializer", max_views=20)
    config, _, _ = decide(fewer, uneven(0.1), own=plain)
    assert name_of(config.initializer) == "stereo"
    assert option_of(config.initializer, "max_views") == 20
