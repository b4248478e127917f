"""What is done to a run while it lives, and whether it survives."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import torch

from sculpt_framework.engine.session import Session
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.small import Outcome, method_of, small_method, small_scene, train, trainer_of
from sculpt_framework.types import Scene

AT = 6
"""Outer steps before the injury."""
_LOSS_AT_MOST = 3.0
"""dB of held-out PSNR that a run may lose by an injury: it goes on at half the rates."""

Injure = Callable[[Session], None]


@dataclass(frozen=True, kw_only=True)
class Injury:
    """Something done to a run before an outer step."""

    name: str
    done: str
    injure: Injure
    names: str
    """What the message must name."""


def _field_nan(session: Session) -> None:
    with torch.no_grad():
        next(iter(trainer_of(session).field.parameters()))[0] = torch.nan


def _gradient_nan(session: Session) -> None:
    """Of the next backward pass through the field, once."""
    parameter = next(iter(trainer_of(session).field.parameters()))

    def spoil(gradient: torch.Tensor) -> torch.Tensor:
        handle.remove()
        return torch.full_like(gradient, torch.nan)

    handle = parameter.register_hook(spoil)


def _image_nan(session: Session) -> None:
    """In the view that the next step looks at first, until the view order is drawn anew."""
    images = method_of(session).images
    index = trainer_of(session).views.order[-1] if trainer_of(session).views.order else 0
    spoilt = images[index].premultiplied.clone()
    spoilt[0, 0, 0] = torch.nan
    images[index] = replace(images[index], premultiplied=spoilt)


def _colour_nan(session: Session) -> None:
    with torch.no_grad():
        next(iter(trainer_of(session).scene.appearance_rows.leaves.values()))[0] = torch.nan


def _shape_nan(session: Session) -> None:
    with torch.no_grad():
        trainer_of(session).scene.geometry_rows.leaves["log_ratios"][0] = torch.nan


def _moments_infinite(session: Session) -> None:
    optimizer = trainer_of(session).optimizer
    state = optimizer.state()
    optimizer.load_state({n: v.fill_(torch.inf) if n.endswith("exp_avg") else v for n, v in state.items()})


def _level(value: float, session: Session) -> None:
    """The coarsest table of the hash grid is added to the distance."""
    with torch.no_grad():
        next(iter(trainer_of(session).field.parameters())).fill_(value)


INJURIES = (
    Injury(name="field-nan", done="a field parameter is NaN", injure=_field_nan, names="the field"),
    Injury(name="gradient-nan", done="the field's gradient is NaN", injure=_gradient_nan, names="the field"),
    Injury(name="colour-nan", done="the colour of a Gaussian is NaN", injure=_colour_nan, names="appearance"),
    Injury(name="shape-nan", done="the scale of a Gaussian is NaN", injure=_shape_nan, names="binder"),
    Injury(name="moments-infinite", done="Adam's moments are infinite", injure=_moments_infinite, names="the field"),
    Injury(
        name="all-outside", done="the distance is positive everywhere", injure=partial(_level, 5.0), names="one sign"
    ),
)


def life_cases() -> Iterator[Case]:
    for injury in INJURIES:
        yield Case(
            id=f"life-{injury.name}",
            group="life",
            done=f"once, {injury.done} before outer step {AT}",
            expected="noticed in that step, last good state restored, rates halved; the mesh is as good",
            unit="dB lost",
            limit=_LOSS_AT_MOST,
            measure=partial(_once, injury),
        )
        yield Case(
            id=f"life-{injury.name}-always",
            group="life",
            done=f"again and again, {injury.done}",
            expected="stops, says which component, leaves the best closed mesh until then",
            unit="dB lost",
            limit=2 * _LOSS_AT_MOST,
            measure=partial(_always, injury),
        )
    yield Case(
        id="life-image-nan",
        group="life",
        done="a pixel of a training image is NaN from a step on",
        expected="stops, says which component, leaves the best closed mesh until then",
        unit="dB lost",
        limit=2 * _LOSS_AT_MOST,
        measure=partial(_always, Injury(name="", done="", injure=_image_nan, names="photometric")),
    )
    yield Case(
        id="life-all-inside",
        group="life",
        done=f"once, the distance is negative everywhere before outer step {AT}",
        expected="the surface is the wall of the box then, and training goes on from there to a closed mesh",
        unit="open meshes",
        limit=0.0,
        measure=_inside,
    )


@lru_cache(maxsize=1)
def _scene() -> Scene:
    return small_scene()


@lru_cache(maxsize=1)
def _unharmed() -> Outcome:
    return train(small_method(), _scene())


def injured(injury: Injury, *, always: bool) -> Outcome:
    """A small run with the injury at step ``AT``, or at it and every one after."""

    def before(session: Session) -> None:
        nonlocal once
        if session.step >= AT and (always or not once):
            injury.injure(session)
            once = True

    once = False
    return train(small_method(), _scene(), before)


def _once(injury: Injury) -> Measured:
    found = injured(injury, always=False)
    recoveries = found.of("recovered")
    if len(recoveries) != 1 or not found.sound or found.failure is not None:
        return Measured(value=float("inf"), note=f"{len(recoveries)} recoveries, failure: {found.failure}")
    (event,) = recoveries
    message = event.data["error"]
    if event.outer != AT or event.data["rate_scale"] != 0.5 or injury.names not in message:
        return Measured(value=float("inf"), note=f"noticed at step {event.outer}: {message}")
    return Measured(value=_unharmed().psnr - found.psnr, note=f"noticed at step {event.outer}: {message}")


def _always(injury: Injury) -> Measured:
    found = injured(injury, always=True)
    if found.failure is None or injury.names not in found.failure or not found.sound:
        return Measured(value=float("inf"), note=f"failure: {found.failure}")
    return Measured(value=_unharmed().psnr - found.psnr, note=found.failure)


def _inside() -> Measured:
    injury = Injury(name="", done="", injure=partial(_level, -5.0), names="")
    found = injured(injury, always=False)
    note = f"{_unharmed().psnr - found.psnr:.1f} dB lost; {len(found.of('recovered'))} recoveries"
    return Measured(value=0.0 if found.sound and found.failure is None else 1.0, note=note)
