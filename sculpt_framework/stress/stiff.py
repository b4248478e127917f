"""Training with stiff weights, rates and loops: what error a small run ends with, over the parameter."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

from sculpt_framework import registry
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.errors import TrainingFailed
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.small import chamfer, small_method, small_scene, train, truth_of
from sculpt_framework.types import Scene

OBJECT = "blob"
WEIGHTS = tuple(10.0**power for power in range(-3, 5))
RATES = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0)
FAR_RATES = (*RATES, 1e3, 1e4)
BOUND = 0.1
"""Cells by which a step may move the surface, of the curves on which steps are bounded."""
CLOSE = 1.1
"""Errors up to this multiple of the best on the curve are as good."""
_DECADES = 3.0
_STEPS = 24
_SCALE = "mee-scale"
_RUINED = 8.0
"""Multiple of the error of the method as it is beyond which a run has lost the object."""

Change = Callable[[SculptingConfig, float], SculptingConfig]


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A parameter that is multiplied by factors."""

    name: str
    done: str
    factors: tuple[float, ...]
    change: Change


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """The scene and its truth, made when first asked for, and the errors so far."""

    errors: dict[tuple[str, float], Measured] = field(default_factory=dict)

    @cached_property
    def scene(self) -> Scene:
        return small_scene(OBJECT)

    @cached_property
    def truth(self) -> MeasuredMesh:
        return truth_of(demo_object(OBJECT))


def stiff_cases() -> Iterator[Case]:
    bench = Bench()
    for curve in curves():
        for factor in curve.factors:
            yield Case(
                id=f"stiff-{curve.name}-{factor:g}",
                group="stiff",
                done=f"{curve.done} times {factor:g}",
                expected="a closed finite mesh, or a stop with its reason",
                unit="Chamfer distance, 1e-2",
                limit=_RUINED,
                measure=partial(_point, bench, curve, factor),
            )
        expected, limit = _expected_range(curve)
        yield Case(
            id=f"stiff-{curve.name}-range",
            group="stiff",
            done=f"{curve.done}: width of the range with an error within 10 % of the best",
            expected=expected,
            unit="decades",
            limit=limit,
            measure=partial(_range, bench, curve),
            at_least=True,
        )
    for name, done, config in settings():
        yield Case(
            id=f"stiff-{name}",
            group="stiff",
            done=done,
            expected="a closed finite mesh, or a stop with its reason",
            unit="Chamfer distance, 1e-2",
            limit=_RUINED,
            measure=partial(_run, bench, config),
        )


def _expected_range(curve: Curve) -> tuple[str, float]:
    """In words, and in decades."""
    if curve.name.startswith("weight"):
        return "three decades", _DECADES
    if curve.change is _bounded_field_rate:
        return "two decades: the bound decides how far a step goes, not the rate", 2.0
    return "a factor of two; in so few steps the rate decides how far it comes", 0.3


def curves() -> list[Curve]:
    base = standard()
    found = [
        Curve(
            name=f"weight-{name}",
            done=f"weight of {name} ({weight:g})",
            factors=WEIGHTS,
            change=partial(_weighted, slot, name),
        )
        for slot in ("constraints", "losses")
        for name, weight in ((registry.name_of(part), part.weight) for part in getattr(base, slot))
        if name not in ("photometric", "silhouette", _SCALE)
    ]
    wide = f"weight of {_SCALE} (1), Gaussians starting at three times their width,"
    found.insert(0, Curve(name=f"weight-{_SCALE}", done=wide, factors=WEIGHTS, change=_wide))
    found.append(Curve(name="rate-field", done="learning rate of the field", factors=RATES, change=_field_rate))
    bounded = f"learning rate of the field, its steps bounded to {BOUND:g} cells,"
    found.append(Curve(name="rate-field-bounded", done=bounded, factors=FAR_RATES, change=_bounded_field_rate))
    found.append(
        Curve(name="rate-gaussians", done="learning rates of Gaussians and colours", factors=RATES, change=_inner_rates)
    )
    return found


def standard() -> SculptingConfig:
    """What is changed: the small method with three Gaussians on a face, so that all constraints are at work, and with
    the terms that a plan uses for photographs."""
    config = small_method(steps=_STEPS, inner_steps=3)
    more = [registry.default("losses", name) for name in ("consistency", "bending")]
    return replace(
        config,
        losses=(*config.losses, *more),
        binder=replace(config.binder, gaussians_per_face=3),  # pyright: ignore[reportCallIssue]
    )


