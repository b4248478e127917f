"""Options of components by name, whatever the component: the plan knows options, no classes."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

from sculpt_framework.config import ComponentConfig
from sculpt_framework.registry import SLOTS, name_of
from sculpt_framework.sculpting.config import SculptingConfig, TrainerConfig

Settings = ComponentConfig | TrainerConfig


def has_option(settings: Settings, option: str) -> bool:
    return option in (each.name for each in fields(settings))


def option_of(settings: Settings, option: str) -> Any:
    """Its value; None where the component has no such option."""
    return getattr(settings, option) if has_option(settings, option) else None


def with_options(config: SculptingConfig, slot: str, **options: object) -> SculptingConfig:
    """The config with other values for options of a component, or of the trainer, that has them."""
    return replace(config, **{slot: replace(getattr(config, slot), **options)})


def without(config: SculptingConfig, slot: str, names: Sequence[str]) -> SculptingConfig:
    """The config without some components of a slot that takes many."""
    return replace(config, **{slot: tuple(each for each in getattr(config, slot) if name_of(each) not in names)})


def set_by_hand(config: SculptingConfig, own: SculptingConfig, paths: Sequence[str]) -> str | None:
    """The first of the paths (``slot``, ``slot.option``) whose value is not the method's own, as an option."""
    for path in paths:
        slot, _, option = path.partition(".")
        mine, theirs = getattr(config, slot), getattr(own, slot)
        if option:
            mine, theirs = option_of(mine, option), option_of(theirs, option)
        elif slot == "initializer":
            # Replaced as a whole, but for the views it looks at.
            mine = replace(mine, max_views=option_of(theirs, "max_views")) if has_option(mine, "max_views") else mine
        elif slot in SLOTS and not SLOTS[slot].many:
            mine, theirs = name_of(mine), name_of(theirs)
        if mine != theirs:
            return f"--{path.replace('_', '-')}"
    return None
