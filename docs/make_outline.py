"""The table and picture of docs/background/splat-surface.md: ``python docs/make_outline.py``, some minutes on one core.

Offsets of the outline of freshly bound Gaussians from that of their mesh, of the default method, over shapes, grids,
images and Gaussians per face; in the picture also with ``--binder.no-fit-outline``, where Gaussians lie on their faces.
"""

import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from sculpt_framework.evaluation.charts import Axis, Series, line_drawing, series_colors, sheet
from sculpt_framework.evaluation.drawing import Drawing
from sculpt_framework.evaluation.drawing_png import to_png
from sculpt_framework.evaluation.splat_outline import OutlineError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.testing.splat_surface import (
    OUTLINE_SHAPES,
    outline_cameras,
    splat_surface_offsets,
    surface_on_grid,
)
from sculpt_methods.sculpting import gaussian_sculpting
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig

PAGE = Path(__file__).parent / "background" / "splat-surface.md"
PICTURE = Path(__file__).parent / "pictures" / "splat-surface.png"
GRIDS, IMAGES, PER_FACE, VIEWS = (32, 64, 128), (100, 200, 400), (1, 3, 6), 4
MEAN_BAR, P95_BAR = 0.1, 0.3


@dataclass(frozen=True, kw_only=True)
class Row:
    shape: str
    cells: int
    pixels: int
    per_face: int
    fitted: bool
    error: OutlineError

    @property
    def cell_px(self) -> float:
        """Width of a grid cell in pixels, at the object's centre."""
        camera = outline_cameras(self.pixels, 1)[0]
        return 2.0 / self.cells * camera.fx / float(camera.world_to_camera[:3, 3].norm())


def measure() -> Iterator[Row]:
    method = gaussian_sculpting()
    rasterizer = method.rasterizer.build(torch.device("cpu"))
    for shape, sdf in OUTLINE_SHAPES.items():
        for cells in GRIDS:
            surface = surface_on_grid(method.extractor, sdf, cells)
            for pixels in IMAGES:
                cameras = outline_cameras(pixels, VIEWS)
                for per_face in PER_FACE:
                    for fitted in (True, False):
                        binder = FaceBarycentricConfig(gaussians_per_face=per_face, fit_outline=fitted)
                        offsets = splat_surface_offsets(
                            surface, binder, rasterizer, cameras, low_pass_px2=method.trainer.low_pass_px2
                        )
                        error = OutlineError.of(offsets)
                        yield Row(
                            shape=shape, cells=cells, pixels=pixels, per_face=per_face, fitted=fitted, error=error
                        )


def table(rows: Sequence[Row]) -> str:
    """Mean and 95th percentile per case; what misses a bar is bold."""
    cases = [(cells, pixels) for cells in GRIDS for pixels in IMAGES]
    widths = {(row.cells, row.pixels): row.cell_px for row in rows}
    lines = [
        "| shape, K | " + " | ".join(f"{cells}, {pixels}" for cells, pixels in cases) + " |",
        "|---|" + "---|" * len(cases),
        "| *cell, px* | " + " | ".join(f"*{widths[case]:.1f}*" for case in cases) + " |",
    ]
    errors = {(row.shape, row.per_face, row.cells, row.pixels): row.error for row in rows if row.fitted}
    for shape in OUTLINE_SHAPES:
        for per_face in PER_FACE:
            found = [errors[shape, per_face, *case] for case in cases]
            lines.append(f"| {shape}, {per_face} | " + " | ".join(entry(error) for error in found) + " |")
    return "\n".join(lines) + "\n"


def entry(error: OutlineError) -> str:
    text = f"{error.mean:+.2f} / {error.p95:.2f}"
    return text if abs(error.mean) <= MEAN_BAR and error.p95 <= P95_BAR else f"**{text}**"


def picture(rows: Sequence[Row]) -> Drawing:
    """Both errors over the width of a cell, one panel each for fitted and other Gaussians."""
    x = Axis(label="width of a grid cell, pixels", log=True)
    bars = {"mean": (MEAN_BAR, -MEAN_BAR), "p95": (P95_BAR,)}
    labels = {"mean": "mean signed offset, pixels", "p95": "95 % of offsets are below, pixels"}
    panels, colors = [], {}
    for quantity, label in labels.items():
        for fitted in (True, False):
            chosen = [row for row in rows if row.fitted == fitted]
            series = [
                Series(
                    name=shape,
                    points=[(row.cell_px, getattr(row.error, quantity)) for row in chosen if row.shape == shape],
                    style="mark",
                )
                for shape in OUTLINE_SHAPES
            ]
            series += [Series(name="bar", points=[(1.0, bar)], style="level") for bar in bars[quantity]]
            colors = series_colors(series)
            title = "Set in and trimmed (default)" if fitted else "On their faces (paper)"
            panels.append(line_drawing(title, series, x, Axis(label=label), colors=colors, legend=False))
    return sheet("Outline of the Gaussians against that of the mesh", panels, colors, columns=2)


def main() -> int:
    torch.set_num_threads(1)
    rows = []
    for row in measure():
        rows.append(row)
        where = f"{row.shape:7} grid {row.cells:3} image {row.pixels} K {row.per_face} "
        sys.stdout.write(f"{where} {'fitted' if row.fitted else 'off   '} {entry(row.error)}\n")
        sys.stdout.flush()
    new = re.sub(
        r"(<!-- outline -->\n).*?(<!-- end -->)",
        lambda match: f"{match[1]}{table(rows)}{match[2]}",
        PAGE.read_text(encoding="utf-8"),
        flags=re.S,
    )
    write_atomically(PAGE, new.encode())
    write_atomically(PICTURE, to_png(picture(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