def settings() -> Iterator[tuple[str, str, SculptingConfig]]:
    base = standard()
    for steps, outer in ((0, _STEPS), (1, _STEPS), (10_000, 1)):
        yield f"inner-{steps}", f"{steps} inner steps in each of {outer} outer steps", _inner_steps(base, steps, outer)
    joint = replace(base, trainer=replace(base.trainer, gradient_isolation=False))
    yield "isolation-off", "one joint update of Gaussians and surface", joint
    for count in (1, 2, 6, 12):
        binder = replace(base.binder, gaussians_per_face=count)  # pyright: ignore[reportCallIssue]
        yield f"k-{count}", f"K = {count} Gaussians on a face", replace(base, binder=binder)
    learnable = replace(base.binder, opacity="learnable")  # pyright: ignore[reportCallIssue]
    yield "opacity-learnable", "opacities are learned", replace(base, binder=learnable)
    yield (
        "opacity-learnable-fast",
        "opacities are learned at 100 times the rate",
        replace(base, binder=replace(learnable, opacity_rate=5.0)),
    )
    for slot, name, factor in (
        ("losses", "deviation", 100.0),
        ("losses", "sign-change", 100.0),
        ("losses", "eikonal", 1000.0),
    ):
        yield (
            f"outvoting-{name}-bounded",
            f"weight of {name} times {factor:g}, steps bounded to {BOUND:g} cells",
            _bounded(_weighted(slot, name, base, factor)),
        )
    cold = replace(base, trainer=replace(base.trainer, warm_start=False))
    yield "cold-start", "Gaussians start anew at every outer step", cold


def _weighted(slot: str, name: str, config: SculptingConfig, factor: float) -> SculptingConfig:
    parts = tuple(
        replace(part, weight=factor * part.weight) if registry.name_of(part) == name else part
        for part in getattr(config, slot)
    )
    return replace(config, **{slot: parts})


def _wide(config: SculptingConfig, factor: float) -> SculptingConfig:
    """Gaussians start three times as wide as their share of the face: the scale constraint has something to do."""
    wide = replace(config, binder=replace(config.binder, scale=3.0))  # pyright: ignore[reportCallIssue]
    return _weighted("constraints", _SCALE, wide, factor)


def _scaled(config: object, factor: float, names: Sequence[str]) -> object:
    return replace(config, **{name: factor * getattr(config, name) for name in names})  # pyright: ignore


def _field_rate(config: SculptingConfig, factor: float) -> SculptingConfig:
    return replace(config, field=_scaled(config.field, factor, ("rate",)))  # pyright: ignore


def _bounded_field_rate(config: SculptingConfig, factor: float) -> SculptingConfig:
    return _bounded(_field_rate(config, factor))


def _bounded(config: SculptingConfig) -> SculptingConfig:
    return replace(config, trainer=replace(config.trainer, trust_cells=BOUND))


def _inner_rates(config: SculptingConfig, factor: float) -> SculptingConfig:
    binder = _scaled(config.binder, factor, ("barycentric_rate", "scale_rate", "rotation_rate", "opacity_rate"))
    rates = tuple(name for name in type(config.appearance).__dataclass_fields__ if name.endswith("rate"))
    appearance = _scaled(config.appearance, factor, rates)
    return replace(config, binder=binder, appearance=appearance)  # pyright: ignore


def _inner_steps(config: SculptingConfig, steps: int, outer: int) -> SculptingConfig:
    stages = tuple(replace(stage, inner_steps=steps) for stage in config.trainer.stages)
    return replace(config, steps=outer, trainer=replace(config.trainer, stages=stages))


def _run(bench: Bench, config: SculptingConfig) -> Measured:
    try:
        outcome = train(config, bench.scene)
    except TrainingFailed as error:
        return Measured(value=math.inf, note=f"stopped without a surface: {error}")
    recoveries = len(outcome.of("recovered"))
    notes = [f"{recoveries} recoveries"] if recoveries else []
    notes += [f"stopped: {outcome.failure}"] if outcome.failure else []
    if not outcome.sound:
        return Measured(value=math.nan, note="; ".join(["the mesh is not closed", *notes]))
    return Measured(value=100.0 * chamfer(outcome, bench.truth), note="; ".join(notes))


def _point(bench: Bench, curve: Curve, factor: float) -> Measured:
    # At factor 1 all curves meet but those of another method.
    own = curve.change in (_wide, _bounded_field_rate)
    key = (curve.name, factor) if factor != 1.0 or own else ("", 1.0)
    if key not in bench.errors:
        bench.errors[key] = _run(bench, curve.change(standard(), factor))
    found = bench.errors[key]
    return replace(found, curve=(curve.name, factor, found.value))


def _range(bench: Bench, curve: Curve) -> Measured:
    points = [(factor, _point(bench, curve, factor).value) for factor in curve.factors]
    best = min(error for _, error in points if math.isfinite(error))
    low, high = safe_range(points, best)
    return Measured(value=math.log10(high / low), note=f"factors {low:g} to {high:g}; best error {best:.3g}")


def safe_range(points: Sequence[tuple[float, float]], best: float) -> tuple[float, float]:
    """First and last factor of the longest unbroken stretch whose errors are within ``CLOSE`` of the best."""
    stretches: list[list[float]] = [[]]
    for factor, error in points:
        if error <= CLOSE * best:
            stretches[-1].append(factor)
        else:
            stretches.append([])
    longest = max((each for each in stretches if each), key=lambda each: each[-1] / each[0])
    return longest[0], longest[-1]
