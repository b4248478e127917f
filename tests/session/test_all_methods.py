"""Every method as a user runs it: watched in a page, killed, resumed, reported, and in a batch."""

import json
import subprocess
import sys
import urllib.request
from dataclasses import fields, replace
from pathlib import Path

import pytest
import trimesh

from sculpt_framework import registry
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from tests.viewer.training import STEPS, eventually, free_port

GAUSSIANS = ("--gaussians", "500", "--mesh-cells", "24")
RAYS = ("--mesh-cells", "24", "--cells", "24", "--steps-across", "48", "--rays", "128")
GUIDED = (*GAUSSIANS, "--rays.cells", "24", "--rays.steps-across", "48", "--rays.number", "64")
BI_LEVEL = ("--trainer.base-cells", "10", "--trainer.fit-steps", "20", "--trainer.polish-steps", "2")
SMALL = {
    **dict.fromkeys(("nerf", "neus", "volsdf"), RAYS),
    **dict.fromkeys(("3dgsr", "gsdf"), GUIDED),
    **dict.fromkeys(("splatting-3d", "splatting-2d", "pgsr", "relightable"), GAUSSIANS),
    "sugar": (*GAUSSIANS, "--samples", "128", "--poisson.points", "2000", "--poisson.depth", "4"),
    "gof": (*GAUSSIANS, "--mesh-gaussians", "500"),
    "gaussian-sculpting": BI_LEVEL,
}
"""Of every method of the paper's tables, options with which a step is a matter of milliseconds."""
SIZES = {
    *("method", "steps", "rays", "steps_across", "final_rate", "field", "mesh_cells", "sharpness", "sharpness_rate"),
    *("beta_rate", "gaussians", "sh_every", "density", "rates", "mesh_gaussians", "samples", "poisson", "guidance"),
}
"""Of methods, what has another value at the size of their papers."""


def command(name: str, *words: str) -> list[str]:
    return [sys.executable, "-c", f"from sculpt_framework.cli.{name} import main; main()", *words]


def run(name: str, *words: str) -> str:
    done = subprocess.run(
        command(name, *words), capture_output=True, text=True, timeout=600, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def is_closed(path: Path) -> bool:
    mesh = trimesh.load_mesh(path)
    assert isinstance(mesh, trimesh.Trimesh)
    return len(mesh.faces) > 0 and mesh.is_watertight


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    settings = DemoSettings(train_views=11, test_views=2, resolution=48, reference_cells=32)
    write_scene(demo_object("blob"), settings, folder / "blob")
    return folder


def test_none_is_left_out():
    ours = {f"gaussian-sculpting-{variant}" for variant in ("fine", "everything", "tiny")}
    assert set(registry.method_names()) == set(SMALL) | {f"{name}-paper" for name in SMALL} | ours


@pytest.mark.parametrize("name", [name for name in SMALL if name != "gaussian-sculpting"])
def test_the_size_of_its_paper_is_the_same_method(name: str):
    small, whole = registry.load_method(name)(), registry.load_method(f"{name}-paper")()
    assert type(whole) is type(small)
    assert whole.steps > 5 * small.steps
    as_small = replace(whole, **{each.name: getattr(small, each.name) for each in fields(small) if each.name in SIZES})
    assert as_small == small


def test_sizes_of_papers_that_follow_from_their_length():
    relightable, splatting = (registry.load_method(f"{name}-paper")() for name in ("relightable", "splatting-3d"))
    assert isinstance(relightable, FreeGaussiansConfig)
    assert isinstance(splatting, FreeGaussiansConfig)
    assert relightable.density.end * relightable.steps == 10_000
    assert splatting.density.end * splatting.steps == 15_000
    # Of the cameras' spread, some four object units.
    assert relightable.rates.means == splatting.rates.means == 4 * 1.6e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_it_is_watched_killed_and_resumed(name: str, scenes: Path, tmp_path: Path):
    folder, log, port = tmp_path / "run", tmp_path / "log.txt", free_port()
    saved = folder / "checkpoints" / "latest.safetensors"
    page = ("--viewer", "--observers.viser.port", str(port))
    words = [name, "--data", str(scenes / "blob"), "--output", str(folder), "--threads", "1", "--steps", str(STEPS)]
    words += ["--checkpoint-seconds", "0.01", *SMALL[name], *page]
    with open(log, "wb") as told, subprocess.Popen(command("train", *words), stdout=told, stderr=told) as process:

        def steps() -> int:
            events = folder / "events.jsonl"
            return events.read_text(encoding="utf-8").count('"outer_step"') if events.exists() else 0

        try:
            eventually(
                lambda: "viewer at" in log.read_text(encoding="utf-8") or process.poll() is not None,
                found=log.read_text,
            )
            assert process.poll() is None, log.read_text(encoding="utf-8")
            with urllib.request.urlopen(f"http://127.0.0.1:{port}") as answer:
                assert answer.status == 200
            eventually(lambda: (steps() >= 2 and saved.exists()) or process.poll() is not None, found=log.read_text)
        finally:
            process.kill()
    assert not (folder / "mesh.ply").exists()
    run("train", "--resume", str(folder), "--max-time", "8")
    assert is_closed(folder / "mesh.ply")
    assert json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert "<svg" in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=pytest.mark.slow if name in ("volsdf", "gof") else pytest.mark.long)
    for name in ("volsdf", "splatting-3d", "gof", "gsdf")
])  # fmt: skip
def test_it_runs_in_a_batch_within_its_time_and_is_measured_again(name: str, scenes: Path, tmp_path: Path):
    own = (*SMALL[name], "--threads", "1", "--max-time", "8")
    told = run("batch", str(scenes), name, "--out", str(tmp_path / "out"), "--workers", "1", "--", *own)
    assert "1 of 1 scenes finished" in told
    made = tmp_path / "out" / "runs" / "blob"
    assert is_closed(made / "mesh.ply")
    assert "Chamfer" in run("evaluate", str(made))
