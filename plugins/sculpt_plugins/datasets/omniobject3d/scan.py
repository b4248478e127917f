"""The object's scan, brought into the frame of its renders.

The renderer of the dataset read Scan.obj as Blender reads OBJ files, y up turned into z up, (x, y, z) to (x, -z, y),
and multiplied it by ``scale``, which it wrote into every frame of transforms.json: 0.99 over the largest coordinate.
"""

import hashlib
import os
import re
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float64

from sculpt_framework.errors import DataError, OutputError
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.posed_images.reading import number, read_json, required
from sculpt_framework.types import Box
from sculpt_framework.user_cache import user_cache

SCAN = Path("Scan") / "Scan.obj"
_SLACK = 0.02
"""Share of the box's longest side by which a scan may reach out of it: pixels, and cells of the carved hull."""
_LEAST = 0.5
"""A scan whose longest side is less than this share of the box's is another object, or of another scale."""
_REVISION = 1
"""Of what is done to a scan, so that a copy an older version made is never taken for this one's."""


def reference_mesh(folder: Path, transforms: Path, box: Box) -> tuple[Path | None, str]:
    """A mesh file of the scan in the frame of the renders, and one line that says what was found.

    None where there is no scan, or where it does not fit the images: it has to lie in their box. The mesh is written
    into the user's cache once. Raises DataError for a scan or a scale that cannot be read.
    """
    scan = find_scan(folder)
    if scan is None:
        return None, "no scan found in raw_scans: distances to a reference are not known."
    scale = recorded_scale(transforms)
    mesh = load_mesh(scan)
    placed = Mesh(vertices=to_render_frame(mesh.vertices, scale), faces=mesh.faces)
    misfit = _misfit(placed, box)
    if misfit is not None:
        return None, f"the scan {scan} at scale {scale:g} does not fit the images ({misfit}): it is not used."
    return _cached(placed, scan, scale), f"reference: {scan}, turned to z up and scaled by {scale:g}."


def find_scan(folder: Path) -> Path | None:
    """The scan of an object, given its folder in blender_renders; None if there is none.

    Looked for in ``raw_scans`` beside ``blender_renders``, with and without the level of categories, and in the folder
    itself.
    """
    folder = Path(os.path.abspath(folder))
    places = [folder]
    scans = next((above / "raw_scans" for above in folder.parents if (above / "raw_scans").is_dir()), None)
    if scans is not None:
        category = re.sub(r"_\d+$", "", folder.name)
        places += [scans / folder.parent.name / folder.name, scans / category / folder.name, scans / folder.name]
    return next((place / SCAN for place in places if (place / SCAN).is_file()), None)


def recorded_scale(transforms: Path) -> float:
    """The factor that all frames agree on. Raises DataError where one has none or another."""
    frames = required(read_json(transforms), "frames", str(transforms))
    scales = {
        number(required(frame, "scale", f"{transforms}: frame {index}"), f"{transforms}: frame {index}: scale")
        for index, frame in enumerate(frames if isinstance(frames, list) else [])
        if isinstance(frame, dict)
    }
    if len(scales) != 1 or min(scales) <= 0:
        raise DataError(f"{transforms}: scales {sorted(scales)[:3]}; expected one above 0 for all frames.")
    return scales.pop()


def to_render_frame(vertices: Float64[np.ndarray, "v 3"], scale: float) -> Float64[np.ndarray, "v 3"]:
    """From the frame of Scan.obj (y up) to that of the renders (z up): a quarter turn about x, and a scale."""
    x, y, z = vertices.T
    return scale * np.stack([x, -z, y], axis=1)


def _misfit(mesh: Mesh, box: Box) -> str | None:
    used = mesh.vertices[mesh.faces.reshape(-1)]
    low, high = used.min(0), used.max(0)
    side = 2 * box.scale
    outside = max(float((box.minimum.numpy() - low).max()), float((high - box.maximum.numpy()).max())) / side
    if outside > _SLACK:
        return f"it reaches {100 * outside:.0f} % out of their box"
    share = float((high - low).max()) / side
    return f"it is {share:.2f} times as large" if share < _LEAST else None


def _cached(mesh: Mesh, scan: Path, scale: float) -> Path:
    """The mesh as a file in the user's cache, written if it is not there; in a temporary folder where there is none."""
    state = scan.stat()
    identity = f"{_REVISION} {scan.resolve()} {state.st_size} {state.st_mtime_ns} {scale!r}"
    name = f"{hashlib.sha256(identity.encode()).hexdigest()[:16]}.ply"
    folder = user_cache() / "omniobject3d"
    if (folder / name).is_file():
        return folder / name
    data = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="ply")
    assert isinstance(data, bytes)  # noqa: S101
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / name, data)
    except (OSError, OutputError):
        folder = Path(tempfile.mkdtemp(prefix="sculpt-"))
        write_atomically(folder / name, data)
    return folder / name
