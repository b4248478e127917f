"""``sculpt-report``: runs beside each other, as work-precision diagrams and tables."""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.errors import ConfigError

Measure = Literal[
    "auto", "chamfer", "fscore", "normal-consistency", "psnr", "ssim", "iou", "under10-pct", "residual-px"
]


@dataclass(frozen=True, kw_only=True)
class ReportRequest:
    """Overlay runs: error over time, time to reach an error, medians over seeds, failures, wins."""

    runs: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[RUN ...]", help_behavior_hint="")
    ] = ()
    """Run directories, or folders with runs in them; LABEL=RUN calls what is compared LABEL."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Where report.html, tables (CSV, Markdown, LaTeX) and diagrams (SVG, PNG) go."""
    mesh: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="NAME[@SCENE]=FILE[:SECONDS]", help_behavior_hint=""),
    ] = ()
    """A mesh made elsewhere, in the scene's frame and units, and how long that took. May be given many times."""
    reference: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="[SCENE=]FILE", help_behavior_hint="")
    ] = ()
    """What meshes made elsewhere are measured against. Default: what the scene's runs were measured against."""
    measure: Measure = "auto"
    """What is compared; auto: the Chamfer distance where it is known, else PSNR on held-out views."""
    clock: Literal["train", "wall", "cpu"] = "train"
    """Seconds of training alone, since the start of the process, or CPU seconds of all threads."""
    target: Annotated[float | None, tyro.conf.arg(metavar="VALUE", help_behavior_hint="")] = None
    """Tell the time to reach this value. Default: per scene the best that half of the runs of every method reach."""
    samples: Annotated[int, tyro.conf.arg(metavar="N")] = 200_000
    """Points on each surface when a mesh made elsewhere is measured."""
    title: str = "Runs compared"
    """Heading of the page."""


def main() -> None:
    """The console script ``sculpt-report``."""
    exit_codes.run(lambda: report(sys.argv[1:]))


def report(words: Sequence[str]) -> None:
    """Compare, write, and say where. Raises SculptError; exits as tyro does for ``--help`` and wrong values."""
    request = tyro.cli(ReportRequest, args=words, prog="sculpt-report")
    if not request.runs and not request.mesh:
        raise ConfigError("nothing to compare: give run directories, or folders with runs in them.")
    if request.samples < 1:
        raise ConfigError(f"--samples is {request.samples}; expected 1 or more.")
    if request.target is not None and not math.isfinite(request.target):
        raise ConfigError(f"--target is {request.target}; expected a finite number.")
    from sculpt_framework.comparison.external import measure_meshes, parse_mesh, parse_references
    from sculpt_framework.comparison.labels import read_runs
    from sculpt_framework.comparison.pages import compare, write_comparison
    from sculpt_framework.comparison.runs import Measure as RunMeasure
    from sculpt_framework.comparison.tables import to_markdown
    from sculpt_framework.comparison.wording import MEASURES

    meshes, references = [parse_mesh(word) for word in request.mesh], parse_references(request.reference)
    runs = read_runs(request.runs)
    records = (*runs, *measure_meshes(meshes, runs, references, samples=request.samples))
    measures: dict[str, RunMeasure] = {name.replace("_", "-"): name for name in MEASURES}
    comparison = compare(records, measure=measures.get(request.measure), clock=request.clock, target=request.target)
    paths = write_comparison(comparison, request.out, request.title)
    sys.stdout.write(to_markdown(comparison.results) + "\n")
    sys.stdout.write("".join(f"note: {line}\n" for line in comparison.caveats))
    sys.stdout.write("".join(f"{path}\n" for path in paths))
