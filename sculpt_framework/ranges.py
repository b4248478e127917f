"""Ranges of a config's numbers, declared in the field's type: ``steps: Annotated[int, at_least(1)]``.

A range holds for every number in the field, and for the fields of the same name in derived classes; None passes.
``sculpt_framework.validation`` checks them before anything is built. Free of torch, as all configs are.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, get_args, get_type_hints

from sculpt_framework.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Range:
    """Numbers between two bounds. Make one with ``at_least``, ``above`` or ``between``."""

    low: float | int
    high: float | int | None = None
    """None: no upper bound."""
    with_low: bool = True
    with_high: bool = True
    or_zero: bool = False
    """0 is allowed, too."""
    unit: str = ""

    def __contains__(self, value: float | int) -> bool:
        if self.or_zero and value == 0:
            return True
        above = value >= self.low if self.with_low else value > self.low
        return above and (self.high is None or (value <= self.high if self.with_high else value < self.high))

    def __str__(self) -> str:
        """As in "--steps is 0; expected 1 or more"."""
        low = f"{self.low:g} or more" if self.with_low else f"above {self.low:g}"
        if self.high is None:
            words = low
        elif self.with_low and self.with_high:
            words = f"{self.low:g} to {self.high:g}"
        else:
            words = f"{low}, {'at most' if self.with_high else 'below'} {_shown(self.high)}"
        return f"{'0, or ' if self.or_zero else ''}{f'{self.unit} ' if self.unit else ''}{words}"


def at_least(low: float | int, *, below: float | int | None = None, or_zero: bool = False) -> Range:
    """``low`` or more."""
    return Range(low=low, high=below, with_high=False, or_zero=or_zero)


def above(
    low: float | int, *, at_most: float | int | None = None, below: float | int | None = None, unit: str = ""
) -> Range:
    """More than ``low``."""
    return Range(low=low, high=at_most if below is None else below, with_low=False, with_high=below is None, unit=unit)


def between(low: float | int, high: float | int) -> Range:
    """``low`` to ``high``, both included."""
    return Range(low=low, high=high)


def declared_ranges(kind: type) -> Mapping[str, tuple[Range, ...]]:
    """The ranges of a config class's fields, by name: its own and those that its bases declare for the same name."""
    own = {each.name: dict[Range, None]() for each in fields(kind)}
    for base in kind.__mro__:
        for name, hint in get_type_hints(base, include_extras=True).items():
            if name in own:
                own[name].update(dict.fromkeys(_ranges_in(hint)))
    return {name: tuple(ranges) for name, ranges in own.items()}


def require(holds: bool, option: str, value: object, expected: str) -> None:
    """Raise ConfigError for an option whose value is not as expected."""
    if not holds:
        raise ConfigError(f"--{option} is {value}; expected {expected}.")


def require_levels(option: str, levels: int | None, coarse: int, fine: int) -> None:
    """Raise ConfigError unless a pyramid of so many grids, whose number may be open, can reach from so many cells at
    its coarsest level to so many at its finest; ``option`` is that of the component."""
    name = f"{option}.finest-resolution"
    require(fine >= coarse, name, fine, f"{option}.base-resolution ({coarse}) or more")
    holds = levels != 1 or fine == coarse
    require(holds, name, fine, f"{option}.base-resolution ({coarse}), as {option}.num-levels is 1")


def _ranges_in(hint: Any) -> Iterator[Range]:
    """Also of members of a union and items of a tuple."""
    for part in get_args(hint):
        if isinstance(part, Range):
            yield part
        else:
            yield from _ranges_in(part)


def _shown(bound: float | int) -> str:
    power = int(bound).bit_length() - 1
    return f"2^{power}" if power >= 31 and bound == 2**power else f"{bound:g}"
