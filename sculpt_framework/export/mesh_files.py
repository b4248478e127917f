"""Triangle meshes with vertex colours as PLY, OBJ and GLB.

Positions are written in the frame they come in, as 32-bit floats (OBJ: nine significant digits, which is the same).
Colours are sRGB in [0, 1]; PLY and OBJ keep sRGB, as every viewer of them expects, and GLB gets linear values, as glTF
prescribes.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from sculpt_framework.errors import DataError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.glb import encode_glb
from sculpt_framework.export.ply import TRIANGLE, encode_ply

Vertices = Float[np.ndarray, "v 3"]
Faces = Int64[np.ndarray, "f 3"]
Colors = Float[np.ndarray, "v 3"]


def write_mesh_ply(path: Path, vertices: Vertices, faces: Faces, colors: Colors | None = None) -> None:
    """Binary PLY; colours become bytes. Raises OutputError where the file cannot be written."""
    columns = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    if colors is not None:
        columns += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    vertex_rows = np.zeros(len(vertices), dtype=columns)
    for axis, name in enumerate("xyz"):
        vertex_rows[name] = vertices[:, axis]
    if colors is not None:
        for channel, name in enumerate(("red", "green", "blue")):
            vertex_rows[name] = _to_bytes(colors[:, channel])
    face_rows = np.zeros(len(faces), dtype=TRIANGLE)
    face_rows["count"], face_rows["vertex_indices"] = 3, faces
    write_atomically(path, encode_ply([("vertex", vertex_rows), ("face", face_rows)]))


def write_mesh_obj(path: Path, vertices: Vertices, faces: Faces, colors: Colors | None = None) -> None:
    """Wavefront OBJ; colours follow the position on the vertex line, the extension that MeshLab and Blender read."""
    rows = np.asarray(vertices, dtype=np.float32) if colors is None else np.hstack([vertices, colors.clip(0, 1)])
    line = "v " + " ".join(["%.9g"] * 3 + ["%.4g"] * (rows.shape[1] - 3))
    lines = [line % tuple(row) for row in rows.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    write_atomically(path, ("\n".join(lines) + "\n").encode("ascii"))


def write_mesh_glb(path: Path, vertices: Vertices, faces: Faces, colors: Colors | None = None) -> None:
    """Binary glTF 2.0: positions, smooth normals, linear vertex colours, a rough non-metallic material.

    Coordinates are not turned: glTF viewers take +y for up, so a scene with z up lies on its back in them.
    Raises OutputError where the file cannot be written.
    """
    blocks = {
        "POSITION": np.ascontiguousarray(vertices, dtype="<f4"),
        "NORMAL": vertex_normals(vertices, faces).astype("<f4"),
    }
    if colors is not None:
        blocks["COLOR_0"] = srgb_to_linear(colors.clip(0, 1)).astype("<f4")
    write_atomically(path, encode_glb(blocks, faces))


def read_colored_mesh(path: Path) -> tuple[Vertices, Faces, Colors | None]:
    """Vertices, faces and sRGB vertex colours of a mesh file; None for the colours where it has none.

    Raises DataError where there is no such file or it is no mesh.
    """
    import trimesh
    from trimesh.visual.color import ColorVisuals

    if not path.is_file():
        raise DataError(f"no mesh file at {path}")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
        visual = mesh.visual
        colors = None
        if isinstance(visual, ColorVisuals) and visual.kind == "vertex":
            colors = np.array(visual.vertex_colors)[:, :3] / 255
    except Exception as error:  # trimesh's readers raise whatever their parsing stumbles over.
        raise DataError(f"{path} cannot be read as a triangle mesh ({error or type(error).__name__})") from error
    return vertices, faces, colors


def vertex_normals(vertices: Vertices, faces: Faces) -> Float[np.ndarray, "v 3"]:
    """Unit normals, each the area-weighted mean over the vertex's faces; (0, 0, 1) where that has no direction."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros(vertices.shape, dtype=np.float64)
    for corner in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, corner], weights=cross[:, axis], minlength=len(vertices))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])


def srgb_to_linear(colors: Colors) -> Colors:
    """The sRGB transfer function's inverse, per channel in [0, 1] (IEC 61966-2-1)."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


def _to_bytes(values: np.ndarray) -> np.ndarray:
    return np.rint(values.clip(0, 1) * 255).astype(np.uint8)
