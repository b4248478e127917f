"""What the parts of an outer step take in one process and in several, and whether the cost model foretells the latter.

    python docs/measure_scaling.py DATA [--processes 2] [--steps 12] [--method METHOD] [--json FILE] [-- OPTIONS]

DATA and OPTIONS are as for sculpt-train. Four runs of a few steps, each process with one thread (OMP_NUM_THREADS says
otherwise): one process with a view per inner step, one process with as many as there will be processes, the processes
with the same views, and the processes with as many views each as the one had. The model is made of the second and
held against the third. The tables of docs/guide/scaling.md are its output.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

WARM_UP_STEPS = 3
"""Outer steps that are not counted: compiling, and first touches of memory."""
VIEW_PARTS = ("render", "loss", "backward of views")
"""Shared among processes; everything else each process does for itself."""
PARTS = (
    *VIEW_PARTS,
    "colours and places",
    "constraints",
    "field",
    "extraction",
    "geometry terms",
    "backward of the surface",
    "update",
    "sum over processes",
    "agreement",
    "rest",
)
Run = dict[str, Any]


class Stopwatch:
    """Seconds by part, while it is on; of calls within calls the inner ones have their own."""

    def __init__(self, wait: Callable[[], None]) -> None:
        """``wait`` returns when the device has done what it was told."""
        self.on = False
        self._wait = wait
        self.seconds: dict[str, float] = dict.fromkeys(PARTS, 0.0)
        self.calls: dict[str, int] = dict.fromkeys(PARTS, 0)
        self._since = 0.0
        self._stack: list[str] = []

    @contextmanager
    def of(self, part: str) -> Iterator[None]:
        self._note()
        self._stack.append(part)
        try:
            yield
        finally:
            self._note()
            self._stack.pop()
            if self.on:
                self.calls[part] += 1

    def _note(self) -> None:
        if self.on:
            self._wait()
        now = time.perf_counter()
        if self.on and self._stack:
            self.seconds[self._stack[-1]] += now - self._since
        self._since = now

    def wrap(self, owner: Any, name: str, part: str) -> None:
        whole = getattr(owner, name)

        def timed(*words: Any, **named: Any) -> Any:
            with self.of(part):
                return whole(*words, **named)

        setattr(owner, name, timed)


def main() -> None:
    words = sys.argv[1:]
    own, extra = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, [])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data")
    parser.add_argument("--method", default="gaussian-sculpting")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--batch", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--times", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help=argparse.SUPPRESS)
    request = parser.parse_args(own)
    if request.out is not None:
        measure(request, extra)
        return
    count = request.processes
    with tempfile.TemporaryDirectory() as folder:
        kinds = ((1, 1, 1), (1, count, 1), (count, count, 1), (count, count, count))
        runs = [start(request, extra, *kind, Path(folder) / "-".join(map(str, kind))) for kind in kinds]
    foretold = foretell(runs[1], processes=count, per_sum=runs[2]["seconds_per_sum"])
    if request.json is not None:
        request.json.write_text(json.dumps({"runs": runs, "foretold": foretold}, indent=1), encoding="utf-8")
    sys.stdout.write(report(runs, foretold))


def start(request: argparse.Namespace, extra: list[str], count: int, batch: int, times: int, out: Path) -> Run:
    """What the first of so many processes measured, with ``times`` the method's views in each step."""
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(count)] if count > 1 else []
    own = [request.data, "--method", request.method, "--steps", str(request.steps), "--batch", str(batch)]
    own += ["--times", str(times)]
    command = [sys.executable, *launcher, __file__, *own, "--out", str(out), "--", *extra]
    threads = os.environ.get("OMP_NUM_THREADS", "1")
    environment = {**os.environ, "OMP_NUM_THREADS": threads, "NUMBA_NUM_THREADS": threads}
    subprocess.run(command, env=environment, check=True)
    return json.loads(out.read_text(encoding="utf-8"))


