"""What a run's own checks cost: the time spent in them beside the time of training."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import wraps
from typing import Any

from sculpt_framework import registry
from sculpt_framework.engine.session import Session
from sculpt_framework.sculpting.config import of_sculpting
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.small import small_scene, trainer_of

CHECKS = ("_check_terms", "_check_scene", "_check_gradients", "_check_shape")
"""The trainer's."""
BOUND = ("look", "shorten")
"""Its trust region's."""
_LIMIT = 2.0
_STEPS = 16
_PIXELS = 200


def guard_cases() -> Iterator[Case]:
    yield Case(
        id="guard-cost",
        group="guard",
        done=f"{_STEPS} outer steps of gaussian-sculpting on {_PIXELS} x {_PIXELS} images, checks and bound timed",
        expected="checks and the bound on steps together take less than 2 % of training time",
        unit="% of training time",
        limit=_LIMIT,
        measure=_share,
    )


class Stopwatch:
    """Adds up the seconds spent in functions. They do not call each other."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*arguments: Any) -> Any:
            began = time.perf_counter()
            try:
                return function(*arguments)
            finally:
                self.seconds += time.perf_counter() - began

        return call


def _share() -> Measured:
    config = of_sculpting(registry.load_method("gaussian-sculpting")())
    trainer = replace(config.trainer, polish_steps=0, fit_steps=60, trust_cells=0.1)
    config = replace(config, steps=_STEPS, trainer=trainer, observers=(), data="guard")
    session = Session(small_scene(pixels=_PIXELS), config)
    watch, trust = Stopwatch(), Stopwatch()
    for timer, owner, names in ((watch, trainer_of(session), CHECKS), (trust, trainer_of(session).trust, BOUND)):
        for name in names:
            setattr(owner, name, timer.timed(getattr(owner, name)))
    steps = Stopwatch()
    for name in ("settle", "update"):
        setattr(trainer_of(session), name, steps.timed(getattr(trainer_of(session), name)))
    session.run()
    checks, bound, step_ms = (1e3 * each.seconds / _STEPS for each in (watch, trust, steps))
    note = f"checks {checks:.2f} ms and steps' bound {bound:.2f} ms of {step_ms:.0f} ms an outer step"
    return Measured(value=100.0 * (checks + bound) / step_ms, note=note)
