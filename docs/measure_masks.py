"""How well objects are found in photographs without masks, against masks that are there.

    python docs/measure_masks.py SCENE ...

Reads each scene with its files of masks ignored, and compares what is found with them: intersection over union, of all
train images.
"""

import sys
import time
from dataclasses import replace
from typing import cast

import numpy as np

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.errors import DataError


def main() -> None:
    print(f"{'scene':20} {'images':>6} {'IoU':>6} {'worst':>6} {'seconds':>7}", flush=True)
    for folder in sys.argv[1:]:
        usual = cast(DatasetConfig, registry.default("dataset", "auto"))
        given = {view.name: view.alpha for view in usual.build(folder).load().train}
        started = time.monotonic()
        try:
            found = replace(usual, **{"masks": "ignored"}).build(folder).load()
        except DataError as error:
            print(f"{folder}: {error}", flush=True)
            continue
        seconds = time.monotonic() - started
        alike = []
        for view in found.train:
            truth, mask = given[view.name], view.alpha
            if truth is not None and mask is not None:
                both, either = (truth > 0.5) & (mask > 0.5), (truth > 0.5) | (mask > 0.5)
                alike.append(float(both.sum()) / max(1, int(either.sum())))
        name = folder.rstrip("/").rsplit("/", 1)[-1]
        print(f"{name:20} {len(alike):6} {np.mean(alike):6.3f} {min(alike):6.3f} {seconds:7.1f}", flush=True)
        for note in found.notes:
            print(f"    {note}", flush=True)


if __name__ == "__main__":
    main()
