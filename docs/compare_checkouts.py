"""Whether two checkouts of the project reconstruct the same, to the bit.

    python docs/compare_checkouts.py CHECKOUT OTHER --out OUT [--data DIR...] [--only NAME...]

Each trains the same runs, one after the other, in a process of its own: the default method, the tiny one and the
paper's, for a few steps; one that is interrupted and resumed; one that is told what another was told in its
viewer; one that is repaired in a box. Compared are meshes, Gaussians, the curves but for what a clock or the memory
says, and every tensor of the last checkpoint. What the options of an older checkout are called is said by
``--steps-option``. Exits with 1 where anything differs. Run it twice where a checkout is new: the process that compiles
kernels rounds otherwise than those that load them afterwards, which moves a curve by a millionth.

    python docs/compare_checkouts.py CHECKOUT OTHER --times 5

compares the time of a step instead, of the default method on the first scene: processes of both in turn, so many each,
on one thread; of every step the least CPU seconds, added up. Both checkouts need ``sculpt_framework.Session``.
"""

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

from safetensors.numpy import load_file

CLOCK_AND_MEMORY = ("t_train_s", "t_wall_s", "t_cpu_s", "rss_mb")
SHORT_PAPER = ("--trainer.base-cells", "24", "--trainer.stages.1.inner-steps", "20", "--trainer.fit-steps", "60")
STEPS = 26
TIMED = 24
"""Of these, the last: the first two make the start and load what is compiled."""
STEPPING = """
import json, sys, time
import sculpt_framework as sculpt
session, spent = sculpt.Session(sculpt.load(sys.argv[1]), sculpt.methods["gaussian-sculpting"]()), []
steps = iter(session)
for _ in range(int(sys.argv[2])):
    began = time.process_time()
    next(steps)
    spent.append(time.process_time() - began)
print(json.dumps(spent))
"""
COMMANDS = (
    '{"v": 1, "t_train": 0.1, "t_wall": 1.0, "outer": 2, "event": "action", "data": {"message": "", '
    '"command": {"do": "set-weight", "slot": "losses", "name": "eikonal", "weight": 0.3}}}',
    '{"v": 1, "t_train": 0.2, "t_wall": 1.2, "outer": 4, "event": "action", "data": {"message": "", '
    '"command": {"do": "add-box", "kind": "refine", "minimum": [-0.3, -0.3, -0.3], "maximum": [0.3, 0.3, 0.3]}}}',
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkouts", nargs=2, type=Path, metavar="CHECKOUT")
    parser.add_argument("--out", type=Path, help="new folder for the runs of both")
    parser.add_argument("--times", type=int, help="compare the time of a step, by so many runs of each")
    parser.add_argument("--data", nargs="+", default=["demo", "demo:dents"], help="scenes")
    parser.add_argument("--only", nargs="+", help="names of the runs to compare")
    parser.add_argument("--steps-option", nargs=2, default=["steps", "steps"], help="of either, without dashes")
    options = parser.parse_args()
    if options.times is not None:
        compare_times(options.checkouts, options.data[0], options.times)
        return 0
    if options.out is None:
        parser.error("--out is missing: a new folder for the runs of both")
    different = 0
    for data in options.data:
        for name, words in runs(options.out):
            if options.only and name not in options.only:
                continue
            folders = []
            for number, (checkout, steps) in enumerate(zip(options.checkouts, options.steps_option, strict=True)):
                folder = options.out / f"{number}" / data.replace(":", "-").strip("/").replace("/", "-") / name
                train(checkout, name, [f"--{steps}" if word == "--steps" else word for word in words], data, folder)
                folders.append(folder)
            found = list(differences(*folders))
            different += bool(found)
            sys.stdout.write(f"{data} {name}: {'the same' if not found else '; '.join(found)}\n")
            sys.stdout.flush()
    return 1 if different else 0


def compare_times(checkouts: Sequence[Path], data: str, times: int) -> None:
    found: list[list[list[float]]] = [[], []]
    single = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    both = list(zip(checkouts, found, strict=True))
    for turn in range(times):
        # In turn the one and the other first: where both were the same, the second took a hundredth longer.
        for checkout, spent in both if turn % 2 == 0 else reversed(both):
            words = [sys.executable, "-c", STEPPING, data, str(STEPS)]
            environment = {**environment_of(checkout), **single}
            done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True, encoding="utf-8")
            spent.append(json.loads(done.stdout.splitlines()[-1])[-TIMED:])
    first, other = (sum(min(each) for each in zip(*spent, strict=True)) for spent in found)
    sys.stdout.write(f"{TIMED} steps: {first:.2f} and {other:.2f} s of CPU, ratio {other / first:.3f}\n")


