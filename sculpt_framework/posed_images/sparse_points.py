"""Points of a sparse reconstruction, whatever file they come from."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sculpt_framework.errors import DataError

Points = Float64[np.ndarray, "n 3"]
NO_POINTS = np.zeros((0, 3))


def read_ply_points(path: Path) -> Points:
    """Positions in a PLY file. Raises DataError where it is none."""
    import trimesh

    try:
        # From an open file: with a path, the reader would also open files that this one names.
        with open(path, "rb") as file:
            cloud = trimesh.load_scene(file, file_type="ply", process=False)
        found = [np.asarray(part.vertices, np.float64) for part in cloud.geometry.values()]
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except Exception as error:  # trimesh's readers raise whatever their parsing stumbles over.
        told = str(error).partition("\n")[0] or type(error).__name__
        raise DataError(f"{path}: cannot be read as points ({told}); write it again.") from error
    return np.concatenate([NO_POINTS, *found])


def usable(points: Points, name: str) -> tuple[Float64[np.ndarray, "m 3"], list[str]]:
    """Those that are somewhere, and notes on the rest. ``name`` is what the notes call their file."""
    if len(points) == 0:
        return NO_POINTS, [f"{name} holds no point."]
    finite = np.isfinite(points).all(axis=1)
    lost = len(points) - int(finite.sum())
    return points[finite], [
        f"{lost} of {len(points)} points in {name} are nowhere (not finite): left out."
    ] if lost else []
