"""Ranges that are declared in the types of a config's fields."""

from dataclasses import dataclass, replace
from typing import Annotated

import pytest

from sculpt_framework import registry
from sculpt_framework.config import LossConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.ranges import Range, above, at_least, between
from sculpt_framework.validation import check, check_component


@dataclass(frozen=True, kw_only=True)
class Part:
    """A group of settings inside a config."""

    share: Annotated[float, above(0, at_most=1)] = 1.0


@dataclass(frozen=True, kw_only=True)
class Base(LossConfig):
    weight: float = 1.0
    sizes: tuple[Annotated[int, at_least(1)], ...] = (1, 2)
    limit: Annotated[float, above(0)] | None = None
    radius: "Annotated[float, at_least(0)]" = 1.0
    parts: tuple[Part, ...] = (Part(),)

    def build(self):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Derived(Base):
    radius: Annotated[float, between(0, 5)] = 1.0

    def check(self, option: str) -> None:
        if self.limit is not None and self.radius > self.limit:
            raise ConfigError(f"--{option}.radius is {self.radius}; expected the limit or less.")


@pytest.mark.parametrize(
    ("limits", "words", "inside", "outside"),
    [
        (at_least(1), "1 or more", (1, 2.5), (0, 0.99)),
        (at_least(0, below=1), "0 or more, below 1", (0, 0.99), (-0.01, 1)),
        (at_least(0, below=2**63), "0 or more, below 2^63", (0, 2**63 - 1), (-1, 2**63)),
        (at_least(2, or_zero=True), "0, or 2 or more", (0, 2), (-1, 1)),
        (above(0), "above 0", (1e-9,), (0, -1)),
        (above(0, unit="seconds"), "seconds above 0", (1,), (0,)),
        (above(0, at_most=1), "above 0, at most 1", (0.1, 1), (0, 1.01)),
        (above(0, below=1), "above 0, below 1", (0.1,), (0, 1)),
        (between(16, 4096), "16 to 4096", (16, 4096), (15, 4097)),
    ],
)
def test_what_lies_in_a_range_and_how_it_is_called(
    limits: Range, words: str, inside: tuple[float | int, ...], outside: tuple[float | int, ...]
):
    assert str(limits) == words
    assert all(value in limits for value in inside)
    assert not any(value in limits for value in outside)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weight": -1.0}, r"--losses.Base.weight is -1.0; expected 0 or more\."),
        ({"sizes": (1, 0)}, r"--losses.Base.sizes.1 is 0; expected 1 or more\."),
        ({"limit": 0.0}, r"--losses.Base.limit is 0.0; expected above 0\."),
        ({"limit": float("inf")}, r"--losses.Base.limit is inf; expected a finite number\."),
        ({"radius": -1.0}, r"--losses.Base.radius is -1.0; expected 0 or more\."),
        ({"parts": (Part(), Part(share=2.0))}, r"--losses.Base.parts.1.share is 2.0; expected above 0, at most 1\."),
    ],
)
def test_a_range_holds_wherever_it_stands_in_the_type(changes: dict[str, object], message: str):
    check_component(Base())
    with pytest.raises(ConfigError, match=message):
        check_component(replace(Base(), **changes))


@pytest.mark.parametrize("radius", [-1.0, 6.0])
def test_a_derived_class_keeps_the_ranges_of_its_base(radius: float):
    check_component(Derived())
    with pytest.raises(ConfigError, match=r"radius is .*; expected 0 "):
        check_component(Derived(radius=radius))


def test_values_that_do_not_go_together_are_for_the_config_itself():
    with pytest.raises(ConfigError, match=r"--losses.Derived.radius is 3.0; expected the limit or less\."):
        check_component(Derived(radius=3.0, limit=2.0))


@pytest.mark.parametrize("slot", registry.SLOTS)
def test_defaults_of_all_components_are_in_their_ranges(slot: str):
    for name in registry.names(slot):
        check_component(registry.default(slot, name))


@pytest.mark.parametrize("method", registry.method_names())
def test_all_methods_are_in_their_ranges(method: str):
    check(registry.load_method(method)())
