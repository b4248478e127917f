"""What an outer step takes on the band, and on a uniform grid that asks the field at every corner, as FlexiCubes does.

    python docs/measure_uniform.py DATA [DATA ...] [--steps 12] [-- OPTIONS]

DATA and OPTIONS are as for sculpt-train. In one run of the default method, steps take turns: in every other one the
field is evaluated, with gradient, at all corners of the stage's grid, the cells with surface are found among all cells,
and the extraction reads its values off that table. Both kinds of step make the same surface and the same update, so the
accuracy is the same; what differs is what they take. Told are medians in milliseconds.
"""

import argparse
import statistics
import sys
import time
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.cli.train import parse
from sculpt_framework.engine.pipeline import Pipeline
from sculpt_framework.extractors import Extraction, SdfFunction
from sculpt_framework.geometry.grid import Grid, pack

WARM_UP_STEPS = 4
"""Outer steps that are not counted: compiling, and first touches of memory."""


class Uniform:
    """The signed distance at all corners of a grid, asked for once and read from then on."""

    def __init__(self, grid: Grid, sdf: SdfFunction):
        self._grid = grid
        self._counts = tuple(n + 1 for n in grid.shape)
        ijk = torch.cartesian_prod(*(torch.arange(n) for n in self._counts))
        self._values = sdf(grid.corner_positions(ijk, torch.get_default_dtype()))

    def __call__(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """The value at points, all of them corners."""
        origin = torch.tensor(self._grid.origin, dtype=points.dtype)
        i, j, k = ((points - origin) / self._grid.cell).round().long().unbind(1)
        return self._values.index_select(0, (i * self._counts[1] + j) * self._counts[2] + k)

    def cells(self) -> Int64[Tensor, " c"]:
        """Keys of the cells whose corners differ in sign, ascending."""
        inside = self._values.detach().reshape(self._counts) < 0
        for axis, count in enumerate(self._grid.shape):
            # Eightfold sums by pairs along each axis in turn: 0 and 8 are cells without surface.
            low, high = inside.narrow(axis, 0, count), inside.narrow(axis, 1, count)
            inside = low.to(torch.uint8) + high.to(torch.uint8)
        return pack(self._grid.level, ((inside > 0) & (inside < 8)).nonzero())


def main() -> None:
    words = sys.argv[1:]
    own, extra = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, [])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="+")
    parser.add_argument("--steps", type=int, default=12, help="of each kind")
    request = parser.parse_args(own)
    sys.stdout.write("| scene | cells | faces | step, uniform | step, band | ratio | extraction, uniform | band |\n")
    sys.stdout.write("|---|---|---|---|---|---|---|---|\n")
    for data in request.data:
        sys.stdout.write(measure(data, request.steps, extra) + "\n")
        sys.stdout.flush()


def measure(data: str, steps: int, extra: list[str]) -> str:
    """A row of the table."""
    config = parse(["gaussian-sculpting", "--data", data, *extra])
    trainer = replace(config.trainer, outer_steps=WARM_UP_STEPS + 2 * steps, polish_steps=0)
    config = replace(config, observers=(), trainer=trainer)
    pipeline = Pipeline(config, scene=config.dataset.build(config.data).load())
    seconds = take_turns(pipeline.parts.trainer)
    pipeline.train()
    grid, surface = pipeline.parts.trainer.extractor.grid, pipeline.parts.trainer.extraction
    assert surface is not None  # noqa: S101
    # The run settles once more at its end, without an update: no step, and beyond these.
    counted = slice(WARM_UP_STEPS // 2, WARM_UP_STEPS // 2 + steps)
    ms = {key: 1e3 * statistics.median(taken[counted]) for key, taken in seconds.items()}
    step, extraction = [ms["step", uniform] for uniform in (True, False)], [ms["extraction", u] for u in (True, False)]
    return (
        f"| {data} | {max(grid.shape)} | {len(surface.surface.faces)} | {step[0]:.0f} | {step[1]:.0f} | "
        f"{step[1] / step[0]:.2f} | {extraction[0]:.0f} | {extraction[1]:.0f} |"
    )


def take_turns(trainer: Any) -> dict[tuple[str, bool], list[float]]:
    """Have every other step of the trainer work on a uniform grid. What steps and extractions take, for each kind."""
    extract, settle, update, band = trainer.extract, trainer.settle, trainer.update, trainer.signed_distance
    seconds: dict[tuple[str, bool], list[float]] = {(p, u): [] for p in ("step", "extraction") for u in (True, False)}
    turn = [False]

    def extracted() -> Extraction:
        began = time.perf_counter()
        if turn[0]:
            trainer.signed_distance = uniform = Uniform(trainer.extractor.grid, band)
            trainer.seeds = uniform.cells()
        try:
            return extract()
        finally:
            trainer.signed_distance = band
            seconds["extraction", turn[0]].append(time.perf_counter() - began)

    def settled(*words: Any) -> Any:
        turn[0] = not turn[0]
        began = time.perf_counter()
        out = settle(*words)
        seconds["step", turn[0]].append(time.perf_counter() - began)
        return out

    def updated(*words: Any) -> Any:
        began = time.perf_counter()
        out = update(*words)
        seconds["step", turn[0]][-1] += time.perf_counter() - began
        return out

    trainer.extract, trainer.settle, trainer.update = extracted, settled, updated
    return seconds


if __name__ == "__main__":
    main()
