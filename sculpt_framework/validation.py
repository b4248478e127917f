"""Ranges of a config's numbers, checked before anything is built; the message names the option."""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from sculpt_framework.config import ComponentConfig, MethodConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.registry import name_of, slots_of


def check(config: MethodConfig) -> None:
    """Raise ConfigError for the first value that no run can use."""
    for option, value in _numbers(config, ""):
        require(math.isfinite(value), option, value, "a finite number")
    if config.max_time is not None:
        require(config.max_time > 0, "max-time", config.max_time, "seconds above 0")
    if config.threads is not None:
        require(config.threads >= 1, "threads", config.threads, "1 or more")
    require(0 <= config.seed < 2**63, "seed", config.seed, "0 or more, below 2^63")
    require(config.steps >= 1, "steps", config.steps, "1 or more")
    require(config.holdout_every >= 0, "holdout-every", config.holdout_every, "0 or more")
    require(config.checkpoint_seconds > 0, "checkpoint-seconds", config.checkpoint_seconds, "seconds above 0")
    for slot in (slot for slot in slots_of(type(config)).values() if slot.many):
        names = [name_of(component) for component in getattr(config, slot.name)]
        require(len(set(names)) == len(names), slot.name, " ".join(names), "each name once")
    config.check()


def require(holds: bool, option: str, value: object, expected: str) -> None:
    """Raise ConfigError for an option whose value is not as expected."""
    if not holds:
        raise ConfigError(f"--{option} is {value}; expected {expected}.")


def _numbers(value: object, option: str) -> Iterator[tuple[str, float]]:
    """Every floating-point number in a config, with its option."""
    prefix = f"{option}." if option else ""
    if isinstance(value, float):
        yield option, value
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from _numbers(item, f"{prefix}{name_of(item) if isinstance(item, ComponentConfig) else index}")
    elif is_dataclass(value):
        for each in fields(value):
            yield from _numbers(getattr(value, each.name), f"{prefix}{each.name.replace('_', '-')}")
