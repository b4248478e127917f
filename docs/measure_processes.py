"""What several processes bring to whole runs: seconds per view, and whether the result is as good.

    python docs/measure_processes.py DATA [--processes 2] [--steps 160] [--seeds 0] [--out DIR] [-- OPTIONS]

DATA and OPTIONS are as for sculpt-train. For each seed one process makes a run of so many outer steps. Then torchrun
starts the processes, each with as many views in a step as the one had, for as many fewer steps: as many views in all.
The colours learn from one view per process at a time. Each process has one thread (OMP_NUM_THREADS says otherwise).
Seconds per view are those of the steps, without what comes before the first and after the last.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from sculpt_framework.command_line.request import parse
from sculpt_framework.sculpting.config import of_sculpting

METHOD = "gaussian-sculpting"


@dataclass(frozen=True, kw_only=True)
class Cost:
    chamfer: float
    """Point to surface, scene units."""
    psnr: float
    per_view: float
    """Seconds of the steps by the views they render."""
    seconds: float
    """Of training, the start included."""


def main() -> None:
    words = sys.argv[1:]
    own, extra = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, [])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--steps", type=int, default=160)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--out", type=Path)
    request = parser.parse_args(own)
    with tempfile.TemporaryDirectory() as aside:
        folder = request.out or Path(aside)
        for seed in request.seeds:
            pair = [train(request, extra, count, seed, folder) for count in (1, request.processes)]
            tell(seed, pair, request.processes)


def train(request: argparse.Namespace, extra: list[str], count: int, seed: int, folder: Path) -> Cost:
    """A run of ``count`` processes; one that is in the folder already is not made again."""
    out = folder / f"seed-{seed}-processes-{count}"
    steps = max(1, request.steps // count)
    words = [METHOD, "--data", request.data, "--seed", str(seed), *extra, "--steps", str(steps)]
    views = 0
    for number, stage in enumerate(of_sculpting(parse(words)).trainer.stages):
        words += [f"--trainer.stages.{number}.outer-views", str(stage.outer_views * count)]
        words += [f"--trainer.stages.{number}.inner-steps", str(stage.inner_steps * count)]
        views = (stage.outer_views + stage.inner_steps) * count
    if not (out / "metrics.json").is_file():
        launcher = ["torch.distributed.run", "--standalone", "--nproc-per-node", str(count), "-m"] if count > 1 else []
        command = [sys.executable, "-m", *launcher, "sculpt_framework.cli.train", *words, "--output", str(out)]
        threads = os.environ.get("OMP_NUM_THREADS", "1")
        subprocess.run(
            command, env={**os.environ, "OMP_NUM_THREADS": threads, "NUMBA_NUM_THREADS": threads}, check=True
        )
    final = json.loads((out / "metrics.json").read_text(encoding="utf-8"))["final"]
    with (out / "events.jsonl").open(encoding="utf-8") as lines:
        events = [json.loads(line) for line in lines]
    rows = [each for each in events if each["event"] == "evaluation"]
    # The first row of a stage comes after the colours' warming up and before the surface first moves.
    first = next(row for row in rows if row["data"]["reason"] == "stage")
    last = next(row for row in rows if row["data"]["reason"] == "end of optimisation")
    passed = last["t_train"] - first["t_train"]
    with (out / "curve.csv").open(encoding="utf-8") as lines:
        seconds = float(list(csv.DictReader(lines))[-1]["t_train_s"])
    return Cost(chamfer=final["chamfer_ps"], psnr=final["psnr"], per_view=passed / (views * steps), seconds=seconds)


def tell(seed: int, pair: list[Cost], processes: int) -> None:
    one, several = pair
    for count, cost in ((1, one), (processes, several)):
        sys.stdout.write(
            f"seed {seed}, {count} process{'es' if count > 1 else ''}: Chamfer {100 * cost.chamfer:.4f}e-2, "
            f"{cost.psnr:.2f} dB, {1000 * cost.per_view:.1f} ms per view, {cost.seconds:.0f} s of training\n"
        )
    sys.stdout.write(
        f"seed {seed}: per view {several.per_view / one.per_view:.2f} times, whole training "
        f"{several.seconds / one.seconds:.2f} times, Chamfer {several.chamfer / one.chamfer:.3f} times\n"
    )
    sys.stdout.flush()


if __name__ == "__main__":
    main()
