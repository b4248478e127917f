"""The options of ``sculpt-train``, in two passes over the words of the command line.

Which options exist depends on the components that are chosen. The first pass reads only what chooses components
(``--field NAME``, ``--losses NAME NAME``, ``--viewer``) and puts their default configs into the method's config. The
second pass hands tyro a type made for that config, with a group of options for each component in it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import field, fields, is_dataclass, make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from sculpt_framework import registry
from sculpt_framework.config import ComponentConfig, MethodConfig
from sculpt_framework.errors import ComponentImportError, ConfigError, UnknownComponentError
from sculpt_framework.registry import Slot, slots_of
from sculpt_framework.sculpting.config import PlanConfig, Switch

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]
"""A switch that is off unless named: no ``--no-`` twin, no default in the help."""

NONE = "none"
VIEWER = "viser"
REFINE_BOX = "refine_box"
HIDDEN = ("method", "repair")
"""Fields of a method's config that are no options."""
HELP, HELP_ALL = ("-h", "--help"), "--help-all"
RARE = ("level_gain_db", "holdout_every", "checkpoint_seconds", "replay", "refine_box_levels")
"""General options that ``--help`` leaves to ``--help-all``."""
USUAL_SLOTS = ("dataset",)
"""Slots whose component shows its options in ``--help``; of other slots it does where the words choose it."""
METAVARS = {
    "data": "DIR|demo|demo:NAME",
    "output": "DIR",
    "max_time": "SECONDS",
    "threads": "N",
    "reference": "FILE",
    REFINE_BOX: "X0 Y0 Z0 X1 Y1 Z1",
    "skip_views": "NAME ...",
}


def apply_words(config: MethodConfig, words: Sequence[str], program: str, description: str) -> MethodConfig:
    """``config`` as the command line changes it.

    ``program`` and ``description`` head the help text. Raises ConfigError for components, options and words that do
    not exist. As tyro does: prints the help and exits with 0 for ``--help``, which lists what a person sets, and
    ``--help-all``; exits with 2 for values of a wrong type.
    """
    chosen = tuple(slot for slot in slots_of(type(config)) if any(_names(word, slot) for word in words))
    config, words = swap_components(config, words)
    shown = None
    if HELP_ALL in words:
        words = [HELP[-1] if word == HELP_ALL else word for word in words]
    elif any(word in HELP for word in words):
        shown = (*USUAL_SLOTS, *chosen)
        left = len(flags(config)) - len(_usual_flags(config, shown))
        description += f"\n\n{HELP_ALL} lists {left} options more, --SLOT NAME --help those of a component."
    options, unknown = tyro.cli(
        _options_type(config, shown),
        args=words,
        prog=program,
        description=description,
        return_unknown_args=True,
        # Docstrings alone are help; a field that may be one of several dataclasses stays what it is.
        config=(tyro.conf.HelptextFromCommentsOff, tyro.conf.AvoidSubcommands),
    )
    if unknown:
        raise ConfigError(_explain_unknown(unknown[0], config))
    return _config_of(options, type(config))


def swap_components(config: MethodConfig, words: Sequence[str]) -> tuple[MethodConfig, list[str]]:
    """The first pass: the config with the components the words choose, and the words that are left.

    A component that is chosen again keeps the settings the method gave it.
    """
    rest: list[str] = []
    swapped: set[str] = set()
    viewer = False
    slots = slots_of(type(config))
    position = 0
    while position < len(words):
        word = words[position]
        position += 1
        option, equals, value = word.partition("=")
        slot = slots.get(option.removeprefix("--")) if option.startswith("--") else None
        if word == "--viewer":
            viewer = True
            continue
        if slot is None:
            rest.append(word)
            continue
        if slot.name in swapped:
            raise ConfigError(f"{option} is given twice. Give it once{', with all names' if slot.many else ''}.")
        swapped.add(slot.name)
        chosen = [value] if equals else []
        while position < len(words) and not words[position].startswith("-") and (slot.many or not chosen):
            chosen.append(words[position])
            position += 1
        config = _choose(config, slot, chosen)
    if viewer and VIEWER not in (registry.name_of(observer) for observer in config.observers):
        config = replace(config, observers=(*config.observers, registry.default("observers", VIEWER)))
    return config, rest


