"""``sculpt-stress``: stiff and extreme cases with a figure each."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError

if TYPE_CHECKING:
    from sculpt_framework.stress.cases import Result

PROGRAM = "sculpt-stress"


@dataclass(frozen=True, kw_only=True)
class StressRequest:
    """Try what breaks reconstructions and say by how much it does: float32 against float64, NaN, lost surfaces, stiff
    weights, impossible scenes. Ends with exit code 1 if a case is not within its limit.
    """

    group: tuple[Literal["operators", "life", "scenes", "stiff", "guard"], ...] = (
        "operators",
        "life",
        "scenes",
        "stiff",
        "guard",
    )
    """operators: every differentiable step at its degenerate inputs, seconds; life: injuries of a run, a minute;
    scenes: extreme input; stiff: weights and rates over decades; guard: what the checks of a run cost; minutes each."""
    only: Annotated[str, tyro.conf.arg(metavar="TEXT", help_behavior_hint="")] = ""
    """Run only cases whose name contains this."""
    json: Flag = False
    """Print JSON."""


def main() -> None:
    """The console script ``sculpt-stress``."""
    exit_codes.run(lambda: stress(sys.argv[1:]))


def stress(words: Sequence[str]) -> None:
    """Run and print. Raises ConfigError; exits with 1 if a case failed, and as tyro does for ``--help``."""
    request = tyro.cli(StressRequest, args=words, prog=PROGRAM)
    from sculpt_framework.stress.cases import run_cases
    from sculpt_framework.stress.suite import chosen_cases

    cases = chosen_cases(request.group, request.only)
    if not cases:
        raise ConfigError(f"--only {request.only}: no case of {' '.join(request.group)} has that in its name.")
    results = []
    for result in run_cases(cases):
        results.append(result)
        if not request.json:
            sys.stdout.write(_line(result) + "\n")
            sys.stdout.flush()
    failed = [result.id for result in results if not result.ok]
    if request.json:
        from sculpt_framework.export.json_text import json_text

        rows = [result.as_json() for result in results]
        sys.stdout.write(json_text({"cases": rows}, indent=2) + "\n")
    else:
        sys.stdout.write(f"{len(results) - len(failed)} of {len(results)} cases within their limits\n")
    if failed:
        sys.stderr.write(f"error: {len(failed)} of {len(results)} cases not within their limits: {', '.join(failed)}\n")
        sys.exit(1)


def _line(result: "Result") -> str:
    sign = ">=" if result.at_least else "<="
    figure = f"{result.measured:.2e} {sign} {result.limit:.0e} {result.unit}"
    note = f"  {result.note}" if result.note else ""
    return f"{'ok    ' if result.ok else 'FAILED'} {result.id:44} {figure:44} {result.seconds:6.1f} s{note}"


if __name__ == "__main__":
    main()
