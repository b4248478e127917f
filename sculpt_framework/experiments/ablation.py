"""The paper's ablations as settings of ``sculpt-train``: what each factor stands for here, and how factors combine.

Which of our components make the paper's constraints is decided in docs/laboratory/experiments.md, and done here.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sculpt_framework import registry
from sculpt_framework.experiments.matrix import MatrixScene, Setting, config_of
from sculpt_framework.plan.agreement import (
    AGREEING_VIEWS,
    CONSISTENCY,
    FIRST_STEPS,
    FOLLOWING_STEPS,
    OUTLINE_VIEWS,
    PHOTOMETRIC,
)
from sculpt_framework.sculpting.config import SculptingConfig, of_sculpting

SCALE = frozenset({"mee-scale"})
"""Constraints that make the paper's scale constraint (equations 3 to 5)."""
DISTRIBUTION = frozenset({"boundary", "spacing", "coverage"})
"""Constraints that make its distribution constraint (equations 6 to 9)."""
OPACITY_OFF = frozenset({"none"})
SCALE_OFF = frozenset({"no-scale", "only-opacity", "none"})
DISTRIBUTION_OFF = frozenset({"no-distribution", "only-opacity", "none"})
"""Levels of the factor "constraints" at which each of the three is off."""
EVIDENCE = "evidence"
"""What the surface starts and learns from, where a plan decides it by the photographs (docs/background/plan.md)."""
DEFAULT = "default"
"""The setting that changes nothing."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """One value of a factor."""

    factor: str
    name: str
    """Part of the setting's name; what the tables show."""
    words: tuple[str, ...]
    replaces: tuple[str, ...] = ()
    """As in Setting."""


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """The settings of an ablation, the first of which is the method itself."""

    settings: tuple[Setting, ...]
    levels: Mapping[str, Mapping[str, str]]
    """By setting and factor: the name of the level."""
    same: Mapping[str, str]
    """Levels that are left out, each with the level, or the setting, that it is equal to."""


def ablation(method: str, scene: MatrixScene, extra: Sequence[str], *, factors: Sequence[str], full: bool) -> Ablation:
    """Settings that differ from the method in one factor, or, with ``full``, in every combination of factors.

    A level whose words stand for the same config as one before it is left out. Raises ConfigError where words are
    not valid for the method, as where it has nothing to learn an opacity with.
    """
    base = Setting(name=DEFAULT, method=method)
    config = config_of(base, scene, extra)
    axes: list[list[Level]] = []
    same: dict[str, str] = {}
    for axis in (axis for axis in _axes(of_sculpting(config)) if axis[0].factor in factors):
        kept = [(axis[0], config)]
        for level in axis[1:]:
            found = config_of(_setting(method, (level,), (axis[0],)), scene, extra)
            twin = next((other.name for other, known in kept if known == found), None)
            if twin is None:
                kept.append((level, found))
            else:
                same[level.name] = DEFAULT if twin == axis[0].name else twin
        axes.append([level for level, _ in kept])
    # Factors change different fields of the config, so that what differs in a factor differs in every combination.
    own = tuple(axis[0] for axis in axes)
    if full:
        combinations = list(itertools.product(*axes))
    else:
        changes = [(place, level) for place, axis in enumerate(axes) for level in axis[1:]]
        combinations = [own, *((*own[:place], level, *own[place + 1 :]) for place, level in changes)]
    settings = tuple(_setting(method, combination, own) for combination in combinations)
    levels = {
        setting.name: {level.factor: level.name for level in combination}
        for setting, combination in zip(settings, combinations, strict=True)
    }
    return Ablation(settings=settings, levels=levels, same=same)


def _axes(config: SculptingConfig) -> list[list[Level]]:
    """The levels of each factor, the method's own first."""
    return [_constraints(config), _field(config), _isolation(config), _start(config), _evidence(config)]


def _setting(method: str, combination: Sequence[Level], own: Sequence[Level]) -> Setting:
    changed = [level for level, mine in zip(combination, own, strict=True) if level.name != mine.name]
    return Setting(
        name="+".join(level.name for level in changed) or DEFAULT,
        method=method,
        words=tuple(word for level in changed for word in level.words),
        replaces=tuple(option for level in changed for option in level.replaces),
    )


def _constraints(config: SculptingConfig) -> list[Level]:
    """Table 3 of the paper: all, without scale, without distribution, only opacity, none."""
    names = [registry.name_of(constraint) for constraint in config.constraints]

    def without(name: str, left_out: frozenset[str], *more: str) -> Level:
        rest = [constraint for constraint in names if constraint not in left_out]
        return Level(
            factor="constraints",
            name=name,
            words=("--constraints", *(rest or ["none"]), *more),
            replaces=("--constraints", *(f"--constraints.{constraint}." for constraint in sorted(left_out))),
        )

    return [
        Level(factor="constraints", name="all", words=()),
        without("no-scale", SCALE),
        without("no-distribution", DISTRIBUTION),
        without("only-opacity", SCALE | DISTRIBUTION),
        without("none", SCALE | DISTRIBUTION, "--binder.opacity", "learnable"),
    ]


def _field(config: SculptingConfig) -> list[Level]:
    """The method's own field, the paper's MLP, and one number per corner of the finest extraction grid."""
    own = registry.name_of(config.field)
    cells = config.trainer.finest_cells
    rows = {
        own: (),
        "mlp": ("--field", "mlp"),
        "discrete": ("--field", "dense-grid", "--field.resolution", str(cells)),
    }
    return [
        Level(factor="field", name=name, words=words, replaces=("--field", "--field.") if words else ())
        for name, words in rows.items()
    ]


def _isolation(config: SculptingConfig) -> list[Level]:
    rows = [
        Level(factor="isolation", name="isolation", words=("--trainer.gradient-isolation",)),
        Level(factor="isolation", name="no-isolation", words=("--trainer.no-gradient-isolation",)),
    ]
    return rows if config.trainer.gradient_isolation else rows[::-1]


def _start(config: SculptingConfig) -> list[Level]:
    rows = [
        Level(factor="start", name="warm-start", words=("--trainer.warm-start",)),
        Level(factor="start", name="cold-start", words=("--trainer.no-warm-start",)),
    ]
    return rows if config.trainer.warm_start else rows[::-1]


def _evidence(config: SculptingConfig) -> list[Level]:
    """As planned; without agreement between photographs, with colours beside it, without what smooths plain places;
    from depths by equal colours and from the visual hull alone; and the paper's own loss and start."""
    names = [registry.name_of(loss) for loss in config.losses]
    colours = ("--losses", *(name for name in names if name != CONSISTENCY))
    agreement = (f"--losses.{PHOTOMETRIC}.weight", "0", f"--losses.{CONSISTENCY}.views", str(AGREEING_VIEWS))
    following = ("--trainer.warm-up-steps", str(FIRST_STEPS), "--trainer.stages.0.inner-steps", str(FOLLOWING_STEPS))
    hull = ("--initializer", "visual-hull")
    rows: dict[str, tuple[str, ...]] = {
        "planned": (),
        "no-agreement": colours,
        "with-colours": ("--plan.light", "off"),
        "no-bending": (*agreement, *following, "--trainer.stages.0.outer-views", str(OUTLINE_VIEWS)),
        "no-stereo": ("--plan.stereo", "off"),
        "from-hull": ("--plan.stereo", "off", *hull),
        "paper-loss": ("--plan.stereo", "off", *hull, *colours),
    }
    return [Level(factor=EVIDENCE, name=name, words=words) for name, words in rows.items()]
