"""What an outer step takes on the band, and on uniform grids that keep everything at every corner and cell.

    python docs/measure_uniform.py DATA [DATA ...] [--grids cube box band] [--coarser CELLS ...] [-- OPTIONS]

DATA and OPTIONS are as for sculpt-train. Each scene is reconstructed by the default method, with the plan that
sculpt-train makes for it, once per kind of grid, all with cells of the same size:

    cube   the field is evaluated, with gradient, at every corner of a cube as long as the longest side of the object's
           box, and every cell has FlexiCubes' weights, which Adam moves: as in FlexiCubes' own code
    box    the same on the object's box
    band   the method as it is: field and weights where the surface is

From the field's values on the ways are one: the cells that change sign are extracted as they always are. So it is the
price of keeping a volume that is measured, and not how well an extraction is programmed. Told are the median of the
outer steps, without the fit before them, its share of the first cube's, and the result's error. ``--coarser`` repeats
band and cube with fewer, larger cells (``--trainer.base-cells``), for what as small an error takes at the least.
"""

import argparse
import itertools
import math
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.command_line.request import parse
from sculpt_framework.device import pick_device
from sculpt_framework.engine.session import Session
from sculpt_framework.events import Event
from sculpt_framework.geometry.band import Band
from sculpt_framework.geometry.grid import Grid, pack, unpack_ijk
from sculpt_framework.geometry.octree_band import OctreeBand
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.plan.make import plan_scene
from sculpt_framework.sculpting.config import PlanConfig, of_sculpting
from sculpt_framework.stress.small import trainer_of
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.flexicubes.extractor import FlexiCubes

WARM_UP_STEPS = 4
"""Outer steps that are not counted: colours first, compiling, first touches of memory."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Of one reconstruction."""

    milliseconds: float
    """Median of the outer steps."""
    cells: int
    """Along the longest side of the object's box, round which the grid has some more."""
    corners: int
    """That have values: of the last surface's band, or of the grid."""
    faces: int
    chamfer: float | None
    """Scene units; None without a reference."""


class UniformFlexiCubes(FlexiCubes):
    """FlexiCubes with a value at every corner and weights in every cell of a grid, cells of one size."""

    def __init__(self, config: FlexiCubesConfig, grid: Grid, device: torch.device, *, cube: bool):
        super().__init__(config, grid, device, torch.get_default_dtype())
        side = max(grid.shape)
        self._shape = (side, side, side) if cube else grid.shape
        cells = _all_places(self._shape)
        rows = {name: torch.zeros(len(cells), size, device=device) for name, size in self._weight_sizes.items()}
        self._tables["cells"].rekey(pack(grid.level, cells), rows)

    @property
    def corner_count(self) -> int:
        return math.prod(n + 1 for n in self._shape)

    def _follow(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> Band | OctreeBand:
        nx, ny, nz = self._shape
        corners = _all_places((nx + 1, ny + 1, nz + 1))
        values = sdf(self.grid.corner_positions(corners, torch.get_default_dtype()))

        def read(points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
            origin = torch.tensor(self.grid.origin, dtype=points.dtype)
            i, j, k = ((points - origin) / self.grid.cell).round().long().unbind(1)
            return values.index_select(0, (i * (ny + 1) + j) * (nz + 1) + k)

        return super()._follow(read, self._changing(values.detach()))

    def _changing(self, values: Float[Tensor, " n"]) -> Int64[Tensor, " c"]:
        """Keys of the cells of the object's box whose corners differ in sign, found among all cells."""
        inside = (values < 0).reshape([n + 1 for n in self._shape]).to(torch.uint8)
        for axis, count in enumerate(self._shape):
            # Eightfold sums by pairs along each axis in turn: 0 and 8 are cells without surface.
            inside = inside.narrow(axis, 0, count) + inside.narrow(axis, 1, count)
        cells = ((inside > 0) & (inside < 8)).nonzero()
        # What the field says beyond the object's box, of which it has learned nothing, is no surface.
        return pack(self.grid.level, cells[(cells < torch.tensor(self.grid.shape)).all(dim=1)])

    def _cell_weights(self, cells: Int64[Tensor, " c"]) -> dict[str, Float[Tensor, "c w"]]:
        _, ny, nz = self._shape
        i, j, k = unpack_ijk(cells).unbind(1)
        rows = (i * ny + j) * nz + k
        return {name: leaf.index_select(0, rows) for name, leaf in self._tables["cells"].leaves.items()}


def main() -> None:
    words = sys.argv[1:]
    own, extra = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, [])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="+")
    parser.add_argument("--grids", nargs="+", choices=["cube", "box", "band"], default=["cube", "box", "band"])
    parser.add_argument("--coarser", nargs="+", type=int, default=[], metavar="CELLS")
    request = parser.parse_args(own)
    wanted = [(kind, extra) for kind in request.grids]
    for cells in request.coarser:
        wanted += [(kind, [*extra, "--trainer.base-cells", str(cells)]) for kind in ("band", "cube")]
    print("| scene | grid | cells | corners, millions | faces | step, ms | of the cube's | Chamfer 1e-2 |", flush=True)
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for data in request.data:
        cube = None
        for kind, options in wanted:
            row = measure(data, kind, options)
            cube = row.milliseconds if kind == "cube" and cube is None else cube
            share = "-" if cube is None else f"{row.milliseconds / cube:.2f}"
            error = "-" if row.chamfer is None else f"{100 * row.chamfer:.3f}"
            size, step = f"{row.cells} | {row.corners / 1e6:.2f}", f"{row.milliseconds:.0f}"
            print(f"| {data} | {kind} | {size} | {row.faces} | {step} | {share} | {error} |", flush=True)


def measure(data: str, kind: str, options: Sequence[str]) -> Measured:
    """Reconstruct a scene on this kind of grid."""
    config = parse(["gaussian-sculpting", "--data", data, *options])
    scene = config.dataset.build(config.data).load()
    config, _ = plan_scene(of_sculpting(replace(config, observers=())), scene)
    config = replace(config, plan=PlanConfig())
    if kind != "band":
        # Cells stay of one size.
        config = replace(config, trainer=replace(config.trainer, cell_pixels=None))
    events: list[Event] = []
    session = Session(scene, config, emit=events.append)
    trainer, corners = trainer_of(session), None
    if kind != "band":
        assert isinstance(config.extractor, FlexiCubesConfig)  # noqa: S101
        grid, device = trainer.extractor.grid, pick_device(config.device)
        trainer.extractor = uniform = UniformFlexiCubes(config.extractor, grid, device, cube=kind == "cube")
        corners = uniform.corner_count
    session.run()
    ends = [event.t_train for event in events if event.event == "outer_step"][WARM_UP_STEPS - 1 :]
    assert trainer.extraction is not None  # noqa: S101
    return Measured(
        milliseconds=1e3 * statistics.median(end - begin for begin, end in itertools.pairwise(ends)),
        cells=config.trainer.finest_cells,
        corners=corners or len(trainer.extraction.corner_sdf),
        faces=len(trainer.extraction.surface.faces),
        chamfer=[event for event in events if event.event == "evaluation"][-1].data.get("chamfer_ps"),
    )


def _all_places(shape: tuple[int, int, int]) -> Int64[Tensor, "n 3"]:
    return torch.cartesian_prod(*(torch.arange(n) for n in shape))


if __name__ == "__main__":
    main()