def _names(word: str, slot: str) -> bool:
    return word.partition("=")[0] == f"--{slot}"


def flags(config: MethodConfig) -> tuple[str, ...]:
    """Every option there is for ``config``, in the order of the help, without the leading dashes."""
    slots = slots_of(type(config))
    chosen = tuple(f"{slot}.{option}" for slot in slots for option in _slot_flags(getattr(config, slot)))
    groups = tuple(
        f"{name.replace('_', '-')}.{option}" for name in _groups(config) for option in _flags_of(getattr(config, name))
    )
    general = tuple(name.replace("_", "-") for name in _general(config))
    plan = _plan_of(config)
    items = () if plan is None else ("plan", *(f"plan.{option}" for option in _flags_of(plan) if option != "mode"))
    return (*general, "resume", "config", "viewer", *items, *slots, *chosen, *groups)


def _usual_flags(config: MethodConfig, shown: Sequence[str]) -> list[str]:
    """Those of ``flags`` that the help shows where components of these slots alone show theirs."""
    parts = ((flag, *flag.partition(".")[:2]) for flag in flags(config))
    return [flag for flag, part, dot in parts if (part in shown if dot else part.replace("-", "_") not in RARE)]


def _general(config: MethodConfig) -> tuple[str, ...]:
    """Fields that are one value each."""
    others = (*HIDDEN, *slots_of(type(config)))
    own = (each.name for each in fields(config) if each.name not in others)
    return tuple(name for name in own if not is_dataclass(getattr(config, name)))


def _groups(config: MethodConfig) -> tuple[str, ...]:
    """Fields that are several options each, under a common prefix."""
    slots = slots_of(type(config))
    values = {each.name: getattr(config, each.name) for each in fields(config) if each.name not in slots}
    return tuple(name for name, value in values.items() if is_dataclass(value) and not isinstance(value, PlanConfig))


def _plan_of(config: MethodConfig) -> PlanConfig | None:
    """What is decided from the scene's data, in methods that decide anything."""
    return next((value for each in fields(config) if isinstance(value := getattr(config, each.name), PlanConfig)), None)


def _choose(config: MethodConfig, slot: Slot, chosen: list[str]) -> MethodConfig:
    available = ", ".join((*registry.names(slot.name), NONE) if slot.many else registry.names(slot.name))
    if not chosen or "" in chosen:
        raise ConfigError(f"--{slot.name} expects {'names' if slot.many else 'a name'}. Available: {available}.")
    if slot.many and chosen == [NONE]:
        return replace(config, **{slot.name: ()})
    if slot.many and NONE in chosen:
        raise ConfigError(f"--{slot.name} {' '.join(chosen)}: 'none' stands alone, for an empty list.")
    present = getattr(config, slot.name) if slot.many else (getattr(config, slot.name),)
    kept = {registry.name_of(component): component for component in present}
    components: dict[str, ComponentConfig] = {}
    for word in chosen:
        if ":" in word:
            raise ConfigError(f"--{slot.name} {word}: parts without a package are for Python. Available: {available}.")
        try:
            kind = registry.load(slot.name, word)
        except UnknownComponentError as error:
            raise UnknownComponentError(f"--{slot.name} {word}: {error}") from None
        name = registry.spelled(word, registry.names(slot.name)) or word
        if name in components:
            raise ConfigError(f"--{slot.name} {' '.join(chosen)}: {name!r} is named twice.")
        same = name in kept and type(kept[name]) is kind
        components[name] = kept[name] if same else registry.default(slot.name, name)
    value = tuple(components.values()) if slot.many else next(iter(components.values()))
    return replace(config, **{slot.name: value})


