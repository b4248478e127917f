"""Configurations to JSON and back."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sculpt_framework import registry
from sculpt_framework.config import MethodConfig
from sculpt_framework.errors import ConfigError, SculptError, UnknownComponentError
from sculpt_framework.serialization import (
    config_from_json,
    config_from_values,
    config_to_json,
    config_to_values,
    read_config,
)
from sculpt_plugins.builtin import BUILTIN, METHODS

pytestmark = pytest.mark.usefixtures("fake")

BUILT_IN = [(slot, name) for slot, table in BUILTIN.items() for name in table]


def fancy(**changes: Any) -> MethodConfig:
    config = registry.load_method("fake")()
    field = replace(registry.default("field", "fancy"), **changes)  # pyright: ignore[reportArgumentType]
    return replace(config, field=field, data="x", output=Path("o"), max_time=3.5)  # pyright: ignore[reportArgumentType]


def through_text(config: MethodConfig) -> MethodConfig:
    return config_from_json(config_to_json(config))


def test_a_component_is_tagged_with_its_name():
    data = config_to_values(fancy())
    assert data["version"] == 1
    assert data["field"] == {
        "type": "fancy",
        "num_levels": 7,
        "resolution": [4, 256],
        "octaves": [1.0, 2.0],
        "decoder": "linear",
        "weights": None,
        "limit": None,
        "coarse_to_fine": True,
    }
    assert [loss["type"] for loss in data["losses"]] == ["likeness", "outline"]
    assert data["output"] == "o"


@pytest.mark.parametrize(
    "changes",
    [{}, {"weights": Path("w/x.bin"), "limit": 2.0}, {"octaves": ()}, {"octaves": (1e-300, 1e300), "decoder": "deep"}],
)
def test_round_trip(changes: dict[str, Any]):
    assert through_text(fancy(**changes)) == fancy(**changes)


@pytest.mark.parametrize(("slot", "name"), BUILT_IN)
def test_every_built_in_component_makes_the_round_trip(slot: str, name: str):
    component = registry.default(slot, name)
    value = (component,) if registry.SLOTS[slot].many else component
    config = replace(fancy(), **{slot: value})
    assert through_text(config) == config


@pytest.mark.parametrize("name", METHODS)
def test_every_method_makes_the_round_trip(name: str):
    config = registry.load_method(name)()
    assert through_text(config) == config


def test_absent_keys_take_their_defaults():
    data = config_to_values(fancy())
    data["field"] = {"type": "fancy"}
    del data["seed"]
    assert config_from_values(data) == fancy()


def test_files(tmp_path: Path):
    (tmp_path / "config.json").write_text(config_to_json(fancy()), encoding="utf-8")
    assert read_config(tmp_path / "config.json") == fancy()


def change(data: dict[str, Any], key: str, value: Any) -> None:
    """Set ``data[a][b]`` for the key "a.b", or remove it where the value is ``...``."""
    *path, last = key.split(".")
    for part in path:
        data = data[int(part) if isinstance(data, list) else part]
    if value is ...:
        del data[last]
    else:
        data[last] = value


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("version", 2, "the configuration has version 2; this program reads version 1."),
        ("version", ..., "the configuration has version None; this program reads version 1."),
        ("version", True, "the configuration has version True; this program reads version 1."),
        ("seed", "7", 'seed is "7"; expected a whole number.'),
        ("seed", True, "seed is true; expected a whole number."),
        ("seed", 1.0, "seed is 1.0; expected a whole number."),
        ("max_time", "1", 'max_time is "1"; expected a finite number.'),
        ("max_time", True, "max_time is true; expected a finite number."),
        ("max_time", math.nan, "max_time is NaN; expected a finite number."),
        ("max_time", 10**400, None),
        ("output", 3, "output is 3; expected a path."),
        ("output", "a\0b", 'output is "a\\u0000b"; expected a path.'),
        ("device", "tpu", "device is \"tpu\"; expected one of 'auto', 'cpu', 'cuda'."),
        ("device", ["cpu"], "device is [\"cpu\"]; expected one of 'auto', 'cpu', 'cuda'."),
        ("sead", 7, "sead is not a known key. Did you mean 'seed'?"),
        ("method", ..., "method is missing."),
        ("field", "fancy", 'field is "fancy"; expected an object with a "type".'),
        ("field", [], 'field is []; expected an object with a "type".'),
        ("field.type", ..., "field.type is null; expected the name of a field."),
        ("field.type", "fncy", None),
        ("field.type", "cubes", None),
        ("field.num_levels", 7.5, "field.num_levels is 7.5; expected a whole number."),
        ("field.num_level", 7, "field.num_level is not a known key. Did you mean 'num_levels'?"),
        ("field.resolution", [1], "field.resolution is [1]; expected a list of length 2."),
        ("field.resolution", [1, "2"], 'field.resolution[1] is "2"; expected a whole number.'),
        ("field.octaves", 1.0, "field.octaves is 1.0; expected a list."),
        ("field.coarse_to_fine", 1, "field.coarse_to_fine is 1; expected true or false."),
        ("losses", {}, "losses is {}; expected a list."),
        ("losses.0", {"type": "likeness", "weight": None}, None),
        ("losses.1.weight", [0.1], "losses[1].weight is [0.1]; expected a finite number."),
        ("trainer", ..., "trainer is missing."),
        ("trainer", 3, "trainer is 3; expected an object."),
        ("trainer.stages.0", {"share": 1}, "trainer.stages[0].level is missing."),
        (
            "trainer.stages.1.time_share",
            2,
            "trainer.stages[1].time_share is 2; the option is gone, null is what is left.",
        ),
        ("trainer.stages.1.inner_steps", "many", 'trainer.stages[1].inner_steps is "many"; expected a whole number.'),
    ],
)
def test_what_does_not_fit_is_named(key: str, value: Any, message: str | None):
    data = config_to_values(fancy())
    if key == "losses.0":
        data["losses"][0] = value
        message = "losses[0].weight is null; expected a finite number."
    elif key == "trainer.stages.0":
        data["trainer"]["stages"][0] = value
    else:
        change(data, key, value)
    with pytest.raises(ConfigError) as caught:
        config_from_values(data)
    text = str(caught.value)
    assert "\n" not in text
    if message is not None:
        assert text == message


def test_an_unknown_component_is_answered_with_the_nearest():
    data = config_to_values(fancy())
    data["field"]["type"] = "fncy"
    with pytest.raises(UnknownComponentError, match=r"^field: there is no field 'fncy'\. Did you mean 'fancy'\?"):
        config_from_values(data)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_numbers_json_has_no_word_for_are_not_written(number: float):
    with pytest.raises(ConfigError, match=r"field\.limit is -?(nan|inf); only finite numbers"):
        config_to_json(fancy(limit=number))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read: No such file or directory."),
        (b"", "not valid JSON"),
        (b'{"version": 1,', "not valid JSON"),
        (b"\xff\xfe\x00", "not valid JSON"),
        (b"[" * 100_000, "not valid JSON"),
        (b"9" * 5_000, "not valid JSON"),
        (b"[]", "a configuration must be a JSON object, not a list."),
        (b"3", "a configuration must be a JSON object, not a number."),
        (b'{"version": 1}', "method is missing."),
    ],
)
def test_files_that_are_no_configuration(tmp_path: Path, content: bytes | None, said: str):
    path = tmp_path / "config.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        read_config(path)
    assert str(caught.value).startswith(str(path))
    assert said in str(caught.value)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def paths_of(value: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [here, *(path for key, item in items for path in paths_of(item, (*here, key)))]


def replaced(value: Any, path: tuple[Any, ...], put: Callable[[Any], Any]) -> Any:
    if not path:
        return put(value)
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = replaced(value[path[0]], path[1:], put)
    return copy


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=300)
@given(data=st.data())
def test_any_change_of_a_configuration_is_read_or_refused(data: st.DataObject):
    original = config_to_values(fancy())
    path = data.draw(st.sampled_from(paths_of(original)))
    value = data.draw(JSON)
    how = data.draw(st.sampled_from(["replace", "add", "drop"]))

    def put(old: Any) -> Any:
        if how == "add" and isinstance(old, dict):
            return old | {data.draw(st.text()): value}
        if how == "drop" and old:
            return {} if isinstance(old, dict) else [] if isinstance(old, list) else value
        return value

    changed = replaced(original, path, put)
    try:
        config = config_from_values(changed)
    except ConfigError:
        return
    assert config_from_json(config_to_json(config)) == config


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=200)
@given(content=st.binary() | JSON.map(lambda value: json.dumps(value).encode()))
def test_any_file_is_read_or_refused(content: bytes, tmp_path: Path):
    path = tmp_path / "config.json"
    path.write_bytes(content)
    with pytest.raises(SculptError):
        read_config(path)
