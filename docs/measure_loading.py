"""What a process pays before its first CPU rendering, once the kernels have been compiled.

    python docs/measure_loading.py [--processes N]

Each process imports torch, then what the CPU rasterizer needs, and renders and differentiates one Gaussian. Told are
medians over the processes in seconds of wall time: torch for comparison, then numba with what it loads for any kernel,
and the rasterizer's own kernels. A first process, not counted, compiles them if nobody has yet.
"""

import argparse
import json
import statistics
import subprocess
import sys

SCRIPT = """
import json, time
times = [time.perf_counter()]
def part():
    times.append(time.perf_counter())
import torch
part()
from sculpt_framework.cpu_kernels import load_numba
load_numba()
part()
from sculpt_framework.types import Camera
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
rasterizer = NumbaRasterizerConfig().build(torch.device("cpu"))
pose = torch.eye(4)
pose[2, 3] = 2.0
camera = Camera(world_to_camera=pose, fx=32.0, fy=32.0, cx=16.0, cy=16.0, width=32, height=32)
output = rasterizer.rasterize(
    torch.zeros(1, 3, requires_grad=True), torch.full((1, 3), 0.2), torch.eye(3)[None], torch.full((1,), 0.9),
    torch.ones(1, 3), camera, torch.zeros(3), low_pass_px2=0.3, alpha_max=0.999,
)
output.features.square().sum().backward()
part()
print(json.dumps([after - before for before, after in zip(times, times[1:])]))
"""


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--processes", type=int, default=15)
    processes = options.parse_args().processes
    once()
    rows = [once() for _ in range(processes)]
    torch, numba, kernels = (statistics.median(column) for column in zip(*rows, strict=True))
    both = sorted(row[1] + row[2] for row in rows)
    sys.stdout.write(f"torch {torch:.2f} s; numba {numba:.2f} s and kernels {kernels:.2f} s, ")
    sys.stdout.write(f"together {statistics.median(both):.2f} s ({both[0]:.2f} to {both[-1]:.2f})\n")


def once() -> list[float]:
    done = subprocess.run([sys.executable, "-c", SCRIPT], check=True, capture_output=True, text=True, encoding="utf-8")
    return json.loads(done.stdout)


if __name__ == "__main__":
    main()
