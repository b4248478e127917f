"""``sculpt-bench suite``: a method on a named set of scenes, beside the paper's table of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro

from sculpt_framework.cli.ablate import check_counts, split_extra
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError

PROGRAM = "sculpt-bench suite"


@dataclass(frozen=True, kw_only=True)
class SuiteRequest:
    """Run methods on a set of scenes and print the results beside the paper's table.

    Options of sculpt-train for all runs follow after --, as in: sculpt-bench suite demo -- --extractor
    marching-tetrahedra
    """

    name: Annotated[Literal["demo", "blender", "omniobject3d", "captures"], tyro.conf.Positional]
    """demo: the built-in scenes; blender: the paper's five of NeRF-Synthetic; omniobject3d: its twelve categories;
    captures: every folder of posed photographs in DIR."""
    folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Where the data of blender, omniobject3d and captures are."""
    methods: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METHOD")] = ("gaussian-sculpting",)
    """Methods to run."""
    objects: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = ()
    """Scenes, objects or categories to run instead of the suite's own."""
    references: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """blender: meshes called as the scenes are, for scenes that bring no gt_mesh.ply."""
    masks: Literal["with", "without", "both"] = "with"
    """captures: whether those that have files of masks are run with them, as if they had none, or both."""
    against: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME.ply", help_behavior_hint="")] = ()
    """captures: meshes of other programs, files of these names in the captures' folders, measured as ours are."""
    seeds: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N")] = (0,)
    """Seeds, one run for each."""
    max_time: Annotated[float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="")] = None
    """Wall seconds for each run. Default: as many steps as the method says."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """Outer steps for each run, instead of seconds."""
    own_length: Flag = False
    """Beside the runs of --max-time or --steps, run each method once more for as long as it says itself."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Where runs and tables go. Default: outputs/suite-NAME. What has been run there is not run again."""
    jobs: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Runs at a time. More than one disturb each other's clocks."""
    retry_failed: Flag = False
    """Run again what failed before; otherwise a failure is a result."""
    show: Flag = False
    """Run nothing; tables of what there is."""


def suite(words: Sequence[str]) -> None:
    """Run and print. Raises SculptError; exits as tyro does for ``--help`` and values of a wrong type."""
    own, extra = split_extra(words)
    request = tyro.cli(SuiteRequest, args=own, prog=PROGRAM)
    _check(request)

    from sculpt_framework.experiments.carry_out import carry_out
    from sculpt_framework.experiments.matrix import Budget, Setting, check_extra, config_of, cross
    from sculpt_framework.experiments.results import results_csv, told_apart
    from sculpt_framework.experiments.suites import find_suite

    check_extra(extra)
    found = find_suite(request.name, request.folder, request.objects, request.references, request.masks)
    settings = [Setting(name=method, method=method) for method in request.methods]
    for setting in settings:
        config_of(setting, found.scenes[0], extra)
    budgets: list[Budget | None] = []
    if request.max_time is not None:
        budgets.append(Budget(kind="seconds", amount=request.max_time))
    elif request.steps is not None:
        budgets.append(Budget(kind="steps", amount=float(request.steps)))
    if request.own_length or not budgets:
        budgets.append(None)
    title = f"Suite {request.name}"
    matrix = cross(title, settings, found.scenes, budgets, request.seeds, extra)
    folder = request.out or Path("outputs") / f"suite-{request.name}"
    carried_out = partial(
        carry_out,
        matrix,
        folder,
        asked=(*PROGRAM.split(), *words),
        jobs=request.jobs,
        retry_failed=request.retry_failed,
        run=not request.show,
    )
    if request.name == "captures":
        from sculpt_framework.experiments.capture_measures import check_external, measure_all
        from sculpt_framework.experiments.capture_tables import capture_page, capture_tables

        check_external(request.against, found)
        carried_out(
            lambda results: capture_tables(told_apart(results), found, request.against, folder),
            measure=partial(measure_all, matrix, found, request.against, folder),
            page=lambda results: capture_page(told_apart(results), found, request.against, folder),
        )
    else:
        from sculpt_framework.experiments.suite_page import suite_page
        from sculpt_framework.experiments.suite_tables import notes, suite_tables

        carried_out(
            lambda results: (suite_tables(told_apart(results), found), notes(found), results_csv(results, {})),
            page=lambda results: suite_page(told_apart(results), found),
        )


def _check(request: SuiteRequest) -> None:
    check_counts(request.seeds, request.jobs)
    if not request.methods or len(set(request.methods)) < len(request.methods):
        raise ConfigError(f"--methods {' '.join(request.methods)}: expected one or more, each once.")
    if request.name != "captures" and (request.against or request.masks != "with"):
        raise ConfigError("--masks and --against are for the suite captures; the scenes of others are as they are.")
    if request.max_time is not None and request.steps is not None:
        raise ConfigError("--max-time and --steps: expected one of the two.")
    if request.own_length and request.max_time is None and request.steps is None:
        raise ConfigError("--own-length is for runs beside those of --max-time or --steps; without these all are such.")
    if request.max_time is not None and not 0 < request.max_time < float("inf"):
        raise ConfigError(f"--max-time is {request.max_time}; expected seconds above 0.")
    if request.steps is not None and request.steps < 1:
        raise ConfigError(f"--steps is {request.steps}; expected 1 or more.")
