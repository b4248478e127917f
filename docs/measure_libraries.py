"""What libraries would cost where the project writes its own: charts, configurations as JSON, mesh files, Adam.

    pip install matplotlib pydantic cattrs msgspec        # none of them is needed otherwise
    python docs/measure_libraries.py

Told are CPU seconds to load each of them that is installed, of a chart of three lines of 50 points, of a sphere of
330 000 coloured faces as PLY, OBJ and GLB, and of steps of Adam on a million numbers by one thread; medians, with the
sizes of what is written.
"""

import io
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
import trimesh

from sculpt_framework.adam import Adam
from sculpt_framework.evaluation.charts import Axis, Series, line_chart
from sculpt_framework.export.mesh_files import write_mesh_glb, write_mesh_obj, write_mesh_ply
from sculpt_framework.parameters import ParameterGroup

REPEATS = 5
LOADED = {
    "matplotlib": "import matplotlib; matplotlib.use('svg'); import matplotlib.pyplot",
    "pydantic": "import pydantic; pydantic.TypeAdapter(int)",
    "cattrs": "import cattrs",
    "msgspec": "import msgspec",
    "pycolmap": "import pycolmap",
    "torch": "import torch",
    "torch with its Adam": "import torch; torch.optim.Adam([torch.zeros(1, requires_grad=True)])",
}
SECONDS = np.geomspace(1, 100, 50)
LINES = {f"run {index}": 0.3 / SECONDS ** (0.3 + 0.1 * index) for index in range(3)}


def main() -> None:
    empty = loading("pass")
    for name, statement in LOADED.items():
        if find_spec(name.split()[0]):
            print(f"loading {name}: {loading(statement) - empty:.2f} s", flush=True)
    charts = {"ours": our_chart} | ({"matplotlib": matplotlib_chart} if find_spec("matplotlib") else {})
    for name, chart in charts.items():
        seconds, text = timed(chart)
        print(f"a chart, {name}: {1e3 * seconds:.1f} ms, {len(text) / 1024:.0f} kB", flush=True)
    mesh_files()
    steps_of_adam()


def steps_of_adam() -> None:
    torch.set_num_threads(1)
    for name in ("ours", "torch's", "torch's, fused"):
        parameter = torch.nn.Parameter(torch.zeros(1_000_000))
        parameter.grad = torch.randn(1_000_000)
        theirs = torch.optim.Adam([parameter], lr=1e-3, fused=name.endswith("fused"))
        ours = Adam([ParameterGroup(parameters=[parameter], rate=1e-3)])
        seconds, _ = timed(lambda chosen=ours if name == "ours" else theirs: [chosen.step() for _ in range(20)])
        print(f"a step of Adam, {name}: {1e3 * seconds / 20:.2f} ms", flush=True)


def mesh_files() -> None:
    sphere = trimesh.creation.icosphere(7)
    vertices = np.asarray(sphere.vertices, dtype=np.float32).astype(float)
    faces = np.asarray(sphere.faces, dtype=np.int64)
    colors = np.random.default_rng(0).random((len(vertices), 3))
    painted = trimesh.Trimesh(vertices, faces, vertex_colors=(255 * colors).round().astype(np.uint8), process=False)
    writers = {"ply": write_mesh_ply, "obj": write_mesh_obj, "glb": write_mesh_glb}
    with TemporaryDirectory() as folder:
        for kind, write in writers.items():
            ours, theirs = Path(folder, f"ours.{kind}"), Path(folder, f"theirs.{kind}")
            for name, path, act in (
                ("ours", ours, lambda write=write, path=ours: write(path, vertices, faces, colors)),
                ("trimesh", theirs, lambda path=theirs: painted.export(path)),
            ):
                seconds, _ = timed(act)
                read = trimesh.load_mesh(path, process=False)
                moved = np.abs(np.asarray(read.vertices) - vertices).max()
                size = path.stat().st_size / 1e6
                print(f"{kind}, {name}: {1e3 * seconds:.0f} ms, {size:.1f} MB, moved by {moved:.0e}", flush=True)


def our_chart() -> str:
    series = [
        Series(name=name, points=list(zip(SECONDS.tolist(), values.tolist(), strict=True)))
        for name, values in LINES.items()
    ]
    return line_chart("Chamfer distance", series, Axis(label="training, s"), Axis(label="Chamfer", log=True))


def matplotlib_chart() -> str:
    import matplotlib  # pyright: ignore[reportMissingImports]

    matplotlib.use("svg")
    import matplotlib.pyplot as plt  # pyright: ignore[reportMissingImports]

    figure, axes = plt.subplots(figsize=(4.6, 2.9))
    for name, values in LINES.items():
        axes.plot(SECONDS, values, marker="o", markersize=3, label=name)
    axes.set(title="Chamfer distance", xlabel="training, s", ylabel="Chamfer", yscale="log")
    axes.legend()
    axes.grid()
    out = io.StringIO()
    figure.savefig(out, format="svg")
    plt.close(figure)
    return out.getvalue()


def loading(statement: str) -> float:
    """CPU seconds of a process that runs the statement."""

    def once() -> float:
        before = os.times()
        subprocess.run([sys.executable, "-c", statement], check=True)
        after = os.times()
        return after.children_user + after.children_system - before.children_user - before.children_system

    return statistics.median(once() for _ in range(REPEATS))


def timed(act: Callable[[], Any]) -> tuple[float, Any]:
    """Median CPU seconds after one call that is not counted, and what the last call gave."""
    result = act()
    seconds = []
    for _ in range(REPEATS):
        began = time.process_time()
        result = act()
        seconds.append(time.process_time() - began)
    return statistics.median(seconds), result


if __name__ == "__main__":
    main()
