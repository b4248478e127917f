"""``sculpt-export`` on a run directory."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sculpt_framework.cli.export import export
from sculpt_framework.errors import CheckpointError, ConfigError, OutputError, UnknownComponentError
from sculpt_framework.export.mesh_files import write_mesh_ply


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    shape = trimesh.creation.icosphere(subdivisions=1)
    colors = np.linspace(0, 1, 3 * len(shape.vertices)).reshape(-1, 3)
    write_mesh_ply(tmp_path / "mesh.ply", np.array(shape.vertices), np.array(shape.faces, np.int64), colors)
    (tmp_path / "gaussians.ply").write_bytes(b"gaussians")
    return tmp_path


@pytest.mark.parametrize("kind", ["obj", "ply", "glb"])
def test_meshes(kind: str, run_dir: Path, capsys: pytest.CaptureFixture[str]):
    out = run_dir / f"out.{kind}"
    export([str(run_dir), "--format", kind, "--out", str(out)])
    said = capsys.readouterr().out.splitlines()
    assert said[0] == str(out)
    assert re.fullmatch(r"80 faces, [0-9. x]+ scene units, watertight", said[1])
    assert ("--up says otherwise" in said[-1]) == (kind != "ply")
    mesh = next(iter(trimesh.load_scene(out, process=False).geometry.values()))
    assert (len(mesh.vertices), len(mesh.faces)) == (42, 80)
    assert mesh.visual.kind == ("texture" if kind == "glb" else "vertex")


def test_defaults_stay_in_the_run_directory(run_dir: Path):
    before = (run_dir / "mesh.ply").read_bytes()
    for kind in ("ply", "obj", "glb", "gaussians"):
        export([str(run_dir), "--format", kind])
    assert (run_dir / "mesh.ply").read_bytes() == before
    assert (run_dir / "gaussians.ply").read_bytes() == b"gaussians"
    names = {path.name for path in run_dir.iterdir()}
    assert names == {"mesh.ply", "mesh.obj", "mesh-y-up.glb", "gaussians.ply"}


def test_gaussians_are_copied(run_dir: Path, tmp_path: Path):
    export([str(run_dir), "--format", "gaussians", "--out", str(tmp_path / "splats.ply")])
    assert (tmp_path / "splats.ply").read_bytes() == b"gaussians"


def test_mistakes_are_explained(run_dir: Path, tmp_path: Path):
    with pytest.raises(CheckpointError, match=r"has no mesh\.ply"):
        export([str(tmp_path / "nowhere"), "--format", "obj"])
    with pytest.raises(OutputError, match="cannot write"):
        export([str(run_dir), "--format", "obj", "--out", str(tmp_path / "nowhere" / "mesh.obj")])
    with pytest.raises(UnknownComponentError, match=r"no export format 'objs'\. Did you mean 'obj'\?"):
        export([str(run_dir), "--format", "objs"])
    with pytest.raises(ConfigError, match=r"--format is missing; there are ply, obj, glb, stl, 3mf, "):
        export([str(run_dir)])
    with pytest.raises(ConfigError, match=r"--format is given twice: obj and glb"):
        export([str(run_dir), "--format", "obj", "--format=glb"])
    with pytest.raises(ConfigError, match=r"--format stl has no option --sice\. Did you mean --size\?"):
        export([str(run_dir), "--format", "stl", "--sice", "8cm"])
