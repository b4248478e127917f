"""``sculpt-ablate``: what each part of the method is worth, at equal cost, beside the paper's figures."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError

PROGRAM = "sculpt-ablate"
PLAN = "--plan"
Factor = Literal["constraints", "field", "isolation", "start", "evidence"]
FACTORS: tuple[Factor, ...] = ("constraints", "field", "isolation", "start")
"""The paper's ablations."""
DEFAULT_BUDGETS = {"seconds": 120.0, "steps": 240.0}


@dataclass(frozen=True, kw_only=True)
class AblateRequest:
    """Leave parts of the method out, one at a time, and compare: the paper's Table 3 and its two further ablations.

    Options of sculpt-train for all runs follow after --, as in: sculpt-ablate --scenes demo:dents -- --field mlp
    """

    scenes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DIR|demo:NAME")] = ("demo:dents",)
    """Scenes to run on, as for sculpt-train --data."""
    seeds: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N")] = (0,)
    """Seeds, one run of each setting for each. From three on the tables have intervals."""
    method: str = "gaussian-sculpting"
    """The method that parts are left out of."""
    factors: tuple[Factor, ...] = FACTORS
    """What is varied: Table 3; neural or discrete SDF; gradient isolation; warm or cold start of the inner loop; and,
    on photographs, what the surface starts and learns from."""
    plan: Flag = False
    """Compare the method planned for each scene with everything on (docs/background/plan.md), in place of any factor.
    As many steps as the method says, unless --budget is given."""
    full: Flag = False
    """Run every combination of the factors instead of one change at a time."""
    equal: tuple[Literal["seconds", "steps"], ...] = ("seconds",)
    """What all runs are given alike: wall seconds, outer steps, or first the one and then the other."""
    budget: Annotated[
        tuple[float, ...], tyro.conf.arg(metavar="N", help_behavior_hint="(default: 120 s, 240 steps)")
    ] = ()
    """How much of it, one number for each word of --equal."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("outputs/ablation")
    """Where runs and tables go. What has been run there is not run again."""
    jobs: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Runs at a time. More than one disturb each other's clocks."""
    retry_failed: Flag = False
    """Run again what failed before; otherwise a failure is a result."""
    show: Flag = False
    """Run nothing; tables of what there is."""


def main() -> None:
    """The console script ``sculpt-ablate``."""
    exit_codes.run(lambda: ablate(sys.argv[1:]))


def ablate(words: Sequence[str]) -> None:
    """Run and print. Raises SculptError; exits as tyro does for ``--help`` and values of a wrong type."""
    own, extra = split_extra(words)
    request = tyro.cli(AblateRequest, args=own, prog=PROGRAM)
    amounts = check_request(request)

    from sculpt_framework.experiments.ablation import EVIDENCE, ablation
    from sculpt_framework.experiments.ablation_tables import ablation_tables, notes
    from sculpt_framework.experiments.carry_out import carry_out
    from sculpt_framework.experiments.matrix import Budget, check_extra, cross, matrix_scenes
    from sculpt_framework.experiments.results import results_csv

    check_extra(extra)
    scenes = matrix_scenes(request.scenes)
    if request.plan:
        _check_plan(request, amounts, extra, words)
        return
    # What is varied is the method, whatever a scene needs of it; but for what the plan itself decides.
    if EVIDENCE not in request.factors and PLAN not in (word.partition("=")[0] for word in extra):
        extra = ["--plan", "off", *extra]
    made = ablation(request.method, scenes[0], extra, factors=request.factors, full=request.full)
    budgets = [Budget(kind=kind, amount=amount) for kind, amount in amounts.items()]
    title = f"Ablation of {request.method}"
    matrix = cross(title, made.settings, scenes, budgets, request.seeds, extra)
    carry_out(
        matrix,
        request.out,
        lambda results: (
            ablation_tables(results, made, budgets),
            notes(made),
            results_csv(results, made.levels),
        ),
        asked=(PROGRAM, *words),
        jobs=request.jobs,
        retry_failed=request.retry_failed,
        run=not request.show,
    )


def _check_plan(
    request: AblateRequest, amounts: Mapping[str, float], extra: Sequence[str], words: Sequence[str]
) -> None:
    from sculpt_framework.experiments.carry_out import carry_out
    from sculpt_framework.experiments.matrix import Budget, cross, matrix_scenes
    from sculpt_framework.experiments.plan_check import LEVELS, plan_notes, plan_settings, plan_tables
    from sculpt_framework.experiments.results import results_csv

    budgets = [Budget(kind=kind, amount=amount) for kind, amount in amounts.items()] if request.budget else [None]
    title = f"The plan of {request.method}"
    settings, scenes = plan_settings(request.method), matrix_scenes(request.scenes)
    carry_out(
        cross(title, settings, scenes, budgets, request.seeds, extra),
        request.out,
        lambda results: (plan_tables(results, budgets), plan_notes(), results_csv(results, LEVELS)),
        asked=(PROGRAM, *words),
        jobs=request.jobs,
        retry_failed=request.retry_failed,
        run=not request.show,
    )


def split_extra(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The words before and after the first ``--``."""
    rest = list(words)
    if "--" not in rest:
        return rest, []
    place = rest.index("--")
    return rest[:place], rest[place + 1 :]


def check_request(request: AblateRequest) -> dict[str, float]:
    """The amount for each kind of budget. Raises ConfigError for numbers that no plan can use."""
    check_counts(request.seeds, request.jobs)
    if not request.factors or len(set(request.factors)) < len(request.factors):
        raise ConfigError(f"--factors {' '.join(request.factors)}: expected one or more, each once.")
    if not request.equal or len(set(request.equal)) < len(request.equal):
        raise ConfigError(f"--equal {' '.join(request.equal)}: expected seconds, steps or both, each once.")
    if request.budget and len(request.budget) != len(request.equal):
        raise ConfigError(
            f"--budget has {len(request.budget)} numbers for --equal {' '.join(request.equal)}; expected one for each."
        )
    amounts = request.budget or tuple(DEFAULT_BUDGETS[kind] for kind in request.equal)
    for kind, amount in zip(request.equal, amounts, strict=True):
        if not 0 < amount < float("inf") or (kind == "steps" and amount != int(amount)):
            raise ConfigError(
                f"--budget {amount:g}: expected {'whole steps' if kind == 'steps' else 'seconds'} above 0."
            )
    return dict(zip(request.equal, amounts, strict=True))


def check_counts(seeds: Sequence[int], jobs: int) -> None:
    """Raise ConfigError for seeds that are none or given twice, and for fewer than one job."""
    if not seeds or len(set(seeds)) < len(seeds) or min(seeds) < 0:
        raise ConfigError(f"--seeds {' '.join(map(str, seeds))}: expected numbers from 0 upwards, each once.")
    if jobs < 1:
        raise ConfigError(f"--jobs is {jobs}; expected 1 or more.")


if __name__ == "__main__":
    main()
