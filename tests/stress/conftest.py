import json
from pathlib import Path

import pytest
import torch
from fuzzing import Target
from safetensors.torch import save

from sculpt_framework import registry
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.engine.checkpoint import FILE_NAME, read_checkpoint
from sculpt_framework.evaluation.curve import header_line, read_curve
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.export.gaussian_files import read_gaussians_ply, write_gaussians_ply
from sculpt_framework.export.mesh_files import read_colored_mesh, write_mesh_ply
from sculpt_framework.posed_images.decoding import read_image
from sculpt_framework.serialization import config_to_json, read_config
from sculpt_framework.testing import one_gaussian, tetrahedron
from sculpt_framework.validation import check
from sculpt_plugins.datasets.blender.config import BlenderConfig


@pytest.fixture(scope="session")
def scene_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene") / "blob"
    settings = DemoSettings(train_views=3, test_views=0, resolution=16, reference_cells=8)
    write_scene(demo_object("blob"), settings, folder)
    return folder


@pytest.fixture(scope="session")
def mesh_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path, surface = tmp_path_factory.mktemp("mesh") / "mesh.ply", tetrahedron()
    vertices = surface.vertices.double().numpy()
    write_mesh_ply(path, vertices, surface.faces.numpy(), 0.0 * vertices.astype("float32") + 0.5)
    return path.read_bytes()


@pytest.fixture(scope="session")
def targets(scene_folder: Path, mesh_bytes: bytes, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Target]:
    """Every kind of file that a command reads, each with its reader, in a folder of its own."""
    folder = tmp_path_factory.mktemp("bytes")

    def load_scene() -> None:
        BlenderConfig().build(str(scene_folder)).load()

    def in_folder(name: str, data: bytes, read) -> Target:
        path = folder / name
        path.write_bytes(data)
        return Target(name=name, path=path, original=data, read=lambda: read(path))

    write_gaussians_ply(folder / "gaussians.ply", one_gaussian())
    progress = {"outer": 3, "progress": 0.5, "trained_seconds": 1.0, "best_psnr": None, "rate_scale": 1.0}
    header = {"format": "1", "progress": json.dumps({**progress, "recoveries": 0, "milestones": []})}
    checkpoint = save({"a": torch.arange(40.0), "b/c": torch.zeros(3, 2)}, metadata=header)
    config = config_to_json(registry.load_method("gaussian-sculpting")())
    picture = (scene_folder / "train" / "r_0.png").read_bytes()
    made = [
        in_folder("mesh.ply", mesh_bytes, lambda path: (load_mesh(path), read_colored_mesh(path))),
        in_folder("gaussians.ply", (folder / "gaussians.ply").read_bytes(), read_gaussians_ply),
        in_folder(FILE_NAME, checkpoint, lambda path: read_checkpoint(path.parent)),
        in_folder("config.json", config.encode(), lambda path: check(read_config(path))),
        in_folder("picture.png", picture, read_image),
        in_folder("curve.csv", f"{header_line()}{'1.5,' * 18}\n".encode(), read_curve),
    ]
    for name in ("transforms_train.json", "train/r_0.png"):
        path = scene_folder / name
        made.append(Target(name=name, path=path, original=path.read_bytes(), read=load_scene))
    return {target.name: target for target in made}