def _options_type(config: MethodConfig, shown: Sequence[str] | None = None) -> type[MethodConfig]:
    """The config's type with each slot narrowed to the components in ``config``, and the options that choose them.

    A subclass, so that tyro finds the help of the general options there. For a help text that shows what is usual,
    ``shown`` are the slots whose components show their options; the rest is not there.
    """
    kind = type(config)
    made: list[tuple[str, Any, Any]] = [
        (each.name, Annotated[each.type, tyro.conf.Suppress], getattr(config, each.name))
        for each in fields(kind)
        if each.name in HIDDEN
    ]
    names = _general(config)
    for general in fields(kind):
        if general.name in names:
            option = _general_option(general.name, general.type)
            if shown is not None and general.name in RARE:
                option = Annotated[general.type, tyro.conf.Suppress]
            made.append((general.name, option, getattr(config, general.name)))
    resume = tyro.conf.arg(metavar="RUN_DIR", help="Go on with the run saved there.", help_behavior_hint="")
    viewer = tyro.conf.arg(help="Short for adding the observer viser: watch in a browser.", help_behavior_hint="")
    settings = tyro.conf.arg(
        metavar="FILE", help="Settings in JSON, a run's config.json or a part of one.", help_behavior_hint=""
    )
    made.append(("resume", Annotated[Path | None, resume], None))
    made.append(("config", Annotated[Path | None, settings], None))
    made.append(("viewer", Annotated[bool, tyro.conf.FlagCreatePairsOff, viewer], False))
    for slot in slots_of(kind).values():
        current = getattr(config, slot.name)
        known = registry.names(slot.name)
        if slot.many:
            chosen = tuple(registry.name_of(component) for component in current)
            text = f"The {slot.name}, by name. {NONE}: leave all out."
            option = tyro.conf.arg(name=slot.name, metavar=f"{{{','.join(known)}}} ... | {NONE}", help=text)
            made.append((f"{slot.name}_chosen", Annotated[tuple[str, ...], option], chosen or (NONE,)))
            parts = [
                (f"part_{index}", Annotated[type(component), tyro.conf.arg(name=name)], component)
                for index, (name, component) in enumerate(zip(chosen, current, strict=True))
            ]
            group = make_dataclass(slot.name, parts, frozen=True, kw_only=True)
            made.append((slot.name, _if(shown is None or slot.name in shown, group), group()))
        else:
            option = tyro.conf.arg(name=slot.name, help=f"The {slot.one}, by name.")
            choice = Annotated[Literal[known], option]  # pyright: ignore[reportInvalidTypeForm]
            made.append((f"{slot.name}_chosen", choice, registry.name_of(current)))
            made.append((slot.name, _if(shown is None or slot.name in shown, type(current)), current))
    made += [(name, _if(shown is None, type(getattr(config, name))), getattr(config, name)) for name in _groups(config)]
    if (plan := _plan_of(config)) is not None:
        whole, items = _plan_options(plan)
        made += [whole, (items[0], _if(shown is None, items[1]), items[2])]
    return make_dataclass(
        "Options",
        [(name, kind, field(default=default)) for name, kind, default in made],
        bases=(kind,),
        frozen=True,
        kw_only=True,
    )


def _if(is_shown: bool, kind: Any) -> Any:
    return kind if is_shown else Annotated[kind, tyro.conf.Suppress]


def _plan_options(plan: PlanConfig) -> list[tuple[str, Any, Any]]:
    """``--plan on|off`` and a switch for each item."""
    whole = tyro.conf.arg(
        name="plan", help="Decide from the scene's data what this run does without (docs/background/plan.md)."
    )
    item = tyro.conf.arg(metavar="on|off", help_behavior_hint="")
    items = make_dataclass(
        "Items",
        [
            (each.name, Annotated[each.type, item], field(default=getattr(plan, each.name)))
            if each.name != "mode"
            else (each.name, Annotated[each.type, tyro.conf.Suppress], field(default=plan.mode))
            for each in fields(PlanConfig)
        ],
        bases=(PlanConfig,),
        frozen=True,
        kw_only=True,
    )
    return [("plan_mode", Annotated[Switch, whole], plan.mode), ("plan", items, items())]


