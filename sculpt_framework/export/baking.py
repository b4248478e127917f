"""A run's mesh with a texture of the run's photographs."""

from dataclasses import dataclass
from pathlib import Path

from sculpt_framework.export.assets import TexturedMesh
from sculpt_framework.export.mesh_files import Faces, Vertices
from sculpt_framework.export.run_results import ColoredMesh, read_scene
from sculpt_framework.export.texture import Atlas, Texture, bake, unwrap


@dataclass(frozen=True, kw_only=True, eq=False)
class BakedTexture:
    faces: Faces
    atlas: Atlas
    texture: Texture

    def at(self, vertices: Vertices) -> TexturedMesh:
        """The mesh with its vertices in any frame."""
        return TexturedMesh(vertices=vertices, faces=self.faces, atlas=self.atlas, texture=self.texture)

    @property
    def said(self) -> str:
        """What the user is told."""
        unseen = 100 * (1 - self.texture.seen_share)
        size = f"{self.atlas.width}x{self.atlas.height}"
        return f"texture {size}; {unseen:.1f} % of it is in no photograph and has the mesh's colours"


def bake_texture(mesh: ColoredMesh, run_dir: Path, data: str | None, size: int) -> BakedTexture:
    """Of about ``size`` texels a side, for a mesh in the scene's frame. Raises as ``unwrap`` and ``read_scene``."""
    atlas = unwrap(mesh.vertices, mesh.faces, size)
    texture = bake(mesh.vertices, mesh.faces, atlas, read_scene(run_dir, data).train, mesh.shown_colors)
    return BakedTexture(faces=mesh.faces, atlas=atlas, texture=texture)
