"""Several methods on one scene for the same time: error against seconds, as a table and a chart.

    python examples/5_methods_beside_each_other.py --methods gaussian-sculpting neus splatting-3d

Many scenes, seeds and tables are what ``sculpt-bench suite`` is for.
"""

from pathlib import Path

import tyro

import sculpt_framework as sculpt
from sculpt_framework.evaluation.charts import Axis, Series, line_drawing, series_colors
from sculpt_framework.evaluation.drawing_png import to_png


def main(
    data: str = "demo",
    methods: tuple[str, ...] = ("gaussian-sculpting", "neus", "splatting-3d"),
    seconds: float = 60,
    out: Path = Path("outputs/methods.png"),
) -> None:
    scene = sculpt.load(data)
    lines = []
    for name in methods:
        session = sculpt.Session(scene, sculpt.methods[name](), max_time=seconds)
        session.run()
        points = [(row["t_wall_s"], row["psnr"]) for row in session.curve if row["psnr"] is not None]
        if not points:
            raise SystemExit(f"{data} has too few views to hold one out; ten or more are needed.")
        lines.append(Series(name=name, points=points))
        print(f"{name:24} {points[-1][1]:.2f} dB after {points[-1][0]:.0f} s")
    seconds_axis, psnr_axis = Axis(label="seconds", log=True), Axis(label="dB")
    colors = series_colors(lines)
    chart = line_drawing("PSNR of held-out views", lines, seconds_axis, psnr_axis, colors=colors, legend=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(to_png(chart))
    print("saved:", out)


if __name__ == "__main__":
    tyro.cli(main)
