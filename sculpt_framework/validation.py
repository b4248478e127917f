"""A config's values, checked before anything is built; the message names the option."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass

from sculpt_framework.config import ComponentConfig, MethodConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.ranges import Range, declared_ranges, require
from sculpt_framework.registry import name_of, slot_of, slots_of


def check(config: MethodConfig) -> None:
    """Raise ConfigError for the first value that no run can use: out of its range, or at odds with another."""
    _check_numbers(config, "")
    for slot in slots_of(type(config)).values():
        components = getattr(config, slot.name)
        if slot.many:
            names = [_name(component) for component in components]
            require(len(set(names)) == len(names), slot.name, " ".join(names), "each name once")
            for name, component in zip(names, components, strict=True):
                component.check(f"{slot.name}.{name}")
        else:
            components.check(slot.name)
    config.check()


def check_component(config: ComponentConfig) -> None:
    """The same for a component that is used without a method."""
    slot = slot_of(config)
    option = f"{slot.name}.{_name(config)}" if slot.many else slot.name
    _check_numbers(config, option)
    config.check(option)


def _check_numbers(config: ComponentConfig | MethodConfig, option: str) -> None:
    for name, value, ranges in _numbers(config, option):
        require(not isinstance(value, float) or math.isfinite(value), name, value, "a finite number")
        for each in ranges:
            require(value in each, name, value, str(each))


def _numbers(
    value: object, option: str, ranges: Sequence[Range] = ()
) -> Iterator[tuple[str, float | int, Sequence[Range]]]:
    """Every number in a config, with its option and the ranges its field declares."""
    prefix = f"{option}." if option else ""
    if isinstance(value, int | float):
        yield option, value, ranges
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            name = _name(item) if isinstance(item, ComponentConfig) else index
            yield from _numbers(item, f"{prefix}{name}", ranges)
    elif is_dataclass(value):
        declared = declared_ranges(type(value))
        for each in fields(value):
            yield from _numbers(
                getattr(value, each.name), f"{prefix}{each.name.replace('_', '-')}", declared[each.name]
            )


def _name(component: ComponentConfig) -> str:
    """As on the command line; from Python a component may be used that is not registered."""
    try:
        name = name_of(component)
    except ConfigError:
        return type(component).__name__
    return type(component).__name__ if ":" in name else name
