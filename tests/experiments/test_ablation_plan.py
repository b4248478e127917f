"""Which runs an ablation consists of: the factors of the paper, turned into valid command lines."""

import functools
import itertools
from collections.abc import Collection
from pathlib import Path

import pytest

from sculpt_framework.cli.ablate import FACTORS
from sculpt_framework.command_line.request import parse
from sculpt_framework.config import MethodConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.experiments.ablation import DEFAULT, EVIDENCE, Ablation, ablation
from sculpt_framework.experiments.matrix import (
    Budget,
    MatrixScene,
    Setting,
    check_extra,
    cross,
    matrix_scenes,
    without_options,
)
from sculpt_framework.registry import name_of

SCENE = MatrixScene(label="dents", data="demo:dents")


@functools.cache
def made(*extra: str, method: str = "gaussian-sculpting", factors: tuple[str, ...] = FACTORS, full: bool = False):
    return ablation(method, SCENE, extra, factors=factors, full=full)


def configs(ablated: Ablation, *extra: str, only: Collection[str] = ()) -> dict[str, MethodConfig]:
    """The config of settings (all of them), by name, as their command lines give it."""
    settings = [setting for setting in ablated.settings if not only or setting.name in only]
    matrix = cross("Test", settings, [SCENE], [None], [0], extra)
    return {cell.setting: parse(cell.words) for cell in matrix.cells}


def constraints(config: MethodConfig) -> set[str]:
    return {name_of(constraint) for constraint in config.constraints}


def test_one_change_at_a_time():
    found = configs(made())
    own = found[DEFAULT]
    assert list(found) == [
        "default",
        "no-scale",
        "no-distribution",
        "only-opacity",
        "none",
        "mlp",
        "discrete",
        "no-isolation",
        "cold-start",
    ]
    assert own == parse(["gaussian-sculpting", "--data", "demo:dents"])
    assert constraints(own) == {"mee-scale", "boundary", "spacing", "coverage"}
    assert constraints(found["no-scale"]) == {"boundary", "spacing", "coverage"}
    assert constraints(found["no-distribution"]) == {"mee-scale"}
    assert constraints(found["only-opacity"]) == set()
    assert constraints(found["none"]) == set()
    opacities = {name: config.binder.opacity for name, config in found.items()}  # pyright: ignore
    assert opacities == {name: "learnable" if name == "none" else "fixed" for name in found}
    assert name_of(found["mlp"].field) == "mlp"
    assert name_of(found["discrete"].field) == "dense-grid"
    assert not found["no-isolation"].trainer.gradient_isolation
    assert not found["cold-start"].trainer.warm_start
    changed = {
        name: [each for each in vars(own) if getattr(config, each) != getattr(own, each)]
        for name, config in found.items()
    }
    assert changed["none"] == ["binder", "constraints"]
    assert all(len(parts) == 1 for name, parts in changed.items() if name not in (DEFAULT, "none"))


def test_full_crosses_everything():
    ablated = made(full=True)
    names = [setting.name for setting in ablated.settings]
    assert len(names) == len(set(names)) == 5 * 3 * 2 * 2
    assert ablated.same == {}
    assert "no-scale+discrete+no-isolation+cold-start" in names
    combinations = {tuple(levels.values()) for levels in ablated.levels.values()}
    axes = [{combination[place] for combination in combinations} for place in range(4)]
    assert combinations == set(itertools.product(*axes))


@pytest.mark.parametrize(("level", "cells"), [(1, "64"), (2, "128")])
def test_the_discrete_field_has_a_number_per_corner_of_the_finest_grid(level: int, cells: str):
    (setting,) = made("--trainer.stages.0.level", str(level), factors=("field",)).settings[2:]
    assert setting.words == ("--field", "dense-grid", "--field.resolution", cells)


def test_the_method_s_own_settings_are_the_default():
    ablated = made(method="gaussian-sculpting-paper", factors=("field", "start"))
    names = [setting.name for setting in ablated.settings]
    assert names == ["default", "discrete", "warm-start"]
    paper = configs(ablated, only=[DEFAULT])[DEFAULT]
    assert paper == parse(["gaussian-sculpting-paper", "--data", "demo:dents"])


def test_settings_that_change_nothing_are_left_out():
    ablated = made("--constraints", "boundary", factors=("constraints",))
    assert [setting.name for setting in ablated.settings] == ["default", "no-distribution", "none"]
    assert ablated.same == {"no-scale": "default", "only-opacity": "no-distribution"}