def _general_option(name: str, kind: Any) -> Any:
    """``kind`` with how the option shows in the help: what None means is in the text, so it is not shown."""
    if name == "data":
        return Annotated[kind, tyro.conf.arg(metavar=METAVARS[name], help_behavior_hint="(required)")]
    if name == REFINE_BOX:
        option = tyro.conf.arg(metavar=METAVARS[name], help_behavior_hint="")
        return Annotated[kind, tyro.conf.UseAppendAction, option]
    if name in METAVARS:
        return Annotated[kind, tyro.conf.arg(metavar=METAVARS[name], help_behavior_hint="")]
    return kind


def _config_of(options: MethodConfig, kind: type[MethodConfig]) -> MethodConfig:
    values = {each.name: getattr(options, each.name) for each in fields(kind)}
    if (plan := _plan_of(options)) is not None:
        switches = {each.name: getattr(plan, each.name) for each in fields(PlanConfig)}
        values["plan"] = PlanConfig(**switches | {"mode": vars(options)["plan_mode"]})
    for slot in slots_of(kind).values():
        if slot.many:
            group = values[slot.name]
            values[slot.name] = tuple(getattr(group, part.name) for part in fields(group))
    return kind(**values)


def _slot_flags(value: ComponentConfig | tuple[ComponentConfig, ...]) -> Iterator[str]:
    if isinstance(value, tuple):
        for component in value:
            yield from (f"{registry.name_of(component)}.{option}" for option in _flags_of(component))
    else:
        yield from _flags_of(value)


def _flags_of(value: Any) -> Iterator[str]:
    """Options of the fields of a dataclass, nested ones with a dot between, items of a tuple by their index."""
    for each in fields(value):
        name, inner = each.name.replace("_", "-"), getattr(value, each.name)
        parts = inner if isinstance(inner, tuple) else (inner,)
        if not any(is_dataclass(part) for part in parts):
            yield name
            continue
        for index, part in enumerate(parts):
            prefix = f"{name}.{index}" if isinstance(inner, tuple) else name
            yield from (f"{prefix}.{option}" for option in _flags_of(part))


def _explain_unknown(word: str, config: MethodConfig) -> str:
    if not word.startswith("-"):
        return f"{word!r} belongs to no option. Options start with two dashes; --help-all lists them."
    option = word.partition("=")[0].removeprefix("--").replace("_", "-").replace(".no-", ".")
    slot, _, rest = option.partition(".")
    slots = slots_of(type(config))
    if slot in slots and rest:
        owner = _explain_absent(f"--{option}", slots[slot], rest, config)
        if owner:
            return owner
    near = registry.closest(option, flags(config))
    hint = f" Did you mean --{near}?" if near else ""
    return f"there is no option {word.partition('=')[0]}.{hint} --help-all lists them all."


def _explain_absent(flag: str, slot: Slot, option: str, config: MethodConfig) -> str | None:
    """Which flag to add, if ``option`` belongs to a component of ``slot`` that is not chosen."""
    if slot.many:
        name, _, option = option.partition(".")
        chosen = tuple(registry.name_of(component) for component in getattr(config, slot.name))
        if name in chosen or name not in registry.names(slot.name):
            return None
        return (
            f"{flag} belongs to {slot.one} {name!r}, which this run does not use. "
            f"Add --{slot.name} {' '.join((*chosen, name))}."
        )
    current = registry.name_of(getattr(config, slot.name))
    owners = [name for name in registry.names(slot.name) if name != current and option in _default_flags(slot, name)]
    if not owners:
        return None
    named = " and ".join(repr(name) for name in owners)
    choices = " or ".join(f"--{slot.name} {name}" for name in owners)
    return f"{flag} belongs to {slot.one} {named}, but this run uses {current!r}. Add {choices}."


def _default_flags(slot: Slot, name: str) -> tuple[str, ...]:
    """Options of a component, none if its package is broken: it was not asked for."""
    try:
        return tuple(_flags_of(registry.default(slot.name, name)))
    except ComponentImportError:
        return ()
