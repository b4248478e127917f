"""Configurations as JSON and back, through the registry: ``{"type": "hash-grid", "num_levels": 7, ...}``.

Types are read off the dataclasses, so a new component needs nothing here. What does not fit raises ConfigError with
the key and the expected type; nothing in a file can run code. An option that is gone stays in its class's ``GONE`` with
the value that runs have had: files that say the same are read.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from sculpt_framework import registry
from sculpt_framework.config import ComponentConfig, MethodConfig
from sculpt_framework.errors import ConfigError, UnknownComponentError
from sculpt_framework.registry import SLOTS
from sculpt_framework.sculpting.config import SculptingConfig

VERSION = 1


def config_to_json(config: MethodConfig) -> str:
    """The config as JSON text. Raises ConfigError as ``config_to_values``."""
    return json.dumps(config_to_values(config), indent=2, allow_nan=False) + "\n"


def config_from_json(text: str) -> MethodConfig:
    """Inverse of ``config_to_json``. Raises ConfigError, also where the text is no JSON."""
    return config_from_values(_parsed(text))


def read_config(path: Path) -> MethodConfig:
    """Read a file that holds ``config_to_json``. Raises ConfigError, which names the file."""
    return _from_file(path, config_from_json)


def with_file(config: MethodConfig, path: Path) -> MethodConfig:
    """``config`` with what a JSON file says in its place: the whole of a run's config.json, or a few keys of it.

    Objects are merged key by key, a component of another "type" takes the place of the old one, and a list that of the
    list, but for components that were in it before: they keep what the file does not say. Where results go is not taken
    from a file, nor, from the whole of a run's config.json, which views of its scene were left out. Raises ConfigError,
    which names the file.
    """
    return _from_file(path, lambda text: _with_values(config, _parsed(text)))


def _from_file(path: Path, make: Callable[[str], MethodConfig]) -> MethodConfig:
    try:
        return make(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not valid JSON ({error}).") from error
    except ConfigError as error:
        raise type(error)(f"{path}: {error}") from error


def _parsed(text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not valid JSON ({error}).") from error


def _with_values(config: MethodConfig, said: object) -> MethodConfig:
    if not isinstance(said, dict):
        raise ConfigError(f"a configuration must be a JSON object, not {_kind(said)}.")
    if said.get("method", config.method) != config.method:
        raise ConfigError(f"it is of the method {said['method']!r}, not of {config.method!r}.")
    of_its_run = ("output", "repair", *(("skip_views",) if "version" in said else ()))
    own = {key: value for key, value in said.items() if key not in of_its_run}
    return config_from_values(_merged(config_to_values(config), own))


def _merged(base: Any, said: Any) -> Any:
    if isinstance(base, dict) and isinstance(said, dict):
        if "type" in said and registry.spelled(str(said["type"]), [str(base.get("type"))]) is None:
            return said
        return base | {key: _merged(base.get(key), value) for key, value in said.items()}
    if isinstance(base, list) and isinstance(said, list):
        there = {each["type"]: each for each in base if isinstance(each, dict) and "type" in each}
        return [_merged(_of_type(each, there), each) for each in said]
    return said


def _of_type(said: Any, there: Mapping[str, Any]) -> Any:
    """The component that has the type of what is said; None where there is none."""
    name = said.get("type") if isinstance(said, dict) else None
    return there.get(registry.spelled(str(name), there) or "")


def config_to_values(config: MethodConfig) -> dict[str, Any]:
    """The config as JSON values. Raises ConfigError if a component is not registered or a number is not finite."""
    return {"version": VERSION, **_encode(config, "")}


def config_from_values(values: object) -> MethodConfig:
    """Inverse of ``config_to_values``. Keys that are absent take their defaults. Raises ConfigError."""
    if not isinstance(values, Mapping):
        raise ConfigError(f"a configuration must be a JSON object, not {_kind(values)}.")
    version = values.get("version")
    if version != VERSION or isinstance(version, bool):
        raise ConfigError(f"the configuration has version {version!r}; this program reads version {VERSION}.")
    own = {key: value for key, value in values.items() if key != "version"}
    name = own.get("method")
    if not isinstance(name, str):
        raise (
            _mismatch("method", name, "the name of a method") if "method" in own else ConfigError("method is missing.")
        )
    try:
        kind = type(registry.load_method(name)())
    except UnknownComponentError as unknown:
        # A method may be gone, or renamed, and what it was made of still be here.
        try:
            return _decode_dataclass(SculptingConfig, own, "")
        except ConfigError:
            raise type(unknown)(f"method: {unknown}") from None
    return _decode_dataclass(kind, own, "")


def _encode(value: object, path: str) -> Any:
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ConfigError(f"{path} is {value}; only finite numbers can be saved.")
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return [_encode(item, f"{path}[{index}]") for index, item in enumerate(value)]
    if is_dataclass(value):
        tag = {"type": _name_of(value, path)} if isinstance(value, ComponentConfig) else {}
        return tag | {each.name: _encode(getattr(value, each.name), _join(path, each.name)) for each in fields(value)}
    raise ConfigError(f"{path} is of type {type(value).__name__}, which a configuration cannot hold.")


def _name_of(component: ComponentConfig, path: str) -> str:
    name = registry.name_of(component)
    if name.startswith("__main__:"):
        raise ConfigError(
            f"{path} is a {type(component).__qualname__} of a notebook or program, which no file can name; write it in "
            "a module of its own."
        )
    return name


def _decode(kind: Any, value: object, path: str) -> Any:
    """``value`` as an instance of the annotation ``kind``; ``path`` is the key for messages."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return _decode_union(arguments, value, path)
    if origin is Literal:
        if isinstance(value, str | int | NoneType) and any(
            value == each and type(value) is type(each) for each in arguments
        ):
            return value
        raise _mismatch(path, value, "one of " + ", ".join(repr(each) for each in arguments))
    if origin is tuple:
        return _decode_tuple(arguments, value, path)
    if isinstance(kind, type) and issubclass(kind, ComponentConfig):
        return _decode_component(kind, value, path)
    if isinstance(kind, type) and is_dataclass(kind):
        if not isinstance(value, Mapping):
            raise _mismatch(path, value, "an object")
        return _decode_dataclass(kind, value, path)
    if kind is float:
        return _decode_float(value, path)
    if kind is Path:
        if isinstance(value, str) and "\0" not in value:
            return Path(value)
        raise _mismatch(path, value, "a path")
    if kind in (bool, int, str, NoneType):
        if type(value) is kind:
            return value
        raise _mismatch(path, value, _NAMES[kind])
    raise ConfigError(f"{path}: its type {kind!r} cannot be read from JSON.")


