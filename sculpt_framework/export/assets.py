"""Meshes with more than colours: textured GLB and OBJ, PLY with what the cameras saw of each vertex."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64, Int64

from sculpt_framework.errors import ConfigError, OutputError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.glb import encode_glb
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.export.mesh_pixels import Visibility
from sculpt_framework.export.ply import TRIANGLE, encode_ply
from sculpt_framework.export.texture import Atlas, Texture

_UNSEEN_ANGLE = 90.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TexturedMesh:
    """World frame."""

    vertices: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    atlas: Atlas
    texture: Texture

    @property
    def png(self) -> bytes:
        """The picture, 8 bit."""
        pixels = np.rint(self.texture.rgb[..., ::-1].clip(0, 1) * 255).astype(np.uint8)
        done, data = cv2.imencode(".png", pixels)
        if not done:
            raise ValueError("the texture cannot be encoded")
        return data.tobytes()


def write_textured_glb(path: Path, mesh: TexturedMesh) -> None:
    """One file with the picture inside. Raises OutputError where it cannot be written."""
    atlas = mesh.atlas
    normals = vertex_normals(mesh.vertices, mesh.faces)
    # glTF's coordinates run from the upper left corner.
    blocks = {
        "POSITION": mesh.vertices[atlas.source].astype("<f4"),
        "NORMAL": normals[atlas.source].astype("<f4"),
        "TEXCOORD_0": np.stack([atlas.uv[:, 0], 1 - atlas.uv[:, 1]], axis=1).astype("<f4"),
    }
    write_atomically(path, encode_glb(blocks, atlas.faces, mesh.png))


def check_textured_obj(path: Path) -> None:
    """Raises ConfigError for a name that OBJ cannot hold, OutputError where files of another purpose would be lost."""
    if any(letter.isspace() for letter in path.stem):
        raise ConfigError(f"{path.name}: OBJ cannot name a material file with spaces; choose another --out.")
    for beside in (path.with_suffix(".mtl"), path.with_suffix(".png")):
        if beside.exists() and not path.exists():
            raise OutputError(f"{beside} exists, and would be overwritten beside {path.name}; choose another --out.")


def write_textured_obj(path: Path, mesh: TexturedMesh) -> list[Path]:
    """The mesh at ``path``, its material and picture beside it; returns all three.

    Positions are shared across the cuts, so that the mesh is as closed in other programs as it is here. The file that
    refers to the others is written last. Raises OutputError where one cannot be written, and as ``check_textured_obj``.
    """
    check_textured_obj(path)
    material, picture = path.with_suffix(".mtl"), path.with_suffix(".png")
    write_atomically(picture, mesh.png)
    # No ambient light and no highlights: the colours are photographs.
    text = f"newmtl photographs\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {picture.name}\n"
    write_atomically(material, text.encode("utf-8"))
    atlas = mesh.atlas
    lines = [f"mtllib {material.name}", "usemtl photographs"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices.astype(np.float32).tolist()]
    lines += [f"vt {u:.7g} {v:.7g}" for u, v in atlas.uv.tolist()]
    both = np.stack([atlas.source[atlas.faces] + 1, atlas.faces + 1], axis=2).tolist()
    lines += ["f " + " ".join(f"{place}/{texel}" for place, texel in corners) for corners in both]
    write_atomically(path, ("\n".join(lines) + "\n").encode("utf-8"))
    return [path, material, picture]


def write_attribute_ply(
    path: Path,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    colors: Float[np.ndarray, "v 3"],
    seen: Visibility,
) -> None:
    """PLY with colour, normal, ``times_seen`` and ``best_view_angle`` of each vertex.

    The angle is between the normal and the most frontal view, in degrees, 90 where no view sees the vertex: there the
    surface is what the optimiser made up. Raises OutputError where the file cannot be written.
    """
    names = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    names += [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.zeros(len(vertices), dtype=[*names, ("times_seen", "<i4"), ("best_view_angle", "<f4")])
    normals: Float[np.ndarray, "v 3"] = vertex_normals(vertices, faces)
    for axis in range(3):
        rows["xyz"[axis]], rows[("nx", "ny", "nz")[axis]] = vertices[:, axis], normals[:, axis]
        rows[("red", "green", "blue")[axis]] = np.rint(colors[:, axis].clip(0, 1) * 255)
    angle: Float32[np.ndarray, " v"] = np.degrees(np.arccos(seen.best_cosine.clip(0, 1)))
    rows["times_seen"] = seen.times_seen
    rows["best_view_angle"] = np.where(seen.times_seen > 0, angle, _UNSEEN_ANGLE)
    face_rows = np.zeros(len(faces), dtype=TRIANGLE)
    face_rows["count"], face_rows["vertex_indices"] = 3, faces
    write_atomically(path, encode_ply([("vertex", rows), ("face", face_rows)]))
