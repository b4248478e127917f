"""Memory that training takes, beside what ``sculpting/memory_check.py`` says: ``python docs/measure_memory.py``.

Linux only. Prints a line for every size tried, each in a process of its own, and the factors that fit best (least
squares) how much more they take than the first one; what all have in common is there before a stage is entered.
"""

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np
import torch
from scipy.optimize import nnls

from sculpt_framework import registry
from sculpt_framework.engine.session import Session
from sculpt_framework.posed_images.training_images import prepare_image
from sculpt_framework.sculpting import memory_check
from sculpt_framework.sculpting.config import SculptingConfig, of_sculpting
from sculpt_framework.stress.small import small_scene, trainer_of

SIZES = ((0, 60, 1), (2, 100, 1), (2, 100, 3), (1, 500, 1), (3, 200, 1), (2, 800, 3))
"""Grid level, pixels along the image's side, Gaussians on a face."""


def method(level: int, count: int) -> SculptingConfig:
    config = of_sculpting(registry.load_method("gaussian-sculpting")())
    (stage,) = config.trainer.stages
    stage = replace(stage, level=level, inner_steps=1, outer_views=1)
    trainer = replace(config.trainer, stages=(stage,), fit_steps=5, polish_steps=0, warm_up_steps=0)
    config = replace(config, steps=3, holdout_every=0)
    hull = of_sculpting(registry.load_method("gaussian-sculpting-tiny")()).initializer
    binder = replace(config.binder, gaussians_per_face=count)  # pyright: ignore[reportCallIssue]
    return replace(config, binder=binder, trainer=trainer, initializer=hull, observers=(), data="memory")


def measured(level: int, pixels: int, count: int) -> tuple[memory_check.Sizes, int]:
    """What the steps of a run work on, and the peak of a process that does nothing else."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        sizes = run(level, pixels, count)
        os.write(writing, json.dumps(asdict(sizes)).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        sizes = memory_check.Sizes(**json.loads(pipe.read()))
    _, _, usage = os.wait4(child, 0)
    return sizes, usage.ru_maxrss << 10


def run(level: int, pixels: int, count: int) -> memory_check.Sizes:
    scene = small_scene(pixels=pixels, views=3)
    session = Session(scene, method(level, count))
    session.run()
    images = [prepare_image(view, scene.box, 1.0, torch.device("cpu")) for view in scene.train]
    return memory_check.sizes(trainer_of(session), max(image.camera.width * image.camera.height for image in images))


def rows() -> Iterator[tuple[memory_check.Sizes, int]]:
    for level, pixels, count in SIZES:
        sizes, peak = measured(level, pixels, count)
        sys.stdout.write(
            f"level {level}, {sizes.pixels} pixels, {sizes.cells} cells, {sizes.gaussians} Gaussians: "
            f"{peak / 2**20:.0f} MiB, a step foreseen to take {memory_check.step_bytes(sizes) / 2**20:.0f}\n"
        )
        sys.stdout.flush()
        yield sizes, peak


def main() -> int:
    # Nothing may compute in this process: threads do not survive a fork.
    torch.set_num_threads(1)
    (first, least), *found = rows()
    table = [[s.pixels - first.pixels, s.cells - first.cells, s.gaussians - first.gaussians] for s, _ in found]
    more = np.array([peak - least for _, peak in found], dtype=float)
    # Relative errors count.
    factors, _ = nnls(np.array(table) / more[:, None], np.ones(len(more)))
    sys.stdout.write("bytes for each pixel, cell, Gaussian: " + ", ".join(f"{each:.0f}" for each in factors) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