_NAMES = {bool: "true or false", int: "a whole number", str: "text", NoneType: "null"}


def _decode_float(value: object, path: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
    raise _mismatch(path, value, "a finite number")


def _decode_union(kinds: tuple[Any, ...], value: object, path: str) -> Any:
    problems: list[str] = []
    for kind in kinds:
        try:
            return _decode(kind, value, path)
        except ConfigError as error:
            problems.append(str(error))
    if value is not None and NoneType in kinds and len(kinds) == 2:
        raise ConfigError(next(text for kind, text in zip(kinds, problems, strict=True) if kind is not NoneType))
    raise ConfigError("; or ".join(problems))


def _decode_tuple(kinds: tuple[Any, ...], value: object, path: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise _mismatch(path, value, "a list")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(kinds) != len(value):
        raise _mismatch(path, value, f"a list of length {len(kinds)}")
    return tuple(
        _decode(kind, item, f"{path}[{index}]") for index, (kind, item) in enumerate(zip(kinds, value, strict=True))
    )


def _decode_component(base: type[ComponentConfig], value: object, path: str) -> ComponentConfig:
    """A component by its "type". ``base`` is a slot's base class, or a certain component's config class."""
    if not isinstance(value, Mapping):
        raise _mismatch(path, value, 'an object with a "type"')
    slot = next((slot for slot in SLOTS.values() if issubclass(base, slot.base)), None)
    if slot is None:
        raise ConfigError(f"{path}: {base.__name__} belongs to no slot.")
    name = value.get("type")
    if not isinstance(name, str):
        raise _mismatch(_join(path, "type"), name, f"the name of a {slot.one}")
    try:
        kind = registry.load(slot.name, name)
    except ConfigError as error:
        raise type(error)(f"{path}: {error}") from error
    if not issubclass(kind, base):
        raise ConfigError(f"{path}: {name!r} is not a {base.__name__}.")
    return _decode_dataclass(kind, {key: item for key, item in value.items() if key != "type"}, path)


def _decode_dataclass(kind: type[Any], value: Mapping[str, object], path: str) -> Any:
    known, gone = {each.name: each for each in fields(kind)}, vars(kind).get("GONE", {})
    for key, said in value.items():
        if key in gone and said != gone[key]:
            left = json.dumps(gone[key])
            raise ConfigError(
                f"{_join(path, str(key))} is {json.dumps(said)}; the option is gone, {left} is what is left."
            )
        if key not in known and key not in gone:
            near = registry.closest(str(key), known)
            hint = f"Did you mean {near!r}?" if near else f"Known here: {', '.join(known)}."
            raise ConfigError(f"{_join(path, str(key))} is not a known key. {hint}")
    hints = get_type_hints(kind)
    for name, each in known.items():
        if name not in value and each.default is MISSING and each.default_factory is MISSING:
            raise ConfigError(f"{_join(path, name)} is missing.")
    decoded = {name: _decode(hints[name], item, _join(path, name)) for name, item in value.items() if name in known}
    try:
        return kind(**decoded)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _kind(value: object) -> str:
    return {dict: "an object", list: "a list", str: "text", bool: "true or false", NoneType: "null"}.get(
        type(value), "a number"
    )


def _mismatch(path: str, value: object, expected: str) -> ConfigError:
    shown = json.dumps(value, default=str)
    shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
    return ConfigError(f"{path} is {shown}; expected {expected}.")