def runs(out: Path) -> Iterator[tuple[str, Sequence[str]]]:
    """Names, and the words of the command line beside data and output."""
    told = out / "told.jsonl"
    told.parent.mkdir(parents=True, exist_ok=True)
    told.write_text("\n".join(COMMANDS) + "\n", encoding="utf-8")
    yield "tiny", ("gaussian-sculpting-tiny",)
    yield "default", ("gaussian-sculpting", "--steps", "12")
    yield "paper", ("gaussian-sculpting-paper", "--steps", "5", *SHORT_PAPER)
    yield "steered", ("gaussian-sculpting-tiny", "--replay", str(told))
    yield "resumed", ("gaussian-sculpting", "--steps", "12")
    yield "repaired", ("gaussian-sculpting-tiny",)


def environment_of(checkout: Path) -> dict[str, str]:
    places = (checkout, checkout / "plugins", checkout / "method_configs")
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(str(place.resolve()) for place in places),
        # Else the folder this is started in comes first, and it may be a checkout.
        "PYTHONSAFEPATH": "1",
    }


def train(checkout: Path, name: str, words: Sequence[str], data: str, folder: Path) -> None:
    environment = environment_of(checkout)
    program = [sys.executable, "-m", "sculpt_framework.cli.train"]
    begin = [*program, *words, "--data", data, "--output", str(folder)]
    folder.parent.mkdir(parents=True, exist_ok=True)
    with open(folder.parent / f"{name}.log", "w", encoding="utf-8") as log:
        if name == "resumed":
            interrupted(begin, folder, environment, log)
            begin = [*program, "--resume", str(folder)]
        subprocess.run(begin, env=environment, stdout=log, stderr=log, check=True)
        if name == "repaired":
            again = [*program, "--resume", str(folder), "--output", str(folder / "repair")]
            again += ["--refine-box", "-0.4", "-0.4", "-0.4", "0.4", "0.4", "0.4"]
            subprocess.run(again, env=environment, stdout=log, stderr=log, check=True)


def interrupted(words: Sequence[str], folder: Path, environment: Mapping[str, str], log: IO[str]) -> None:
    """Ctrl-C once there has been a step."""
    process = subprocess.Popen(words, env=dict(environment), stdout=log, stderr=log)
    events = folder / "events.jsonl"
    while process.poll() is None and not (events.is_file() and '"outer_step"' in events.read_text(encoding="utf-8")):
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    process.wait()


def differences(first: Path, second: Path) -> Iterator[str]:
    """What of two runs is not the same."""
    for place in ("", "repair/"):
        if not (first / place / "mesh.ply").is_file() and not (second / place / "mesh.ply").is_file():
            if not place:
                yield "neither has a mesh"
            continue
        for name in ("mesh.ply", "gaussians.ply"):
            if (first / place / name).read_bytes() != (second / place / name).read_bytes():
                yield f"{place}{name}"
        yield from (f"{place}curve.csv: {each}" for each in curve_differences(first / place, second / place))
        states = [load_file(folder / place / "checkpoints/latest.safetensors") for folder in (first, second)]
        for key in sorted({*states[0], *states[1]}):
            one, other = (state.get(key) for state in states)
            if one is None or other is None or one.tobytes() != other.tobytes():
                yield f"{place}checkpoint: {key}"


def curve_differences(first: Path, second: Path) -> Iterator[str]:
    """Of rows that are measured at the same step for the same reason: those at clock times may be others."""
    curves = []
    for folder in (first, second):
        with open(folder / "curve.csv", encoding="ascii") as file:
            curves.append({row["outer"]: row for row in csv.DictReader(file)})
    shared = [step for step in curves[0] if step in curves[1]]
    if not shared:
        yield "no row in common"
    for step in shared:
        for column, value in curves[0][step].items():
            if column not in CLOCK_AND_MEMORY and value != curves[1][step].get(column):
                yield f"step {step} {column} {value} {curves[1][step].get(column)}"


if __name__ == "__main__":
    sys.exit(main())
