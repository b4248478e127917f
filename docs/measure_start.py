"""What a run does before its first step, part by part, in seconds.

    python docs/measure_start.py DIR [--repeats 3] [--threads N]

DIR is anything that ``sculpt-train --data`` takes. The surface that the default method starts from is made from it
several times in one process; told is the median, in wall and in CPU seconds, without the first time, which loads
kernels.
"""

import argparse
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from typing import Any

import torch

from sculpt_framework import registry
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.sculpting import initial_fit
from sculpt_framework.sculpting.config import of_sculpting
from sculpt_framework.shape_from_images import within_hull
from sculpt_plugins.initializers.photo_hull import initializer

PARTS = {
    "visual_hull": (within_hull, "distances to the silhouettes"),
    "sample": (within_hull, "volume of the visual hull"),
    "pack_views": (initializer, "smaller images"),
    "find_depths": (initializer, "depth maps"),
    "refine_depths": (initializer, "finer depth maps"),
    "carve": (initializer, "joining them"),
    "fit_field": (initial_fit, "fitting the field"),
}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("data")
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--threads", type=int, default=None)
    chosen = options.parse_args()
    if chosen.threads is not None:
        torch.set_num_threads(chosen.threads)
    config = of_sculpting(registry.load_method("gaussian-sculpting")())
    began = time.perf_counter()
    scene = config.dataset.build(chosen.data).load()
    sys.stdout.write(f"{len(scene.train)} views loaded in {time.perf_counter() - began:.2f} s\n")
    device = torch.device("cpu")
    grid = grid_over_box(scene.box.half_sides, config.trainer.base_cells)
    detail = grid.at_level(config.trainer.stages[0].level).cell
    rows: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for name, (module, _) in PARTS.items():
        setattr(module, name, timed(getattr(module, name), rows[name]))
    whole = timed(initial_fit.fit_to_views, rows["all"])
    for _ in range(chosen.repeats + 1):
        torch.manual_seed(0)
        field, generator = config.field.build(config.trainer.finest_cells, device), torch.Generator().manual_seed(0)
        whole(
            field,
            config.initializer.build(),
            config,
            scene.train,
            scene.box,
            scene.supports,
            detail,
            generator,
            device,
            lambda target: None,
        )
    sys.stdout.write(f"{'part':36} {'wall':>6} {'CPU':>6}\n")
    for name, times in rows.items():
        per_run = len(times) // (chosen.repeats + 1)
        runs = [times[i : i + per_run] for i in range(per_run, len(times), per_run)]
        wall, cpu = (statistics.median(sum(time[axis] for time in run) for run in runs) for axis in (0, 1))
        label = PARTS[name][1] if name in PARTS else name
        sys.stdout.write(f"{label:36} {wall:6.2f} {cpu:6.2f}\n")


def timed(function: Callable[..., Any], times: list[tuple[float, float]]) -> Callable[..., Any]:
    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        result = function(*arguments, **named)
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
        return result

    return call


if __name__ == "__main__":
    main()
