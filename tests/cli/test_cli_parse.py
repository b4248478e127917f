"""What a command line stands for."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from sculpt_framework import registry
from sculpt_framework.command_line.options import flags
from sculpt_framework.command_line.request import parse, read_request
from sculpt_framework.config import MethodConfig
from sculpt_framework.errors import CheckpointError, ConfigError
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.serialization import config_to_json

pytestmark = pytest.mark.usefixtures("fake")


def run(words: str) -> MethodConfig:
    return parse(["fake", "--data", "x", *words.split()])


def plain() -> MethodConfig:
    return replace(registry.load_method("fake")(), data="x")


def default(slot: str, name: str):
    return registry.default(slot, name)


def test_without_options_the_method_s_config_comes_out():
    assert run("") == plain()


def test_general_options():
    config = run("--output o/p --max-time 90 --device cpu --threads 2 --seed 7")
    assert config == replace(plain(), output=Path("o/p"), max_time=90.0, device="cpu", threads=2, seed=7)


def test_a_component_brings_its_options():
    config = run("--field fancy --field.num-levels 9 --field.resolution 2 8 --field.no-coarse-to-fine --field.limit 3")
    fancy = replace(default("field", "fancy"), num_levels=9, resolution=(2, 8), coarse_to_fine=False, limit=3.0)
    assert config == replace(plain(), field=fancy)


@pytest.mark.parametrize("words", ["--field=fancy --field.num-levels=9", "--field fancy --field.num_levels 9"])
def test_spellings_of_an_option(words: str):
    assert run(words).field == replace(default("field", "fancy"), num_levels=9)


def test_options_may_come_before_the_component_they_belong_to():
    assert run("--field.num-levels 9 --field fancy").field == replace(default("field", "fancy"), num_levels=9)


def test_choosing_again_keeps_the_method_s_settings():
    assert run("--field plain").field == plain().field != default("field", "plain")


def test_lists_keep_settings_take_new_members_and_order():
    config = run("--losses outline likeness --constraints even tight --constraints.even.weight 3")
    assert config.losses == plain().losses[::-1]
    assert config.constraints == (replace(default("constraints", "even"), weight=3.0), default("constraints", "tight"))


@pytest.mark.parametrize("words", ["--constraints none", "--constraints=none", "--constraints none --seed 0"])
def test_none_empties_a_list(words: str):
    assert run(words) == replace(plain(), constraints=())


def test_lists_in_equals_form_take_the_words_that_follow():
    assert run("--losses=outline likeness").losses == plain().losses[::-1]


def test_nested_options_of_the_trainer():
    config = run("--trainer.stages.1.level 2 --trainer.no-warm-start --trainer.final-rate 0.1")
    first, second = plain().trainer.stages
    stages = (first, replace(second, level=2))
    assert config.trainer == replace(plain().trainer, stages=stages, warm_start=False, final_rate=0.1)


def test_names_with_underscores_are_understood():
    assert run("--field hash_grid").field == default("field", "hash-grid")


def test_viewer_adds_the_viewer_once():
    viser = default("observers", "viser")
    assert run("--viewer").observers == (*plain().observers, viser)
    assert run("--viewer --observers viser").observers == (viser,)
    assert run("--observers none --viewer").observers == (viser,)


def test_the_method_s_name_is_what_was_asked_for(install):
    variant = "from sculpt_fake import fake\ndef my_way():\n    return fake()"
    install("my-way", {"sculpt_framework.methods": {"my-way": "my_way:my_way"}}, my_way=variant)
    assert parse(["my_way", "--data", "x"]).method == "my-way"


@pytest.mark.parametrize(
    "words", ["", "--field fancy", "--losses none --constraints even tight --observers none --field fancy"]
)
def test_flags_are_the_options_of_the_whole_help(words: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        parse(["fake", *words.split(), "--help-all"])
    shown = set(re.findall(r"^\W*--([a-z][a-z0-9.-]*)", capsys.readouterr().out, re.MULTILINE))
    assert shown == set(flags(run(words)))


class TestResume:
    @pytest.fixture
    def run_dir(self, tmp_path: Path) -> Path:
        saved = replace(plain(), field=default("field", "fancy"))
        (tmp_path / "config.json").write_text(config_to_json(saved), encoding="utf-8")
        return tmp_path

    @pytest.mark.parametrize("words", ["--resume {}", "--resume={}", "fake --resume {}"])
    def test_needs_neither_method_nor_data(self, run_dir: Path, words: str):
        request = read_request(words.format(run_dir).split())
        assert request.resume == run_dir
        assert request.config == replace(plain(), field=default("field", "fancy"), output=run_dir)

    def test_time_threads_and_observers_may_change(self, run_dir: Path):
        config = read_request(f"--resume {run_dir} --max-time 60 --threads 1 --observers none".split()).config
        assert (config.max_time, config.threads, config.observers) == (60.0, 1, ())

    @pytest.mark.parametrize("words", ["--field.num-levels 2", "--seed 5", "--data y", "--output z", "--losses none"])
    def test_nothing_else_may_change(self, run_dir: Path, words: str):
        with pytest.raises(ConfigError, match="cannot be"):
            read_request(["--resume", str(run_dir), *words.split()])

    def test_the_method_must_be_the_saved_one(self, run_dir: Path):
        with pytest.raises(ConfigError, match="a run of 'fake', not of 'gaussian-sculpting'"):
            read_request(["gaussian-sculpting", "--resume", str(run_dir)])

    def test_a_folder_without_a_run(self, tmp_path: Path):
        with pytest.raises(CheckpointError, match="there is no saved run"):
            read_request(["--resume", str(tmp_path / "nothing")])


# -- settings from a file --------------------------------------------------------------------------------------------


def test_a_file_has_settings_that_words_may_change(tmp_path: Path):
    settings = tmp_path / "settings.json"
    settings.write_text(
        json.dumps(
            {
                "steps": 7,
                "field": {"type": "hash-grid", "num_levels": 3},
                "losses": [{"type": "silhouette"}, {"type": "photometric", "weight": 0.25}],
                "trainer": {"fit_steps": 11},
            }
        ),
        encoding="utf-8",
    )
    plain = parse(["gaussian-sculpting", "--data", "demo"])
    config = parse(["gaussian-sculpting", "--data", "demo", "--config", str(settings), "--steps", "9"])
    assert isinstance(plain, SculptingConfig)
    assert isinstance(config, SculptingConfig)
    assert config.steps == 9
    assert config.trainer == replace(plain.trainer, fit_steps=11)
    assert config.field == replace(plain.field, num_levels=3)
    known = {type(loss): loss for loss in plain.losses}
    first, second = config.losses
    assert first == known[type(first)]
    assert second == replace(known[type(second)], weight=0.25)


def test_the_config_of_a_run_is_such_a_file(tmp_path: Path):
    config = parse(["gaussian-sculpting", "--data", "demo", "--output", "somewhere", "--field", "mlp", "--seed", "3"])
    (tmp_path / "config.json").write_text(config_to_json(config), encoding="utf-8")
    again = parse(["gaussian-sculpting", "--config", str(tmp_path / "config.json")])
    assert again == replace(config, output=None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "must be a JSON object, not a list"),
        ("{", "not valid JSON"),
        ('{"stepps": 3}', "stepps is not a known key. Did you mean 'steps'"),
        ('{"steps": "many"}', 'steps is "many"; expected a whole number'),
        ('{"method": "nerf"}', "it is of the method 'nerf', not of 'gaussian-sculpting'"),
        ('{"field": {"type": "wool"}}', "field: there is no field 'wool'"),
        ('{"steps": -1}', "steps"),
    ],
)
def test_a_file_that_does_not_fit_is_told(text: str, message: str, tmp_path: Path):
    (tmp_path / "settings.json").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=re.escape(message)):
        parse(["gaussian-sculpting", "--data", "demo", "--config", str(tmp_path / "settings.json")])


def test_underscores_in_a_type_and_a_list_s_nonsense(tmp_path: Path):
    (tmp_path / "a.json").write_text(json.dumps({"binder": {"type": "face_barycentric"}}), encoding="utf-8")
    config = parse(["gaussian-sculpting-paper", "--data", "demo", "--config", str(tmp_path / "a.json")])
    plain = parse(["gaussian-sculpting-paper", "--data", "demo"])
    assert isinstance(config, SculptingConfig)
    assert isinstance(plain, SculptingConfig)
    assert config.binder == plain.binder
    (tmp_path / "b.json").write_text(json.dumps({"losses": [{"type": ["a"]}]}), encoding="utf-8")
    with pytest.raises(ConfigError, match="expected the name of a loss"):
        parse(["gaussian-sculpting", "--data", "demo", "--config", str(tmp_path / "b.json")])
    with pytest.raises(ConfigError, match="--config is given twice"):
        parse(["gaussian-sculpting", "--config", str(tmp_path / "a.json"), "--config", str(tmp_path / "b.json")])


def test_views_that_a_run_left_out_are_its_own(tmp_path: Path):
    config = replace(parse(["gaussian-sculpting", "--data", "demo"]), skip_views=("r_3",))
    (tmp_path / "config.json").write_text(config_to_json(config), encoding="utf-8")
    again = parse(["gaussian-sculpting", "--data", "x", "--config", str(tmp_path / "config.json")])
    assert again.skip_views == ()


def test_no_module_is_imported_for_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "evil.py").write_text("raise SystemExit('ran')", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "a.json").write_text(json.dumps({"field": {"type": "evil:Field"}}), encoding="utf-8")
    with pytest.raises(ConfigError, match="'evil' is not imported"):
        parse(["gaussian-sculpting", "--data", "demo", "--config", str(tmp_path / "a.json")])
    with pytest.raises(ConfigError, match="parts without a package are for Python"):
        parse(["gaussian-sculpting", "--data", "demo", "--field", "evil:Field"])


def test_a_file_must_be_there_and_is_not_for_a_saved_run(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"none\.json cannot be read: No such file"):
        parse(["gaussian-sculpting", "--data", "demo", "--config", str(tmp_path / "none.json")])
    with pytest.raises(ConfigError, match="--config expects a JSON file"):
        parse(["gaussian-sculpting", "--data", "demo", "--config"])
    config = parse(["gaussian-sculpting", "--data", "demo"])
    (tmp_path / "config.json").write_text(config_to_json(config), encoding="utf-8")
    with pytest.raises(ConfigError, match="--config cannot be given with --resume"):
        parse(["--resume", str(tmp_path), "--config", str(tmp_path / "config.json")])
