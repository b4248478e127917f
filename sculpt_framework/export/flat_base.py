"""A mesh cut flat below and closed there, to stand on."""

import numpy as np
from jaxtyping import Float64, Int64

from sculpt_framework.errors import ComponentImportError, DataError


def cut_below(
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    up: Float64[np.ndarray, " 3"],
    depth: float,
) -> tuple[Float64[np.ndarray, "w 3"], Int64[np.ndarray, "g 3"]]:
    """The mesh without its lowest ``depth`` along the unit vector ``up``, closed by a flat face.

    Raises ComponentImportError where manifold3d is not installed, DataError where the mesh is not closed, or not that
    high.
    """
    # trimesh.slice_plane closes cuts by triangulating the outline, which fails where surfaces cross; manifold3d's
    # result is closed whatever it is given.
    try:
        import manifold3d
    except ImportError as error:
        raise ComponentImportError(
            "--flat-base needs manifold3d, which is not installed; pip install 'gaussian-sculpting[print]'."
        ) from error
    heights = vertices @ up
    low, high = float(heights[faces].min()), float(heights[faces].max())
    if not depth < high - low:
        raise DataError(f"--flat-base: the mesh is only {high - low:.3g} high; give a larger --size.")
    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces.astype(np.uint64)))
    )
    if solid.status() != manifold3d.Error.NoError:
        raise DataError("the mesh is not closed, so it cannot be cut and stay so; leave --flat-base out.")
    cut = solid.trim_by_plane(tuple(up.tolist()), low + depth).to_mesh64()
    return np.array(cut.vert_properties[:, :3], np.float64), np.array(cut.tri_verts, np.int64)