def test_words_for_what_is_left_out_go_with_it():
    extra = (
        *("--constraints", "mee-scale", "coverage", "--constraints.mee-scale.limit", "0.5"),
        *("--field", "hash-grid", "--field.num-levels=4", "--binder.gaussians-per-face", "3"),
    )
    found = configs(made(*extra, factors=("constraints", "field")), *extra, only=("no-scale", "no-distribution", "mlp"))
    assert constraints(found["no-scale"]) == {"coverage"}
    (scale,) = found["no-distribution"].constraints
    assert scale.limit == 0.5  # pyright: ignore
    assert name_of(found["mlp"].field) == "mlp"
    assert {config.binder.gaussians_per_face for config in found.values()} == {3}  # pyright: ignore
    assert {config.field.num_levels for n, config in found.items() if n != "mlp"} == {4}  # pyright: ignore


def test_options_are_taken_out_with_their_values():
    words = [
        "--field",
        "mlp",
        "--field.a=1",
        "--fields",
        "x",
        "--binder.scale",
        "-0.5",
        "--flag",
        "--field.b",
        "2",
        "3",
    ]
    assert without_options(words, ["--field"]) == (*words[2:],)
    assert without_options(words, ["--field."]) == (*words[:2], *words[3:8])
    assert without_options(words, ["--binder.scale"]) == (*words[:5], *words[7:])
    assert without_options(words, []) == tuple(words)


def test_options_that_are_not_valid_name_the_setting():
    with pytest.raises(ConfigError, match="default: there is no option --filed"):
        made("--filed", "mlp")
    with pytest.raises(ConfigError, match="there is no method 'gaussian-sculptin'"):
        made(method="gaussian-sculptin")


@pytest.mark.parametrize("word", ["--seed", "--max-time=3", "--steps", "--output", "--data", "--resume"])
def test_what_the_plan_sets_cannot_be_given(word: str):
    with pytest.raises(ConfigError, match="cannot be given after --"):
        check_extra(["--field", "mlp", word, "3"])


def test_a_plan_crosses_scenes_budgets_seeds_and_settings():
    settings = [Setting(name="one", method="gaussian-sculpting"), Setting(name="two", method="gaussian-sculpting-tiny")]
    scenes = [SCENE, MatrixScene(label="jar", data="/jar", words=("--reference", "/jar.ply"))]
    budgets = [Budget(kind="seconds", amount=40.0), Budget(kind="steps", amount=100.0)]
    matrix = cross("Test", settings, scenes, budgets, [0, 7], ["--threads", "1"])
    assert len(matrix.cells) == len({cell.name for cell in matrix.cells}) == 16
    first, second = matrix.cells[:2]
    assert first.name == "dents/40s/one/seed-0"
    assert first.words == (
        *("gaussian-sculpting", "--data", "demo:dents", "--threads", "1", "--max-time", "40", "--seed", "0"),
    )
    assert (second.setting, second.seed) == ("two", 0), "what is compared is run side by side"
    assert [cell.timed for cell in matrix.cells[:8]] == [True] * 4 + [False] * 4
    assert matrix.cells[-1].words == (
        *("gaussian-sculpting-tiny", "--data", "/jar", "--reference", "/jar.ply", "--threads", "1"),
        *("--steps", "100", "--seed", "7"),
    )
    for cell in matrix.cells[3:5]:
        assert parse(cell.words).max_time == (40 if cell.timed else None)
    assert set(matrix.warm_ups) == {"dents", "jar"}
    warm = parse(matrix.warm_ups["dents"])
    assert warm.steps == 4
    assert {stage.inner_steps for stage in warm.trainer.stages} == {1}
    assert warm.max_time is None


def test_scenes_get_names_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for place in ("a/jar", "b/jar"):
        (tmp_path / place).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    found = matrix_scenes(["demo:dents", "a/jar", str(tmp_path / "b" / "jar")])
    assert [(scene.label, scene.data) for scene in found] == [
        ("dents", "demo:dents"),
        ("jar", str(tmp_path / "a" / "jar")),
        ("jar-2", str(tmp_path / "b" / "jar")),
    ]


@pytest.mark.parametrize(
    ("scenes", "message"),
    [([], "no scenes"), (["demo", "demo"], "given twice"), (["nowhere"], "no such folder; expected a scene folder")],
)
def test_scenes_that_cannot_be_run(scenes: list[str], message: str):
    with pytest.raises(ConfigError, match=message):
        matrix_scenes(scenes)


def test_what_the_surface_learns_from_is_left_out_a_part_at_a_time():
    found = configs(made(factors=(EVIDENCE,)))
    losses = {name: {name_of(loss) for loss in config.losses} for name, config in found.items()}
    starts = {name: name_of(config.initializer) for name, config in found.items()}
    own = losses[DEFAULT]
    assert losses["no-agreement"] == losses["paper-loss"] == own - {"consistency"}
    assert all(losses[name] == own for name in ("with-colours", "no-bending", "no-stereo", "from-hull"))
    weights = {name_of(loss): loss.weight for loss in found["no-bending"].losses}
    assert weights["photometric"] == 0 < weights["consistency"]
    hulls = {"from-hull", "paper-loss"}
    assert all(start == ("visual-hull" if name in hulls else starts[DEFAULT]) for name, start in starts.items())
