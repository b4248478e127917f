import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sculpt_framework.errors import ComponentImportError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.placing import FileFrame, PlacedMesh, place
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.three_mf.config import ThreeMfExporterConfig

_DIGITS = 8
"""Significant ones of the largest coordinate: a 32-bit float has no more."""


class ThreeMfExporter(Exporter):
    """By the 3MF Consortium's own library: trimesh's writer says millimetres whatever the unit, and has no colours."""

    def __init__(self, config: ThreeMfExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        try:
            import lib3mf  # noqa: F401
        except ImportError as error:
            raise ComponentImportError(
                "--format 3mf needs lib3mf, which is not installed; pip install 'gaussian-sculpting[print]', or take "
                "--format stl."
            ) from error
        unit = self._config.unit
        mesh = place(run_dir, self._config, FileFrame(up="z", unit="mm", needs_size=True), unit)
        write_atomically(out, encode_3mf(mesh, unit or "mm"))
        return [str(out), *mesh.facts()]


def encode_3mf(mesh: PlacedMesh, unit: str) -> bytes:
    """The file: one object, a colour per corner."""
    from lib3mf import Lib3MF, get_wrapper

    # Its functions have no types.
    wrapper: Any = get_wrapper()
    model = wrapper.CreateModel()
    units = Lib3MF.ModelUnit
    model.SetUnit({"mm": units.MilliMeter, "cm": units.CentiMeter, "m": units.Meter, "in": units.Inch}[unit])
    shape = model.AddMeshObject()
    shape.SetName("mesh")
    vertices = np.ascontiguousarray(mesh.vertices, np.float32)
    faces = np.ascontiguousarray(mesh.faces, np.uint32)
    shape.SetGeometry(_rows(Lib3MF.Position, vertices), _rows(Lib3MF.Triangle, faces))
    if mesh.colors is not None:
        bytes_ = np.rint(mesh.colors.clip(0, 1) * 255).astype(np.uint8)
        distinct, name = np.unique(bytes_, axis=0, return_inverse=True)
        group = model.AddColorGroup()
        numbers = np.array([group.AddColor(wrapper.RGBAToColor(*map(int, rgb), 255)) for rgb in distinct], np.uint32)
        rows = np.zeros((len(faces), 4), np.uint32)
        rows[:, 0], rows[:, 1:] = group.GetResourceID(), numbers[name.reshape(-1)[mesh.faces]]
        shape.SetAllTriangleProperties(_rows(Lib3MF.TriangleProperties, rows))
        # Readers want a colour for the whole object too, where triangles have some.
        shape.SetObjectLevelProperty(group.GetResourceID(), int(numbers[0]))
    model.AddBuildItem(shape, wrapper.GetIdentityTransform())
    writer = model.QueryWriter("3mf")
    largest = float(np.abs(vertices).max(initial=0.0))
    writer.SetDecimalPrecision(int(np.clip(_DIGITS - np.ceil(np.log10(largest or 1.0)), 1, 16)))
    return bytes(writer.WriteToBuffer())


def _rows(kind: type[ctypes.Structure], values: np.ndarray) -> ctypes.Array:
    """Rows of an array as the library's structures."""
    return (kind * len(values)).from_buffer_copy(values.tobytes())