def measure(request: argparse.Namespace, extra: list[str]) -> None:
    """The few steps, in this process, beside others if torchrun has started them."""
    import torch

    from sculpt_framework.command_line.request import parse
    from sculpt_framework.device import pick_device
    from sculpt_framework.engine.session import Session
    from sculpt_framework.parallel.processes import gather
    from sculpt_framework.sculpting.config import of_sculpting

    config = of_sculpting(parse([request.method, "--data", request.data, *extra]))
    steps = WARM_UP_STEPS + request.steps
    stages = tuple(
        replace(each, inner_steps=each.inner_steps * request.times, outer_views=each.outer_views * request.times)
        for each in config.trainer.stages
    )
    trainer = replace(config.trainer, polish_steps=0, inner_batch=request.batch, stages=stages)
    config = replace(config, steps=steps, observers=(), trainer=trainer)
    processes = gather(os.environ, pick_device(config.device))
    scene = processes.in_turn(lambda: config.dataset.build(config.data).load())
    session = Session(scene, config, processes=processes)
    device = pick_device(config.device)
    on_gpu = device.type == "cuda"
    watch = Stopwatch(torch.cuda.synchronize if on_gpu else lambda: None)
    notes = {"bytes": 0, "sums": 0, "steps": 0, "seconds": 0.0}
    watch_parts(watch, session, notes)
    session.run()
    # The session has let go of the others; what is left to do is done with them.
    per_sum = seconds_per_sum(processes, notes["bytes"] // max(1, notes["sums"]), device)
    if processes.leads:
        stage = config.trainer.stages[-1]
        told = {
            "processes": processes.count,
            "batch": request.batch,
            "inner_views": stage.inner_steps,
            "outer_views": stage.outer_views,
            "seconds": {part: value / notes["steps"] for part, value in watch.seconds.items()},
            "step": notes["seconds"] / notes["steps"],
            "bytes": notes["bytes"] / notes["steps"],
            "sums": notes["sums"] / notes["steps"],
            "seconds_per_sum": per_sum,
        }
        request.out.write_text(json.dumps(told), encoding="utf-8")
    processes.close()


def watch_parts(watch: Stopwatch, session: Any, notes: dict[str, Any]) -> None:
    """Have the parts of the session's outer steps timed."""
    import torch

    from sculpt_framework.keyed import KeyedTable

    trainer = session.reconstructor.trainer
    for owner, name, part in (
        (trainer, "_render", "render"),
        (trainer, "extract", "extraction"),
        (trainer, "signed_distance", "field"),
        (trainer.scene, "bind", "colours and places"),
        (trainer.scene, "harmonics", "colours and places"),
        (trainer.scene, "follow", "colours and places"),
        (trainer.scene, "step", "update"),
        (trainer.optimizer, "step", "update"),
        (KeyedTable, "step", "update"),
        (trainer.processes, "first", "agreement"),
        (trainer.processes, "require_same", "agreement"),
        (torch.Tensor, "backward", "backward of views"),
    ):
        watch.wrap(owner, name, part)
    terms = trainer.objectives
    for kind in {type(each.term) for each in (*terms.images, *terms.silhouettes)}:
        watch.wrap(kind, "__call__", "loss")
    for kind in {type(each.term) for each in terms.geometry}:
        watch.wrap(kind, "__call__", "geometry terms")
    for kind in {type(each.term) for each in terms.constraints}:
        watch.wrap(kind, "__call__", "constraints")
    walk, add, inner_loop = torch.autograd.backward, trainer.processes.reduce, trainer.inner_loop
    behind = ["backward of the surface"]

    def walk_on(tensors: Any, *words: Any, **named: Any) -> None:
        if not isinstance(tensors, list):  # a view's, which is timed by the tensor's own method
            return walk(tensors, *words, **named)
        with watch.of(behind[-1]):
            return walk(tensors, *words, **named)

    def inside(*words: Any, **named: Any) -> Any:
        behind.append("colours and places")
        try:
            return inner_loop(*words, **named)
        finally:
            behind.pop()

    def reduce(parameters: Any, values: Any) -> Any:
        if watch.on:
            notes["bytes"] += 4 * sum(parameter.numel() for parameter in parameters)
            notes["sums"] += 1
        with watch.of("sum over processes"):
            return add(parameters, values)

    torch.autograd.backward, trainer.processes.reduce, trainer.inner_loop = walk_on, reduce, inside
    watch_steps(watch, trainer, notes)


def watch_steps(watch: Stopwatch, trainer: Any, notes: dict[str, Any]) -> None:
    settle: Callable[..., Any] = trainer.settle
    update: Callable[..., Any] = trainer.update
    taken = [0]

    def timed(half: Callable[..., Any], words: Any) -> Any:
        watch.on = taken[0] > WARM_UP_STEPS
        began = time.perf_counter()
        with watch.of("rest"):
            done = half(*words)
        if watch.on:
            notes["seconds"] += time.perf_counter() - began
        watch.on = False
        return done

    def first_half(*words: Any) -> Any:
        taken[0] += 1
        return timed(settle, words)

    def second_half(*words: Any) -> Any:
        notes["steps"] += taken[0] > WARM_UP_STEPS
        return timed(update, words)

    trainer.settle, trainer.update = first_half, second_half


def seconds_per_sum(processes: Any, size: int, device: Any) -> float:
    """Median seconds to add up so many bytes over the processes, with nothing else to do."""
    import torch

    values = torch.zeros(max(1, size // 4), device=device)
    took = []
    for _ in range(15):
        values.grad = torch.ones_like(values)
        began = time.perf_counter()
        processes.reduce([values], {})
        if device.type == "cuda":
            torch.cuda.synchronize()
        took.append(time.perf_counter() - began)
    return sorted(took)[len(took) // 2]


def foretell(batched: Run, *, processes: int, per_sum: float) -> dict[str, float]:
    """Seconds of the parts of an outer step of so many processes, from one process with the same batches."""
    inner, outer = batched["inner_views"], batched["outer_views"]
    steps = -(-inner // processes)
    share = (steps + -(-outer // processes)) / (inner + outer)
    out = dict(batched["seconds"])
    for part in VIEW_PARTS:
        out[part] *= share
    out["sum over processes"] = (steps + 1) * per_sum
    return out


def report(runs: list[Run], foretold: dict[str, float]) -> str:
    """The parts side by side, and the verdict."""
    one, batched, several, full = runs
    several_views, many = f"1, {batched['batch']} views a step", f"{several['processes']} processes"
    times = full["outer_views"] // one["outer_views"]
    heads = ("part, ms per outer step", "1 process", several_views, many, "foretold", f"{many}, {times} x the views")
    lines = [f"| {' | '.join(heads)} |", "|---|---|---|---|---|---|"]
    seconds = [run["seconds"] for run in runs]
    seconds.insert(3, foretold)
    for part in PARTS:
        lines.append(f"| {part} | {' | '.join(f'{1e3 * of[part]:.1f}' for of in seconds)} |")
    totals = [sum(of.values()) for of in seconds]
    lines.append(f"| **step** | {' | '.join(f'**{1e3 * value:.1f}**' for value in totals)} |")
    told, views = totals[3] / several["step"], full["step"] / times / one["step"]
    lines += [
        "",
        f"Wall time per view, the same views in a step: {several['step'] / one['step']:.2f} x that of one process; the "
        f"same views for each process: {views:.2f} x. Foretold / measured: {told:.2f}.",
        f"Added up per step: {several['bytes'] / 1e6:.2f} MB in {several['sums']:.0f} sums; "
        f"{1e3 * several['seconds_per_sum']:.2f} ms for one of the mean size with nothing else to do.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
