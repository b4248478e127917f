"""What a run leaves in its folder beside what its observers write."""

from pathlib import Path

from sculpt_framework.evaluation.painted import PaintedMesh
from sculpt_framework.export.mesh_files import write_mesh_glb, write_mesh_ply
from sculpt_framework.reconstructor import Reconstructor

CONFIG_NAME = "config.json"
MESH_NAME = "mesh.ply"


def save_result(folder: Path, mesh: PaintedMesh, method: Reconstructor) -> dict[str, Path]:
    """Write the mesh and what the method has beside it; returns the files by kind. Raises OutputError."""
    paths = {"mesh": folder / MESH_NAME, "glb": folder / "mesh.glb"}
    write_mesh_ply(paths["mesh"], mesh.vertices, mesh.faces, mesh.colors)
    write_mesh_glb(paths["glb"], mesh.vertices, mesh.faces, mesh.colors)
    return paths | method.save(folder)
